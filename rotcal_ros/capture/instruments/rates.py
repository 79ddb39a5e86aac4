"""Rates at which instruments send, from the stamps of their messages."""

from __future__ import annotations

from collections import deque
from typing import Final

from rotcal_ros.foundation.units import NANOSECOND

_REMEMBERED: Final = 500
"""Stamps of a stream over which its rate is taken."""
_LEAST: Final = 5
"""From this many messages on there is a rate."""
_LONGEST_NS: Final = 60_000_000_000
"""After a longer pause, or a clock that was set, the rate is counted anew."""


class Rates:
    """The mean rate (Hz) of each stream over its latest messages, including pauses in bursts."""

    def __init__(self) -> None:
        self._stamps: dict[str, deque[int]] = {}

    def note(self, role: str, stamp_ns: int) -> None:
        """Take the stamp of a message."""
        stamps = self._stamps.setdefault(role, deque(maxlen=_REMEMBERED))
        if stamps and not 0 <= stamp_ns - stamps[-1] < _LONGEST_NS:
            stamps.clear()
        stamps.append(stamp_ns)

    def forget(self, role: str) -> None:
        """Count a stream anew."""
        self._stamps.pop(role, None)

    def hertz(self) -> dict[str, float]:
        """Return the rates of the streams with enough messages; 0 if the stamps stand still."""
        rates = {}
        for role, stamps in self._stamps.items():
            span_ns = stamps[-1] - stamps[0]
            if len(stamps) >= _LEAST:
                rates[role] = (len(stamps) - 1) / (span_ns * NANOSECOND) if span_ns > 0 else 0.0
        return rates
