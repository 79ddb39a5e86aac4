"""The large line of the page: what happens now, or what a person has to do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from rotcal_ros.extensions.page.state import Now, Offer
from rotcal_ros.planning.plan import RELEASED, STOPPED

_WORDS: Final = {
    "preflight": "Checking the cell",
    "opening": "Starting the recording",
    "solving": "Computing the deviations",
    "closing": "Closing the recording",
}


@dataclass(frozen=True, slots=True)
class Heard:
    """What was heard of the planner and its goal.

    ``planner`` is its state in words, empty when it is not there; ``silent`` that it was there
    and fell silent. ``calibrating`` that a goal runs: ``activity`` is what it does,
    ``instruction`` what it waits for. ``ended`` holds how the last goal ended, None while there
    was none or it runs: with a verdict, or with an error.
    """

    planner: str = ""
    silent: bool = False
    calibrating: bool = False
    activity: str = ""
    instruction: str = ""
    stopping: bool = False
    ended: bool = False
    canceled: bool = False
    verdict: str = ""
    error: str = ""


def now(heard: Heard, offer: Offer | None = None) -> Now:
    """Return the large line; ``offer`` is a table that waits for a person."""
    if heard.silent:
        return Now("failed", "The planner fell silent", _sentence(heard.error or "nothing moves"))
    if heard.planner and heard.calibrating:
        return _calibrating(heard)
    if offer is not None and not (offer.why_not or offer.applied):
        return Now("confirm", "A table waits for your confirmation",
                   "Look at what it changes, below.")  # fmt: skip
    return _after_the_end(heard) or (_ready(heard.planner) if heard.planner else Now())


def _ready(planner: str) -> Now:
    return Now("ready", "Ready", _sentence(f"the planner is {planner}: no calibration runs"))


def _calibrating(heard: Heard) -> Now:
    if heard.stopping:
        return Now("stopping", "Stopping", "The bag is being closed.")
    if heard.instruction:
        what, _, more = heard.instruction.partition("; ")
        if what.startswith(STOPPED):
            released = what.startswith(RELEASED)
            return Now("emergency", _sentence(what), _sentence(more), resume=released, stop=True,
                       instruction=heard.instruction)  # fmt: skip
        detail = f"{_sentence(more)} Press Continue when it is done."
        return Now("person", _sentence(what), detail.strip(), resume=True, stop=True,
                   instruction=heard.instruction)  # fmt: skip
    word = heard.activity.partition(":")[0].partition(" ")[0]
    if word in _WORDS:
        return Now("measuring", _WORDS[word], stop=True)
    headline = "Measuring" if heard.activity else "Starting"
    return Now("measuring", headline, _sentence(heard.activity), stop=True)


def _after_the_end(heard: Heard) -> Now | None:
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
