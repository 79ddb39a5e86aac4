"""The stamps of a stream."""

from __future__ import annotations

import numpy as np

from rotcal_ros.foundation.arrays import Stamps
from rotcal_ros.foundation.units import NANOSECOND


class Ticks:
    """The stamps of a stream at a fixed rate, counted from the start."""

    def __init__(self, start_ns: int, rate_hz: float) -> None:
        self._start_ns, self._period_ns = start_ns, max(1, round(1.0 / (rate_hz * NANOSECOND)))
        self._next = 0

    def until(self, now_ns: int) -> tuple[int, Stamps]:
        """Return the number of the next tick and the stamps of all ticks up to ``now_ns``."""
        first = self._next
        self._next = max(first, (now_ns - self._start_ns) // self._period_ns + 1)
        numbers = np.arange(first, self._next, dtype=np.int64)
        return first, self._start_ns + numbers * self._period_ns
