"""What is missing around a cell before anything moves; no graph."""

from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_ros.capture.publishers import RUN
from rotcal_ros.methods import changed, prepare, read_configuration
from rotcal_ros.nodes.planner import node
from rotcal_ros.nodes.planner.cell_links import CellLinks
from rotcal_ros.nodes.planner.goal_watch import GoalError, GoalWatch
from rotcal_ros.nodes.runtime.announced_plan import REFUSED_RUN
from rotcal_ros.nodes.runtime.beat_values import LISTENS

STOP = "/safety/estop"


def links(*, publishers, recorded, refused=""):
    """Return the links of a cell without instruments, whose machine obeys every order."""
    found = CellLinks.__new__(CellLinks)
    found.health = SimpleNamespace(
        values=lambda name: {STOP: refused} if refused and name == "recorder" else {}
    )
    found.graph = SimpleNamespace(
        publishers=lambda topic: publishers if topic == STOP else [],
        listeners=lambda topic: ["recorder"] if topic != STOP or recorded else [],
        machine_faults=lambda _: [],
        resolve=lambda topic: topic,
    )
    return found


@pytest.mark.parametrize(
    ("publishers", "recorded", "missing"),
    [
        ([], False, []),  # nobody need publish it
        (["plc"], False, [f"the recorder does not listen to {STOP} yet"]),
        (["plc"], True, []),
    ],
)
def test_a_stop_that_somebody_publishes_is_recorded_before_anything_moves(
    publishers, recorded, missing
):
    cell = links(publishers=publishers, recorded=recorded)
    assert cell.missing_topics((), (), STOP) == missing
    assert cell.missing_topics((), (), "") == []


def test_where_an_instrument_may_be_that_is_not_under_its_name_is_told():
    cell = links(publishers=[], recorded=True)
    cell.instrument = lambda role: f"/cell/{role}"
    cell.graph.instrument_faults = lambda name, _: [f"no node publishes {name}"]
    cell.graph.elsewhere = lambda role, name: f"is it /lab/{role}?" * (role == "tracer_length")
    told, hint, *_ = cell.missing_topics(["tracer_length"])
    assert told == "no node publishes /cell/tracer_length"
    assert hint == "/cell/tracer_length: is it /lab/tracer_length?"
    assert cell.elsewhere(["joint_states"]) == []


def test_why_a_recorder_never_listens_is_told():
    cell = links(publishers=["plc"], recorded=False, refused="its type is not installed")
    told = f"the recorder does not listen to {STOP}: its type is not installed"
    assert cell.missing_topics((), (), STOP) == [told]


def test_the_recorders_own_word_counts_where_the_graph_does_not_name_it():
    cell = links(publishers=["plc"], recorded=False)
    cell.health = SimpleNamespace(values=lambda name: {LISTENS: f"/other {STOP}"})
    assert cell.missing_topics((), (), STOP) == []


def test_a_refusal_counts_for_the_run_that_it_names():
    cell = links(publishers=[], recorded=True)
    beats = {"capture": {REFUSED_RUN: "plan@2 other version"}, "solver": {RUN: "plan@2"}}
    cell.health = SimpleNamespace(values=lambda name: beats[name])
    assert cell.refused_plan("plan@2") == ["node capture refuses the plan: other version"]
    assert cell.refused_plan("plan@1") == []


def test_the_preflight_asks_for_the_stop_of_its_goal(monkeypatch):
    file = Path(__file__).parents[3] / "config" / "tracer.yaml"
    calibration = prepare(changed(read_configuration(file), [f"safety.emergency_stop={STOP}"]))
    monkeypatch.setattr(node, "mismatched_topic_lines", lambda *_: [])
    asked = SimpleNamespace(
        node=None,
        health=SimpleNamespace(values=lambda _: {}),
        unpublished=lambda _: {},
        missing_topics=lambda _topics, _silent, stop: [f"asked for {stop}"],
    )
    assert node._missing(calibration, asked) == [f"asked for {STOP}"]


OURS, NEW = [1] * 16, [2] * 16


def offer(name, gid):
    return SimpleNamespace(node_name=name, node_namespace="/cell", endpoint_gid=gid)


def watched(*offers, machines=(), required=()):
    """Return a watch over a run that hears the tracer, and who publishes its lengths now."""
    there = [offer("tracer", OURS)]
    cell = CellLinks.__new__(CellLinks)
    cell.instrument = lambda role: f"/cell/{role}"
    cell.graph = SimpleNamespace(offers=lambda _: there, machines=lambda _: machines)
    watch = GoalWatch.__new__(GoalWatch)
    watch.links, watch.required = cell, SimpleNamespace(nodes={*required})
    watch.instruments = ["tracer_length"]
    watch.heard = cell.offered(watch.instruments)
    there[:] = offers
    return watch


@pytest.mark.parametrize(
    ("machines", "another_run"), [((), True), (["tracer"], False), (["other"], True)]
)
def test_an_instrument_that_was_started_anew_is_named_and_measured_with_in_another_run(
    machines, another_run
):
    """Nobody heard it before the next run: its steps were rejected for want of lengths."""
    watch = watched(offer("tracer", NEW), machines=machines)
    with pytest.raises(GoalError) as lost:
        watch._check_publishers("at step 3 of 9")
    assert "node tracer, which publishes /cell/tracer_length, was restarted" in str(lost.value)
    assert lost.value.in_another_run == another_run


def test_who_is_there_still_or_belongs_to_the_crew_is_not_started_anew():
    watched(offer("tracer", OURS))._check_publishers("")
    watched(offer("tracer", OURS), offer("tracer", NEW))._check_publishers("")
    watched(offer("stranger", NEW))._check_publishers("")
    watched(offer("tracer", NEW), required=["tracer"])._check_publishers("")
