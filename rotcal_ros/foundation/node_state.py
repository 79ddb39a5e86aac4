"""The state of a node of the cell as data, and the one place where it becomes words.

``State`` and ``Why`` are the constants of the messages NodeState and NodeReason: what programs
compare. ``describe`` is for people: on a terminal, on the page, in /diagnostics.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from rotcal_ros.foundation.language import join_texts, phrase


class State(IntEnum):
    """What a node does; UNKNOWN if it was never heard, or belongs to a later version."""

    UNKNOWN = 0
    UNCONFIGURED = 1
    INACTIVE = 2
    WAITING = 3
    LOADING = 4
    IDLE = 5
    READY = 6
    PREPARING = 7
    CALIBRATING = 8
    RECORDING = 9
    WORKING = 10
    MOVING = 11
    SOLVING = 12
    FAILED = 13
    LEAVING = 14

    @classmethod
    def _missing_(cls, value: object) -> State:
        return cls.UNKNOWN


class Why(IntEnum):
    """Why a node is in its state, or what it is doing."""

    UNKNOWN = 0
    TO_CONFIGURE = 1
    TO_ACTIVATE = 2
    NO_PLAN = 10
    NO_TABLE = 11
    NO_FEEDBACK = 12
    NO_ORDER = 13
    NO_ORDER_YET = 14
    PLAN_REFUSED = 20
    CAPTURING = 21
    COLLECTING = 22
    DRAWING = 23
    PRELIMINARY_RESULT = 24
    TOO_FEW_OBSERVATIONS = 25
    FINAL_RESULT = 26
    NO_RESULT = 27
    RECORDING_FAILED = 28
    PREFLIGHT = 40
    PREFLIGHT_NODES = 41
    PREFLIGHT_CLOCKS = 42
    PREFLIGHT_TOPICS = 43
    OPENING_BAG = 44
    MEASURING = 45
    NODES_SLOW = 46
    SOLVING = 47
    CLOSING_BAG = 48
    GOING_ON = 49
    WORK = 60
    STOPPED = 61
    RELEASED = 62
    RELEASED_AND_WORK = 63
    TABLE_REFUSED = 80
    TABLE_WRITTEN = 81
    TABLE_APPLIED = 82
    TABLE_NOT_APPLIED = 83
    TABLE_RESTORED = 84
    TABLE_NOT_RESTORED = 85
    REQUEST_REFUSED = 86
    ORDERED = 100
    HELD = 101
    TRIAL_MOTION = 102
    STARTING = 103
    STARTING_SESSION = 104
    CONNECTING = 105
    READING = 106
    CONNECTION_LOST = 107
    CLOSED = 108
    BLOCKED = 109
    STARTING_AGENT = 110
    SERVING = 120

    @classmethod
    def _missing_(cls, value: object) -> Why:
        return cls.UNKNOWN


RELEASED: Final = frozenset({Why.RELEASED, Why.RELEASED_AND_WORK})
"""An emergency stop is over, and a person has to resume."""
STOPS: Final = frozenset({Why.STOPPED, *RELEASED})
"""Safety has stopped the cell, and only a person lets it go on."""
PAUSES: Final = frozenset({Why.WORK, *STOPS})
"""A goal waits for a person."""


@dataclass(frozen=True, slots=True)
class Reason:
    """A code and the ``arguments`` that fill its text, for people."""

    code: Why
    arguments: tuple[str, ...] = ()

    @classmethod
    def of(cls, code: Why, *arguments: object) -> Reason:
        """Return a reason with arguments of any kind."""
        return cls(code, tuple(map(str, arguments)))

    def describe(self) -> str:
        """Return the reason for a person to read; what a foreign node left out is blank."""
        if self.code is Why.UNKNOWN:
            return "; ".join(self.arguments)
        return phrase(REASONS[self.code], *self.arguments, "", "")

    @property
    def instruction(self) -> str | None:
        """What a person has to do before a goal goes on; None if it does not wait for one."""
        if self.code not in PAUSES:
            return None
        return phrase(INSTRUCTIONS[self.code], *self.arguments, "", "")


@dataclass(frozen=True, slots=True)
class NodeState:
    """The state of a node; ``step`` of ``total`` while it works through a plan.

    ``page`` is the address of the page that it serves.
    """

    state: State = State.UNKNOWN
    reasons: tuple[Reason, ...] = ()
    step: int = 0
    total: int = 0
    page: str = ""

    @classmethod
    def of(cls, state: State, code: Why, *arguments: object) -> NodeState:
        """Return a state with one reason."""
        return cls(state, (Reason.of(code, *arguments),))

    def has(self, code: Why) -> bool:
        """Return whether ``code`` is among the reasons."""
        return any(reason.code is code for reason in self.reasons)

    def describe(self) -> str:
        """Return the state for a person to read."""
        reasons = join_texts([reason.describe() for reason in self.reasons])
        if self.state is State.CALIBRATING:
            return phrase("calibrating: step {0} of {1}, {2}", self.step, self.total, reasons)
        state = phrase(STATES[self.state])
        if self.state in NAMED and reasons:
            return phrase("{0}: {1}", state, reasons)
        return reasons or state


UNHEARD: Final = NodeState()
"""State of a node that was never heard."""
NO_PLAN: Final = NodeState.of(State.WAITING, Why.NO_PLAN)
LOADING: Final = NodeState(State.LOADING)
"""A node loads a method's code, or reads what was measured before."""
SOLVING: Final = NodeState(State.SOLVING)

