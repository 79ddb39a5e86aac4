"""A misspelt or impossible setting of any group is refused before anything moves."""

import os

import pytest
import yaml
from live_cell import DEMO, wait_until

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.plugins import METHODS, provider
from rotcal_ros.foundation.settings import declarations
from rotcal_ros.methods.configuration import (
    GROUPS,
    dump_configuration,
    parse_configuration,
    read_configuration,
    settings_classes,
)
from rotcal_ros.methods.method import find_method, method_names

BAD_CONFIGURATION = 601
WRONG = (
    ("solver.variannt", "joint", "solver: unknown setting 'variannt'; did you mean 'variant'"),
    ("solver.variant", "jiont", "solver.variant: 'jiont' is none of station, joint"),
    ("topics.trcer_length", "/a", "topics: unknown setting 'trcer_length'; did you mean 'tracer_"),
    ("recorder.silence", 20.0, "recorder: unknown setting 'silence'; did you mean 'silence_s"),
    ("recorder.silence_s", 0.01, "recorder.silence_s: 0.01 is out of range"),
    ("recorder.writer.split_byte", 5, "recorder.writer: unknown setting 'split_byte'; did you"),
    ("bridge.controler", "csv", "bridge: unknown setting 'controler'; did you mean 'controller'"),
    ("simulation.tme_scale", 2.0, "simulation: unknown setting 'tme_scale'; did you mean 'time"),
    ("plan.box_point", [3, 2, 2], "plan: unknown setting 'box_point'; did you mean 'box_points'"),
    ("capture.window_sample", 3, "capture: unknown setting 'window_sample'; did you mean 'wind"),
    ("planner.max_atempts", 2, "planner: unknown setting 'max_atempts'; did you mean 'max_att"),
    ("cell.axs", "B", "cell: unknown setting 'axs'; did you mean 'axis'"),
    ("solvr.variant", "joint", "unknown group 'solvr'; did you mean 'solver'"),
)


def wrong_text(name, value):
    """Return the demonstration's configuration with one more setting."""
    document = yaml.safe_load(DEMO.read_text())
    place = document["/**"]["ros__parameters"]
    *groups, last = name.split(".")
    for group in groups:
        place = place.setdefault(group, {})
    place[last] = value
    return yaml.safe_dump(document)


@pytest.mark.parametrize(("name", "value", "finding"), WRONG, ids=[w[0] for w in WRONG])
def test_the_configuration_is_refused_with_place_and_nearest_name(name, value, finding):
    with pytest.raises(ConfigurationError) as refusal:
        parse_configuration(wrong_text(name, value), "somewhere")
    assert str(refusal.value).startswith("somewhere")
    assert finding in str(refusal.value)


@pytest.mark.slow
@pytest.mark.parametrize("method", [m for m in method_names() if not provider(m, METHODS)])
def test_every_setting_of_every_method_is_known_by_its_exact_name_only(method):
    given = read_configuration(DEMO.with_name({"tracer_multistation": "tracer_paper.yaml"}.get(
        method, f"{method}_demo.yaml"
    )))  # fmt: skip
    groups = yaml.safe_load(given.text)["/**"]["ros__parameters"]
    groups.pop("method")
    for group, cls in settings_classes(find_method(method)).items():
        assert group in GROUPS
        for declared in declarations(cls):
            *inner, last = declared.name.split(".")
            tree = {last + "x": 1}
            for name in reversed(inner):
                tree = {name: tree}
            changed = {"plan": groups["plan"], group: {**groups.get(group, {}), **tree}}
            place = ".".join([group, *inner])
            with pytest.raises(ConfigurationError, match=f"{place}: unknown setting '{last}x'"):
                parse_configuration(dump_configuration(method, changed))


@pytest.mark.ros
def test_a_live_planner_refuses_the_goal_and_stays_ready(cell):
    pytest.importorskip("rclpy")
    pytest.importorskip("rotcal_msgs")
    from rotcal_ros.ros import Calibrator

    before = dict(os.environ)
    live = cell()
    live.start("planner")
    with Calibrator("/cell") as calibrator:
        calibrator.wait_until_ready(60.0)
        for name, value, finding in WRONG:
            calibrator.start(wrong_text(name, value))
            outcome = calibrator.result(20.0)
            assert outcome.error_code == BAD_CONFIGURATION
            assert outcome.error_msg.startswith("configuration of the goal")
            assert finding in outcome.error_msg
            assert not outcome.bag_folder
    os.environ.clear()
    os.environ.update(before)


@pytest.mark.ros
def test_a_planner_with_a_misspelt_parameter_of_any_group_does_not_start(cell):
    pytest.importorskip("rclpy")
    pytest.importorskip("rotcal_msgs")
    live = cell()
    names = []
    for number, (name, value, _) in enumerate(WRONG[::3]):
        live.file.write_text(wrong_text(name, value))
        names.append(f"planner_{number}")
        live.start("planner", name=names[-1])
        wait_until(lambda: len(live.processes.ended()) == len(names), f"{names[-1]} ends")
    assert live.processes.ended() == dict.fromkeys(names, 2)
    for number, (_, _, finding) in enumerate(WRONG[::3]):
        assert finding in live.log(f"planner_{number}")
        assert "Traceback" not in live.log(f"planner_{number}")
