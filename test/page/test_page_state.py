"""What the page says: its large line, and courses that never grow without bound."""

import itertools
from dataclasses import replace

import pytest

from rotcal_ros.foundation.node_state import NodeState, State, Why
from rotcal_ros.page.state import (
    CurrentActivity,
    PageState,
    PlannerStatus,
    ShownOffer,
    StateBoard,
    ValueHistory,
    current_activity,
)

OFFER = ShownOffer("abc", "def", "ok", "", "", "", "", applied=False)
READY = NodeState(State.READY)
CALIBRATING = PlannerStatus(
    NodeState(State.CALIBRATING), calibrating=True, doing=Why.PREFLIGHT_NODES
)


def asking(code, instruction):
    return replace(CALIBRATING, doing=code, instruction=instruction)


@pytest.mark.parametrize(
    ("heard", "kind", "headline", "resume", "stop"),
    [
        (PlannerStatus(), "waiting", "Waiting for the planner", False, False),
        (PlannerStatus(READY), "ready", "Ready", False, False),
        (CALIBRATING, "measuring", "Checking the cell", False, True),
        (replace(CALIBRATING, doing=Why.MEASURING, activity="table position 2, target 1"),
         "measuring", "Measuring", False, True),
        (replace(CALIBRATING, doing=Why.SOLVING),
         "measuring", "Computing the deviations", False, True),
        (asking(Why.WORK, "move the tracker; it must not tilt"),
         "person", "Move the tracker.", True, True),
        (asking(Why.STOPPED, "emergency stop: door is true; wait"),
         "emergency", "Emergency stop: door is true.", False, True),
        (asking(Why.RELEASED, "emergency stop released, cause: d"),
         "emergency", "Emergency stop released, cause: d.", True, True),
        (replace(asking(Why.WORK, "x"), stopping=True),
         "stopping", "Stopping", False, False),
        (PlannerStatus(READY, ended=True, verdict="ok"),
         "done", "Finished, measurement ok", False, False),
        (PlannerStatus(READY, ended=True, canceled=True, error="canceled"),
         "stopped", "Stopped", False, False),
        (PlannerStatus(READY, ended=True, error="node capture fell silent"),
         "failed", "The calibration ended without a result", False, False),
        (PlannerStatus(ended=True, verdict="ok"),
         "done", "Finished, measurement ok", False, False),
        (replace(CALIBRATING, silent=True),
         "failed", "The planner no longer answers", False, False),
    ],
)  # fmt: skip
def test_the_large_line(heard, kind, headline, resume, stop):
    found = current_activity(heard)
    assert (found.kind, found.headline, found.resume, found.stop) == (kind, headline, resume, stop)


def test_continue_is_for_the_instruction_that_is_shown():
    asked = asking(Why.WORK, "move it; do not tilt it")
    assert current_activity(asked).instruction == "move it; do not tilt it"


def test_a_table_waits_only_where_a_person_can_confirm_it():
    ready = PlannerStatus(READY, ended=True, verdict="ok")
    assert current_activity(ready, OFFER).kind == "confirm"
    assert current_activity(PlannerStatus(), OFFER).kind == "confirm"
    assert current_activity(CALIBRATING, OFFER).kind == "measuring"
    for over in (ShownOffer("abc", "def", "ok", "", "", "", "no secret", applied=False),
                 ShownOffer("abc", "def", "ok", "", "", "", "", applied=True)):  # fmt: skip
        assert current_activity(ready, over).kind == "done"


def test_the_reason_of_a_failure_is_told_whole():
    text = "node capture fell silent at step 3 of 60"
    assert current_activity(PlannerStatus(READY, ended=True, error=text)).detail == (
        "Node capture fell silent at step 3 of 60."
    )


def test_a_course_of_eight_hours_keeps_its_ends_in_few_points():
    course = ValueHistory(limit=100)
    for second in range(8 * 3600):
        course.add(second, 20.0)
    times = [t for t, _ in course.points]
    assert len(times) <= 100
    assert times[0] == 0
    assert times[-1] >= 0.97 * 8 * 3600
    assert {b - a for a, b in itertools.pairwise(times)} == {512}


def test_a_board_keeps_what_it_is_not_told_anew():
    board = StateBoard()
    first = board.state
    board.show(now=CurrentActivity("ready", "Ready"))
    assert board.state.cell is first.cell
    assert (first.now, board.state.now.headline) == (PageState().now, "Ready")
