"""How a node stands, as data and in words."""

import re
from pathlib import Path

import pytest

from rotcal_ros.foundation.node_state import (
    INSTRUCTIONS,
    PAUSES,
    REASONS,
    STATES,
    UNHEARD,
    NodeState,
    Reason,
    State,
    Why,
)

MESSAGES = Path(__file__).parents[2] / "msg_defs" / "msg"


def constants(message, prefix=""):
    """Return the constants of a message, name -> value."""
    text = (MESSAGES / f"{message}.msg").read_text(encoding="utf-8")
    found = re.findall(r"^uint(?:8|16) ([A-Z_]+)=(\d+)", text, re.MULTILINE)
    return {n.removeprefix(prefix): int(v) for n, v in found if n.startswith(prefix)}


def test_the_constants_are_those_of_the_messages():
    assert constants("NodeState", "STATE_") == {state.name: state.value for state in State}
    assert constants("NodeReason") == {code.name: code.value for code in Why}


def test_every_code_has_its_words():
    assert STATES.keys() == set(State)
    assert REASONS.keys() == set(Why) - {Why.UNKNOWN}
    assert INSTRUCTIONS.keys() == PAUSES


@pytest.mark.parametrize(
    ("state", "words"),
    [
        (UNHEARD, "silent"),
        (NodeState(State.READY), "ready"),
        (NodeState.of(State.WAITING, Why.NO_PLAN), "waiting for a plan"),
        (NodeState.of(State.MOVING, Why.ORDERED, 3, 1), "busy: step 3, attempt 1"),
        (NodeState.of(State.IDLE, Why.NO_ORDER_YET), "idle: no order yet"),
        (
            NodeState.of(State.UNCONFIGURED, Why.TO_CONFIGURE, "/cell/capture"),
            "unconfigured: ros2 lifecycle set /cell/capture configure && "
            "ros2 lifecycle set /cell/capture activate",
        ),
        (
            NodeState(State.CALIBRATING, (Reason(Why.PREFLIGHT_NODES),), 0, 60),
            "calibrating: step 0 of 60, preflight: nodes",
        ),
        (NodeState.of(State.FAILED, Why.PLAN_REFUSED, "it is {0}"), "plan refused: it is {0}"),
    ],
)
def test_a_state_in_words(state, words):
    assert state.describe() == words


def test_what_is_asked_of_a_person_is_told_with_and_without_that_it_is_a_pause():
    work = Reason.of(Why.WORK, "put the tracker there")
    assert (work.instruction, work.describe()) == (
        "put the tracker there", "paused: put the tracker there"
    )  # fmt: skip
    over = Reason.of(Why.RELEASED_AND_WORK, "the door was open", "put it there")
    assert over.instruction == (
        "emergency stop released, cause: the door was open; nothing moves until a person "
        "resumes: make sure that the cell is clear to move (put it there)"
    )
    assert Reason.of(Why.MEASURING, "target 3").instruction is None


def test_what_a_later_version_or_a_stranger_tells_is_read_as_far_as_it_can_be():
    assert (State(99), Why(9999)) == (State.UNKNOWN, Why.UNKNOWN)
    assert Reason(Why(9999), ("a", "b")).describe() == "a; b"
    assert Reason(Why.ORDERED).describe() == "step , attempt "
    assert Reason(Why.NO_PLAN, ("more",)).describe() == "waiting for a plan"
