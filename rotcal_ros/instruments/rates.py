"""How often an instrument speaks, from the stamps of what it said."""

from __future__ import annotations

from collections import deque
from typing import Final

from rotcal_ros.foundation.units import NANOSECOND

_KEPT: Final = 500
_LEAST: Final = 5
_LONGEST_NS: Final = 60_000_000_000
"""A longer pause is a new beginning, or a clock that was set."""


class Rates:
    """The mean rate (Hz) of each stream over its latest messages, pauses of bursts included."""

    def __init__(self) -> None:
        self._stamps: dict[str, deque[int]] = {}

    def note(self, role: str, stamp_ns: int) -> None:
        """Take the stamp of a message."""
        stamps = self._stamps.setdefault(role, deque(maxlen=_KEPT))
        if stamps and not 0 <= stamp_ns - stamps[-1] < _LONGEST_NS:
            stamps.clear()
        stamps.append(stamp_ns)

    def forget(self, role: str) -> None:
        """Begin anew with a stream."""
        self._stamps.pop(role, None)

    def hertz(self) -> dict[str, float]:
        """Return the rates of the streams that are known by now; 0: its stamps stand still."""
        found = {}
        for role, stamps in self._stamps.items():
            span_ns = stamps[-1] - stamps[0]
            if len(stamps) >= _LEAST:
                found[role] = (len(stamps) - 1) / (span_ns * NANOSECOND) if span_ns > 0 else 0.0
        return found
