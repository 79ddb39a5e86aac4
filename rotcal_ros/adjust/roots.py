"""Where a function of one variable is zero: importing scipy.optimize takes longer than a solve."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Final

import numpy as np

from rotcal_ros.foundation.errors import DataError

MAX_ITERATIONS: Final = 100


def root_between(
    function: Callable[[float], float], a: float, b: float, tolerance: float
) -> float:
    """Return where ``function`` is zero between ``a`` and ``b``, to about ``tolerance``.

    By Ridders' method (IEEE Transactions on Circuits and Systems 26, 979, 1979). Raises DataError
    when the function has the same sign at both ends.
    """
    at_a, at_b = function(a), function(b)
    if at_a == 0.0 or at_b == 0.0:
        return a if at_a == 0.0 else b
    if (at_a < 0.0) == (at_b < 0.0):
        raise DataError(f"no change of sign between {a:g} and {b:g}: {at_a:g} and {at_b:g}")
    before = np.inf
    for _ in range(MAX_ITERATIONS):
        middle = 0.5 * (a + b)
        at_middle = function(middle)
        if at_middle == 0.0:
            return middle
        bent = float(np.sqrt(at_middle**2 - at_a * at_b))  # |f| or more: here is between a and b
        share = at_middle / bent if bent else 0.0  # squares of next to nothing are none
        here = middle + (middle - a) * float(np.sign(at_a)) * share
        at_here = function(here)
        if at_here == 0.0 or abs(here - before) <= tolerance or abs(b - a) <= tolerance:
            return here
        before = here
        ends = sorted([(a, at_a), (middle, at_middle), (here, at_here), (b, at_b)])
        (a, at_a), (b, at_b) = next(
            pair for pair in pairwise(ends) if (pair[0][1] < 0.0) != (pair[1][1] < 0.0)
        )
    return here
