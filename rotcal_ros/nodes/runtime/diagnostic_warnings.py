"""Warnings of a node for people: in its beat and in /diagnostics, as long as they last."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any, Final

REJECTED: Final = "rejected_running"
"""Attempts that were rejected since the last accepted one, and why."""
COMPLAINT: Final = "complaint"
"""What keeps the present order from being measured."""
PREFLIGHT: Final = "preflight"
"""What looks wrong about the instruments before anything moves."""
OFFSET: Final = "clock_offset"
"""Streams whose clocks differ, and by how much."""
CLOCK_DOUBT: Final = "clock_doubt"
"""Streams whose clocks seem to differ by less than what is rejected."""
FOREIGN_PLAN: Final = "foreign_plan"
"""A plan that is not the planner's."""
INTRUDER: Final = "intruder"
"""Who publishes on a topic of the run and was not there when it began."""
SIM_CLOCK: Final = "sim_clock"
"""That ``/clock`` stands still, or does not come, for a node that follows it."""
EMERGENCY: Final = "emergency_stop"
"""Who stops the cell, and what this node does meanwhile."""
BLOCKED: Final = "blocked"
"""Why a machine does nothing until a person has cleared it."""
SLOW: Final = "slow"
"""Who is slow and waited for, with the load of the machine."""
FOR_PEOPLE: Final = (
    REJECTED, COMPLAINT, PREFLIGHT, OFFSET, CLOCK_DOUBT, FOREIGN_PLAN, INTRUDER, SIM_CLOCK,
    BLOCKED, SLOW,
)  # fmt: skip
"""Values in a beat that are shown to the person who runs a calibration."""
OF_MACHINES: Final = (BLOCKED, COMPLAINT)
"""Values in a beat that may be why a calibration cannot go on."""


def show(health: Any, key: str, text: str | None, *, alarm: bool = False) -> None:
    """Show ``text`` as a warning, or as an error with ``alarm``; None: it is over."""
    for book, is_its in ((health.concerns, not alarm), (health.alarms, alarm)):
        book.pop(key, None)
        if text and is_its:
            book[key] = text


def concerns_told(health: Any, keys: Collection[str] = FOR_PEOPLE) -> Iterator[str]:
    """Yield the present warnings of the other nodes under these ``keys``."""
    for name in health.others:
        values = health.values(name)
        yield from (f"{name}: {values[key]}" for key in keys if key in values)
