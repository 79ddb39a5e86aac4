"""The large line of the page: what happens now, or what a person has to do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from rotcal_ros.extensions.page.state import Now, ShownOffer
from rotcal_ros.foundation.node_state import RELEASED, STOPS, UNHEARD, NodeState, State, Why

_HEADLINES: Final = {
    **dict.fromkeys(
        (Why.PREFLIGHT, Why.PREFLIGHT_NODES, Why.PREFLIGHT_CLOCKS, Why.PREFLIGHT_TOPICS),
        "Checking the cell",
    ),
    Why.OPENING_BAG: "Starting the recording",
    Why.SOLVING: "Computing the deviations",
    Why.CLOSING_BAG: "Closing the recording",
}


@dataclass(frozen=True, slots=True)
class HeardPlanner:
    """What was heard of the planner and its goal.

    ``planner`` is its state, UNKNOWN if it is not there; ``silent``: it was there and fell silent.
    ``calibrating``: a goal runs; ``doing`` and ``activity`` say what it does, as a code and in
    words, ``instruction`` what it waits for. ``ended``: the last goal has ended, with a verdict or
    an error.
    """

    planner: NodeState = UNHEARD
    silent: bool = False
    calibrating: bool = False
    doing: Why = Why.UNKNOWN
    activity: str = ""
    instruction: str = ""
    stopping: bool = False
    ended: bool = False
    canceled: bool = False
    verdict: str = ""
    error: str = ""


def now(heard: HeardPlanner, offer: ShownOffer | None = None) -> Now:
    """Return the large line; ``offer`` is a table that waits for a person."""
    if heard.silent:
        return Now("failed", "The planner fell silent", _sentence(heard.error or "nothing moves"))
    here = heard.planner.state is not State.UNKNOWN
    if here and heard.calibrating:
        return _calibrating(heard)
    if offer is not None and not (offer.why_not or offer.applied):
        return Now("confirm", "A table waits for your confirmation",
                   "Look at what it changes, below.")  # fmt: skip
    return _after_the_end(heard) or (_ready(heard.planner) if here else Now())


def _ready(planner: NodeState) -> Now:
    words = f"the planner is {planner.in_words()}: no calibration runs"
    return Now("ready", "Ready", _sentence(words))


def _calibrating(heard: HeardPlanner) -> Now:
    if heard.stopping:
        return Now("stopping", "Stopping", "The bag is being closed.")
    if heard.instruction:
        what, _, more = heard.instruction.partition("; ")
        if heard.doing in STOPS:
            released = heard.doing in RELEASED
            return Now("emergency", _sentence(what), _sentence(more), resume=released, stop=True,
                       instruction=heard.instruction)  # fmt: skip
        detail = f"{_sentence(more)} Press Continue when it is done."
        return Now("person", _sentence(what), detail.strip(), resume=True, stop=True,
                   instruction=heard.instruction)  # fmt: skip
    if heard.doing in _HEADLINES:
        return Now("measuring", _HEADLINES[heard.doing], stop=True)
    headline = "Measuring" if heard.activity else "Starting"
    return Now("measuring", headline, _sentence(heard.activity), stop=True)


def _after_the_end(heard: HeardPlanner) -> Now | None:
    if not heard.ended:
        return None
    if heard.canceled:
        return Now("stopped", "Stopped", _sentence(heard.error))
    if heard.error:
        return Now("failed", "The calibration ended without a result", _sentence(heard.error))
    return Now("done", f"Finished, measurement {heard.verdict}",
               "The result and its bag are on disk.")  # fmt: skip


def _sentence(words: str) -> str:
    words = words.strip()
    if not words:
        return ""
    return words[0].upper() + words[1:] + ("" if words[-1] in ".!?" else ".")
