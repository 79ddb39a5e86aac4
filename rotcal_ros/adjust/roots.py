"""Where a function of one variable is zero.

Like :func:`scipy.optimize.brentq`, to the last bit; importing scipy.optimize takes longer than to
solve a bag.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from rotcal_ros.foundation.errors import DataError

RELATIVE: Final = 4.0 * 2.0**-52
"""Share of the root below which an interval is not made smaller."""
MAX_ITERATIONS: Final = 100


def root_between(
    function: Callable[[float], float], a: float, b: float, tolerance: float
) -> float:
    """Return where ``function`` is zero between ``a`` and ``b``, to about ``tolerance``.

    Inverse quadratic steps while they shrink, bisection else (Brent 1973, Algorithms for
    Minimization without Derivatives, chapter 4). Raises DataError when the function has the same
    sign at both ends.
    """
    before, here, opposite = a, b, 0.0
    f_before, f_here, f_opposite = function(a), function(b), 0.0
    step_before = step = 0.0
    if f_before == 0.0:
        return before
    if f_here == 0.0:
        return here
    if (f_before < 0.0) == (f_here < 0.0):
        raise DataError(f"no change of sign between {a:g} and {b:g}: {f_before:g} and {f_here:g}")
    for _ in range(MAX_ITERATIONS):
        if f_before != 0.0 and (f_before < 0.0) != (f_here < 0.0):
            opposite, f_opposite = before, f_before
            step_before = step = here - before
        if abs(f_opposite) < abs(f_here):
            before, here, opposite = here, opposite, here
            f_before, f_here, f_opposite = f_here, f_opposite, f_here
        least = 0.5 * (tolerance + RELATIVE * abs(here))
        halving = 0.5 * (opposite - here)
        if f_here == 0.0 or abs(halving) < least:
            break
        trial = None
        if abs(step_before) > least and abs(f_here) < abs(f_before):
            trial = _interpolated(before, here, opposite, f_before, f_here, f_opposite)
        if trial is not None and 2.0 * abs(trial) < min(
            abs(step_before), 3.0 * abs(halving) - least
        ):
            step_before, step = step, trial
        else:
            step_before = step = halving
        before, f_before = here, f_here
        here += step if abs(step) > least else least if halving > 0.0 else -least
        f_here = function(here)
    return here


def _interpolated(
    before: float, here: float, opposite: float, f_before: float, f_here: float, f_opposite: float
) -> float | None:
    """Return the step to the zero of the line or the inverse parabola through the points.

    None where their differences are too small for a number.
    """
    if before == opposite:
        return -f_here * (here - before) / (f_here - f_before)
    first = (f_before - f_here) / (before - here)
    second = (f_opposite - f_here) / (opposite - here)
    slope = f_opposite * second - f_before * first
    bent = second * first * (f_opposite - f_before)
    return -f_here * slope / bent if bent else None
