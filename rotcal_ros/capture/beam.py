"""Finds where a tracer may have lost its beam: a new segment of lengths with its own zero begins.

A tracer counts fringes: its zero holds while the beam is unbroken. It is lost when the status says
so, when the numbers of the readings start anew, when readings are missing for long, and when the
length changes faster than any reflector is carried. The solver estimates a zero per segment.
"""

from __future__ import annotations

from bisect import bisect_right
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats, Stamps
from rotcal_ros.foundation.units import NANOSECOND

WRAP: Final = 1 << 32
"""Sequence numbers are 32 bits wide."""


class Beam:
    """Finds, in readings that come in the order of their stamps, where segments begin.

    ``silence_s``: a longer gap may hide a break; ``fastest``: largest speed of the length, m/s.
    The segments do not depend on how the readings are cut into pieces. ``epoch`` is how often the
    clock of the readings was set back; the zero survives that.
    """

    def __init__(self, silence_s: float, fastest: float) -> None:
        self._silence_ns, self._fastest = silence_s / NANOSECOND, fastest
        self.epoch = 0
        self._begins: list[tuple[int, int]] = []  # epoch and stamp
        self._last: tuple[int, float] | None = None  # the last reading
        self._good: tuple[int, float] | None = None  # stamp and length of the last usable one
        self._lost = False

    def follow(
        self, stamps: Stamps, sequence: Floats, length: Floats, usable: Bools, broken: Bools
    ) -> None:
        """Take further readings, all arrays (n,); ``broken``: the status says so."""
        if not len(stamps):
            return
        if self._last is None:
            self._last = int(stamps[0]), float(sequence[0]) - 1.0
        self.epoch += int(stamps[0]) < self._last[0]
        number = np.append(self._last[1], sequence)
        steps = np.diff(number).astype(np.int64) % WRAP
        pause = np.abs(np.diff(np.append(self._last[0], stamps)))
        anew = (steps == 0) | (steps >= WRAP // 2)  # modulo 2^32 the upper half is a step back
        silent = (steps > 1) & (pause > self._silence_ns)
        lost = np.cumsum(broken | anew | silent)
        self._last = int(stamps[-1]), float(sequence[-1])
        at = np.flatnonzero(usable)
        if len(at):
            self._compare(stamps[at], length[at], lost[at])
        self._lost = bool(lost[-1] > (lost[at[-1]] if len(at) else 0)) or (
            self._lost and not len(at)
        )

    def _compare(self, stamps: Stamps, length: Floats, lost: Floats) -> None:
        """Compare each usable reading with the last one; ``lost`` counts those in between."""
        first = self._good or (int(stamps[0]), float(length[0]))
        before = -1 if self._lost else 0
        moved = np.abs(np.diff(np.append(first[1], length)))
        time = np.abs(np.diff(np.append(first[0], stamps))) * NANOSECOND
        new = (np.diff(np.append(before, lost)) > 0) | (moved > self._fastest * time)
        new[0] &= self._good is not None
        self._begins += ((self.epoch, stamp) for stamp in stamps[new].tolist())
        self._good = int(stamps[-1]), float(length[-1])

    def segment(
        self, since_ns: int, begin_ns: int, end_ns: int, since_epoch: int | None = None
    ) -> int:
        """Return the number of the segment of a window, counted from ``since_ns``.

        The window belongs to the latest epoch; so does ``since_ns`` unless stated otherwise.
        Windows of one unbroken beam have the same number; one that lost the beam shares its number
        with no other, because its mean has no single zero.
        """
        epoch = self.epoch if since_epoch is None else since_epoch
        before = bisect_right(self._begins, (epoch, since_ns))
        ends = (bisect_right(self._begins, (self.epoch, stamp)) for stamp in (begin_ns, end_ns))
        return sum(ends) - 2 * before
