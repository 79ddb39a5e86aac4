"""What is missing around a cell before anything moves; no graph."""

from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_ros.catalogue import changed, prepare, read_configuration
from rotcal_ros.nodes import goal_preflight
from rotcal_ros.nodes.cell_links import CellLinks

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
        without_machine=lambda _: [],
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


def test_why_a_recorder_never_listens_is_told():
    cell = links(publishers=["plc"], recorded=False, refused="its type is not installed")
    told = f"the recorder does not listen to {STOP}: its type is not installed"
    assert cell.missing_topics((), (), STOP) == [told]


def test_the_preflight_asks_for_the_stop_of_its_goal(monkeypatch):
    file = Path(__file__).parents[2] / "config" / "tracer.yaml"
    calibration = prepare(changed(read_configuration(file), [f"safety.emergency_stop={STOP}"]))
    monkeypatch.setattr(goal_preflight, "names_at_odds", lambda *_: [])
    asked = SimpleNamespace(
        node=None,
        health=SimpleNamespace(values=lambda _: {}),
        missing_air=lambda _: {},
        missing_topics=lambda _topics, _silent, stop: [f"asked for {stop}"],
    )
    assert goal_preflight._missing(calibration, asked) == [f"asked for {STOP}"]
