"""Parameters from settings: typed, described, with range, and checked like a configuration."""

from dataclasses import dataclass
from typing import Literal

import pytest

pytest.importorskip("rclpy")

from rclpy.parameter import Parameter

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.node_state import NodeState, State
from rotcal_ros.foundation.settings import group, setting
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.runtime.managed_node import read_settings
from rotcal_ros.nodes.runtime.running import default_context


@dataclass(frozen=True)
class Inner:
    count: int = setting(3, doc="number of things", minimum=1, maximum=9)


@dataclass(frozen=True)
class Example:
    length_m: float = setting(1.0, doc="m, a length", minimum=0.0)
    mode: str = setting("a", doc="how", choices=("a", "b"))
    way: Literal["near", "far"] = setting("near", doc="which way")
    sizes_m: tuple[float, ...] = setting((0.5,), doc="m, sizes", minimum=0.0)
    fixed: tuple[int, int] = setting((1, 2), doc="two numbers")
    maybe: float | None = setting(None, doc="may be absent")
    on: bool = setting(True, doc="a switch")
    inner: Inner = group(Inner)


class ExampleNode(CellNode):
    def _report(self):
        return NodeState(State.IDLE), {}


@pytest.fixture(scope="module")
def context():
    with default_context():
        yield


def node(**overrides):
    values = [Parameter(f"g.{name.replace('__', '.')}", value=v) for name, v in overrides.items()]
    return ExampleNode("example", parameter_overrides=values, start_parameter_services=False)


@pytest.mark.ros
def test_defaults_are_declared_with_type_description_and_range(context):
    made = node()
    assert made.settings("g", Example) == Example()
    length = made.describe_parameter("g.length_m")
    assert length.type == Parameter.Type.DOUBLE.value
    assert length.description == "m, a length"
    assert length.read_only
    assert length.floating_point_range[0].from_value == 0.0
    count = made.describe_parameter("g.inner.count")
    assert count.type == Parameter.Type.INTEGER.value
    assert (count.integer_range[0].from_value, count.integer_range[0].to_value) == (1, 9)
    assert "a, b" in made.describe_parameter("g.mode").additional_constraints
    way = made.describe_parameter("g.way")
    assert way.type == Parameter.Type.STRING.value
    assert way.additional_constraints == "one of: near, far"
    assert made.describe_parameter("g.sizes_m").type == Parameter.Type.DOUBLE_ARRAY.value
    made.destroy_node()


@pytest.mark.ros
def test_overrides_are_taken_whole_numbers_for_real_ones_too(context):
    made = node(length_m=2, mode="b", sizes_m=[1.0, 2.0], fixed=[5, 6], maybe=7.0, inner__count=4)
    expected = Example(
        length_m=2.0, mode="b", sizes_m=(1.0, 2.0), fixed=(5, 6), maybe=7.0, inner=Inner(count=4)
    )
    assert made.settings("g", Example) == expected
    assert read_settings(made, "g", Example) == expected
    made.destroy_node()


@pytest.mark.ros
def test_an_empty_list_stays_empty_and_what_ros_gives_a_node_stays(context):
    made = node(sizes_m=[])
    assert made.settings("g", Example) == Example(sizes_m=())
    assert read_settings(made, "g", Example) == Example(sizes_m=())
    assert made.has_parameter("use_sim_time")
    made.destroy_node()


@pytest.mark.ros
def test_an_empty_list_in_a_parameter_file_stays_empty(context, tmp_path):
    file = tmp_path / "parameters.yaml"
    file.write_text("/**: {ros__parameters: {g: {sizes_m: [], length_m: 3.0}}}")
    made = ExampleNode("example", cli_args=["--ros-args", "--params-file", str(file)])
    assert made.settings("g", Example) == Example(sizes_m=(), length_m=3.0)
    made.destroy_node()


@pytest.mark.ros
def test_a_change_at_run_time_is_read_and_a_wrong_one_refused(context):
    made = node()
    made.settings("g", Example, read_only=False)
    (good,) = made.set_parameters([Parameter("g.length_m", value=3.5)])
    (bad,) = made.set_parameters([Parameter("g.length_m", value=-1.0)])
    assert good.successful
    assert not bad.successful
    assert read_settings(made, "g", Example) == Example(length_m=3.5)
    made.destroy_node()


@pytest.mark.ros
@pytest.mark.parametrize(
    ("override", "finding"),
    [
        ({"length_m": -1.0}, "length_m: -1.0 is out of range"),
        ({"mode": "c"}, "mode: 'c' is none of a, b"),
        ({"fixed": [1]}, "fixed: expected 2 values"),
        ({"on": "yes"}, "on: expected bool"),
        ({"inner__count": 12}, "inner.count: 12 is out of range"),
        ({"way": "fat"}, "way: 'fat' is none of near, far; did you mean 'far'"),
        ({"lenght_m": 1.0}, "parameters g: unknown setting 'lenght_m'; did you mean 'length_m'"),
        ({"inner__cuont": 2}, "inner: unknown setting 'cuont'; did you mean 'count'"),
    ],
)
def test_a_wrong_override_is_told_with_its_place(context, override, finding):
    made = node(**override)
    with pytest.raises(ConfigurationError, match=finding.replace("[", r"\[")):
        made.settings("g", Example)
    made.destroy_node()


@pytest.mark.ros
def test_whatever_is_listed_has_a_value_and_the_values_give_the_same_settings(context):
    """What ``ros2 param dump`` shows; it asks for all listed parameters at once."""
    made = node(sizes_m=[], mode="b", inner__count=4)
    settings = made.settings("g", Example)
    listed = made.list_parameters(["g"], 0).names
    dumped = {p.name: p.value for p in made.get_parameters(listed)}
    made.destroy_node()
    assert dumped["g.sizes_m"] is not None
    again = ExampleNode(
        "example",
        parameter_overrides=[
            Parameter(n, value=list(v) if hasattr(v, "__len__") and not isinstance(v, str) else v)
            for n, v in dumped.items()
        ],
        start_parameter_services=False,
    )
    assert again.settings("g", Example) == settings
    again.destroy_node()
