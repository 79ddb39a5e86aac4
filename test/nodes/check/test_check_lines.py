"""What a check of a cell says of versions, strangers and clocks it could not hear; no graph."""

from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_ros.methods.configuration import changed, read_configuration
from rotcal_ros.nodes.check import cell_check
from rotcal_ros.nodes.check.cell_check import _as_it_says, _order_lines, clock_line
from rotcal_ros.nodes.check.snapshot import CellSnapshot, HeaderMonitor
from rotcal_ros.nodes.runtime import message_types
from rotcal_ros.nodes.runtime.cell_graph import PLANNERS, CellGraph
from rotcal_ros.nodes.runtime.message_types import version_mismatch

PLAIN = read_configuration(Path(__file__).parents[3] / "config" / "tracer.yaml")
ADAPTED = changed(PLAIN, ["table_adapter.controller=/drive"])
ORDER = "rotcal_msgs/msg/TableAngle"
TOPICS = ("joint_states", "probe_point", "tracer_length")
HERE, OTHER = "RIHS01_" + "cd" * 32, "RIHS01_" + "ab" * 32


@pytest.fixture(autouse=True)
def installed(monkeypatch):
    """The messages of rotcal_msgs are installed here, no others."""
    hashes = {ORDER: HERE}
    monkeypatch.setattr(message_types, "installed_hash", hashes.get)
    monkeypatch.setattr(message_types, "installed_version", lambda _: "0.1.0")


def seen(configuration, machines=(), heard=None, compared=(), type_hash=None, **values):
    """Return a snapshot: nodes that obey table_angle, and stream -> number of messages."""
    own = [
        SimpleNamespace(node_name=name, topic_type=ORDER, qos_profile=PLANNERS.qos_profile,
                        topic_type_hash=type_hash or HERE)
        for name in machines
    ]  # fmt: skip
    node = SimpleNamespace(
        resolve_topic_name=lambda name: f"/cell/{name}", get_namespace=lambda: "/cell",
        get_subscriptions_info_by_topic=lambda _: own, get_publishers_info_by_topic=lambda _: [],
        get_node_names_and_namespaces=lambda: [(name, "/cell") for name in machines],
    )  # fmt: skip
    watches = {role: HeaderMonitor(count=count) for role, count in (heard or {}).items()}
    calibration = SimpleNamespace(topics=TOPICS)
    return CellSnapshot(
        CellGraph(node), values, watches, configuration, calibration, compared, None
    )


@pytest.mark.parametrize(
    ("configuration", "machines", "states"),
    [
        (PLAIN, ["cmm"], ["good"]),
        (PLAIN, ["simulated_cell"], ["note", "doubt"]),
        (PLAIN, ["cmm", "simulated_cell"], ["good", "missing"]),
        (ADAPTED, ["table_adapter"], ["good"]),
        (ADAPTED, ["table_adapter", "simulated_cell"], ["good", "missing"]),
        (ADAPTED, ["simulated_cell"], ["missing"]),  # rotcal run starts an adapter beside it
        (changed(PLAIN, ["simulation.time_scale=1.0"]), ["simulated_cell"], ["good"]),
    ],
)
def test_a_machine_of_ours_that_nobody_stated_is_named(configuration, machines, states):
    lines = list(_order_lines(seen(configuration, machines), "table_angle"))
    assert [line.state for line in lines] == states
    named = [line for line in lines if "simulated_cell" in line.found and line.state != "good"]
    assert bool(named) == (states != ["good"])
    assert states == ["good"] or "end simulated_cell" in lines[-1].todo


def test_a_machine_with_other_messages_gets_no_tick():
    snapshot = seen(PLAIN, ["cmm"], type_hash=OTHER)
    (line,) = _order_lines(snapshot, "table_angle")
    assert line.state == "missing"
    assert (
        "node cmm has another version of rotcal_msgs/msg/TableAngle: RIHS01_abababab there, "
        in (line.found)
    )
    assert "RIHS01_cdcdcdcd of rotcal_msgs 0.1.0 here" in line.found


@pytest.mark.parametrize("unknown", ["INVALID", "", HERE, OTHER])
def test_a_hash_that_is_unknown_or_the_same_is_no_other_version(unknown):
    assert (version_mismatch(ORDER, unknown) is None) == (unknown != OTHER)
    assert version_mismatch("foreign_msgs/msg/Length", OTHER) is None


@pytest.mark.parametrize(
    ("heard", "compared", "state"),
    [
        ({"joint_states": 100, "tracer_length": 100, "probe_point": 5},
         ("probe_point", "tracer_length"), "good"),
        ({"joint_states": 3, "tracer_length": 3, "probe_point": 1}, (), "missing"),
        ({"joint_states": 100, "tracer_length": 100, "probe_point": 2},
         ("tracer_length",), "open"),
    ],
)  # fmt: skip
def test_clocks_that_could_not_be_heard_enough_are_not_passed(heard, compared, state, monkeypatch):
    monkeypatch.setattr(cell_check, "describe_load", lambda: "load 19.0 on 2 cores")
    line = clock_line(seen(PLAIN, heard=heard, compared=compared))
    assert line.state == state
    assert (state == "good") == ("load 19.0" not in line.found)
    assert state == "good" or "--time 30" in line.todo
    simulated = changed(PLAIN, ["simulation.time_scale=100.0"])
    assert clock_line(seen(simulated, heard=heard, compared=compared)).state in ("good", "note")


@pytest.mark.parametrize(
    ("found", "todo"),
    [
        ("lengths says 500 m, plausible are 20 m (capture.max_length_m): is it in mm? Then set "
         "topics.length_unit: mm", "X, or set topics.length_unit: mm"),
        ("l comes at 5 Hz: 200 take 40 s, more than leaves: set a smaller capture.window_samples, "
         "or a longer time-out",
         "X, or set a smaller capture.window_samples, or a longer time-out"),
        ("stamps of t are 0.40 s behind; if it stays so, add 0.40 to topics.length_clock_offset_s",
         "X, or add 0.40 to topics.length_clock_offset_s"),
        ("j comes at 5 Hz: whether the table moves", "X"),
    ],
)  # fmt: skip
def test_what_to_do_says_what_the_line_above_says(found, todo):
    assert _as_it_says(found, "X") == todo
