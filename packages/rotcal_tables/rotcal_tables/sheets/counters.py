"""Counts of an encoder: how many make a turn, as far as rows show it; a person says it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import log2, remainder
from statistics import median
from typing import Final

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.units import TURN

_NEAR: Final = 0.01
"""Share by which counts of a turn may differ from the slope of a table that shows them."""
COUNTER_BITS: Final = tuple(str(bits) for bits in range(8, 33))
"""Bits of counters that are looked for where counts do not follow the table."""
_MOST_BITS: Final = 64


def median_counts_per_turn(angles: Sequence[float], counts: Sequence[float]) -> float:
    """Return the counts in a turn by the steps between rows at commanded ``angles`` (rad).

    Most steps do not pass the place where a counter wraps, so the median does not see it.
    """
    steps = [
        ((b - a) / turned * TURN)
        for (x, a), (y, b) in pairwise(zip(angles, counts, strict=True))
        if abs(turned := remainder(y - x, TURN)) > 0.0
    ]
    return median(steps) if steps else 0.0


def possible_counts_per_turn(commanded: Sequence[float]) -> tuple[int, ...]:
    """Return the counts of a turn that steps through it may mean: with the last one and without.

    >>> possible_counts_per_turn([0, 100, 200, 300])
    (400, 300)
    """
    ordered = sorted({*commanded})
    step = min((b - a for a, b in pairwise(ordered)), default=0.0)
    travel = ordered[-1] - ordered[0]
    return tuple(dict.fromkeys(round(n) for n in (travel + step, travel) if n >= 1.0))


def usual_counts_near(about: float) -> tuple[int, ...]:
    """Return usual counts of a turn near those that a table shows: powers of two, round numbers.

    >>> usual_counts_near(65493.0), usual_counts_near(-359880.0)
    ((65536, 65000, 65500), (-360000,))
    """
    size = abs(about)
    if size < 1.0:
        return ()
    digits = len(str(int(size)))
    near = [2 ** round(log2(size)), *(int(round(size, k - digits)) for k in (1, 2, 3))]
    fits = dict.fromkeys(n for n in near if abs(n - size) <= _NEAR * size)
    return tuple(n if about > 0.0 else -n for n in fits)


def counter_period(counter: str) -> int:
    """Return after how many counts a counter begins anew, stated by its bits or by the counts.

    >>> counter_period("16"), counter_period("4000")
    (65536, 4000)
    """
    number = int(counter) if counter.isdecimal() else 0
    if number < 2:
        raise ConfigurationError(
            f"sheet.counter={counter}: expected the bits of the counter, as 16, or the counts "
            "after which it begins anew, as 4000"
        )
    return 1 << number if number <= _MOST_BITS else number


def fits_counter(cells: Sequence[float], bits: str) -> bool:
    """Return whether counts, or means of them, may be of a counter of so many bits."""
    size = counter_period(bits)
    low, high = min(cells), max(cells)
    return high - low < size and -size // 2 <= low and high < size
