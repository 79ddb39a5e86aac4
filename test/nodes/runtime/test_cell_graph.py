"""Where a topic may be that nobody publishes under its stated name; no middleware."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_ros.nodes.runtime.cell_graph import CellGraph

LENGTH = "rotcal_msgs/msg/TracerLength"
SPOKEN = "std_msgs/msg/Float64"


def graph(**topics):
    """Return a graph in which these topics are published: name, with __ for /, -> type."""
    found = {f"/{name.replace('__', '/')}": kind for name, kind in topics.items()}
    return CellGraph(
        SimpleNamespace(
            get_topic_names_and_types=lambda: [(name, [kind]) for name, kind in found.items()],
            get_publishers_info_by_topic=lambda name: ["somebody"] if "mute" not in name else [],
            resolve_topic_name=lambda name: name,
        )
    )


@pytest.mark.parametrize(
    ("topics", "own", "hint"),
    [
        (
            {"cell__tracer_length": LENGTH},
            "/cell/tracer_lenght",
            "is it /cell/tracer_length (rotcal_msgs/msg/TracerLength)? Set "
            "topics.tracer_length: /cell/tracer_length, or remap it: --ros-args -r "
            "/cell/tracer_length:=/cell/tracer_lenght",
        ),
        (
            {"a": LENGTH, "lab__laser_length": LENGTH, "lab__laser_lenght": SPOKEN},
            "/lab/laser_lengt",
            "is it /lab/laser_length",
        ),
        ({"lab__tracer_length": SPOKEN, "x": LENGTH}, "/cell/tracer_length", "are in /lab: set"),
        ({"tracer_length": LENGTH}, "/cell/tracer_length", "are in /: set cell.namespace"),
        ({"cell__mute": LENGTH, "cell__tracer_length": LENGTH}, "/cell/tracer_length", ""),
    ],
)
def test_the_nearest_topic_of_the_right_name_or_type_is_named(topics, own, hint):
    found = graph(**topics).elsewhere("tracer_length", own)
    assert hint in found
    assert bool(hint) == bool(found)
