"""What a check of a cell says of its emergency stop; no graph."""

from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_ros.methods.configuration import changed, read_configuration
from rotcal_ros.nodes.check.cell_check import safety_lines

PLAIN = read_configuration(Path(__file__).parents[3] / "config" / "tracer.yaml")
STATED = changed(PLAIN, ["safety.emergency_stop=/safety/estop"])
NONE = changed(PLAIN, ["safety.emergency_stop=''"])
SILENT = changed(PLAIN, ["safety.silent_s=1.0"])
DRIVE = changed(NONE, ["safety.stop_on_diagnostics=[drive]"])


def line_of(configuration, *types):
    offers = [SimpleNamespace(node_name="plc", topic_type=name) for name in types]
    graph = SimpleNamespace(
        offers=lambda _: offers,
        resolve=lambda topic: topic if topic.startswith("/") else f"/cell/{topic}",
    )
    return list(safety_lines(SimpleNamespace(configuration=configuration, graph=graph)))


@pytest.mark.parametrize(
    ("configuration", "types", "state", "words"),
    [
        (STATED, ["std_msgs/msg/Bool"], "good", "node plc publishes /safety/estop"),
        (STATED, [], "doubt", "no node publishes /safety/estop"),
        (STATED, ["std_msgs/msg/Int8"], "missing", "/safety/estop is of type std_msgs/msg/Int8"),
        (PLAIN, [], "note", "no node publishes /cell/emergency_stop"),
        (SILENT, [], "missing", "no node publishes /cell/emergency_stop, and its silence stops"),
        (DRIVE, [], "note", "an ERROR of drive stops the cell"),
    ],
)
def test_who_stops_the_cell_is_told(configuration, types, state, words):
    (line,) = line_of(configuration, *types)
    assert line.state == state
    assert line.found.startswith(words)
    assert bool(line.todo) == (state in ("doubt", "missing"))


def test_a_cell_without_a_stop_has_no_line():
    assert line_of(NONE) == []