NAMED: Final = frozenset({State.UNCONFIGURED, State.INACTIVE, State.IDLE, State.MOVING})
"""States that are named before their reasons; for the others the reasons say it all."""
STATES: Final = {
    State.UNKNOWN: "silent",
    State.UNCONFIGURED: "unconfigured",
    State.INACTIVE: "inactive",
    State.WAITING: "waiting",
    State.LOADING: "loading what the plan needs",
    State.IDLE: "idle",
    State.READY: "ready",
    State.PREPARING: "preparing",
    State.CALIBRATING: "calibrating",
    State.RECORDING: "recording",
    State.WORKING: "working",
    State.MOVING: "busy",
    State.SOLVING: "solving",
    State.FAILED: "failed",
    State.LEAVING: "leaving",
}
INSTRUCTIONS: Final = {
    Why.WORK: "{0}",
    Why.STOPPED: "emergency stop: {0}; no motion is commanded, and the current step will be "
    "repeated; recording continues and the bag is safe; release the stop, then resume",
    Why.RELEASED: "emergency stop released, cause: {0}; nothing moves until a person "
    "resumes: make sure that the cell is clear to move",
    Why.RELEASED_AND_WORK: "emergency stop released, cause: {0}; nothing moves until a "
    "person resumes: make sure that the cell is clear to move ({1})",
}
REASONS: Final = {
    Why.TO_CONFIGURE: "ros2 lifecycle set {0} configure && ros2 lifecycle set {0} activate",
    Why.TO_ACTIVATE: "ros2 lifecycle set {0} activate",
    Why.NO_PLAN: "waiting for a plan",
    Why.NO_TABLE: "waiting for a table",
    Why.NO_FEEDBACK: "waiting for feedback",
    Why.NO_ORDER: "waiting for an order",
    Why.NO_ORDER_YET: "no order yet",
    Why.PLAN_REFUSED: "plan refused: {0}",
    Why.CAPTURING: "capturing {0}",
    Why.COLLECTING: "collecting for {0}",
    Why.DRAWING: "drawing {0}",
    Why.PRELIMINARY_RESULT: "preliminary result from {0} observations",
    Why.TOO_FEW_OBSERVATIONS: "not enough observations yet: {0}",
    Why.FINAL_RESULT: "final result, verdict {0}",
    Why.NO_RESULT: "no final result: {0}",
    Why.RECORDING_FAILED: "recording failed: {0}",
    Why.PREFLIGHT: "preflight",
    Why.PREFLIGHT_NODES: "preflight: nodes",
    Why.PREFLIGHT_CLOCKS: "preflight: clocks",
    Why.PREFLIGHT_TOPICS: "preflight: topics",
    Why.OPENING_BAG: "opening the bag",
    Why.MEASURING: "{0}",
    Why.NODES_SLOW: "{0}",
    Why.SOLVING: "solving",
    Why.CLOSING_BAG: "closing the bag",
    Why.GOING_ON: "going on",
    **{code: phrase("paused: {0}", text) for code, text in INSTRUCTIONS.items()},
    Why.TABLE_REFUSED: "table refused: {0}",
    Why.TABLE_WRITTEN: "table {0} written, not applied",
    Why.TABLE_APPLIED: "table applied and verified by reading it back",
    Why.TABLE_NOT_APPLIED: "table not applied: {0}",
    Why.TABLE_RESTORED: "old table restored and verified by reading it back",
    Why.TABLE_NOT_RESTORED: "old table not restored: {0}",
    Why.REQUEST_REFUSED: "request refused: {0}",
    Why.ORDERED: "step {0}, attempt {1}",
    Why.HELD: "held: emergency stop",
    Why.TRIAL_MOTION: "trial motion",
    Why.STARTING: "starting",
    Why.STARTING_SESSION: "starting a session",
    Why.STARTING_AGENT: "starting LinuxCNC's agent",
    Why.CONNECTING: "connecting",
    Why.READING: "measuring",
    Why.CONNECTION_LOST: "connection lost",
    Why.CLOSED: "closed",
    Why.BLOCKED: "{0}",
    Why.SERVING: "serving {0}",
}
