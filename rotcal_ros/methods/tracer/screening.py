"""Which lengths are believed: data snooping with a stated chance of a false alarm.

Rule: the normalised residual (residual over its own standard deviation, after Baarda) of every
length is compared with the two-sided normal quantile at ``rejection_significance`` shared among
all lengths. While any exceeds it, the largest of each station is rejected - in the joint variant
only where it is also the largest of its target, because there residuals smear over both - and
everything is adjusted again. A station keeps at least five lengths, a free target four. Rejected
lengths keep their residual against the final solution, and are flagged.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from rotcal_ros.methods.tracer.adjustment import Adjustment
from rotcal_ros.methods.tracer.grid import FREE_TARGET_MINIMUM, STATION_MINIMUM, Grid

Floats = NDArray[np.float64]
Adjust = Callable[[Grid, Floats], Adjustment]


def critical_value(significance: float, n_tests: int) -> float:
    """Return the |test value| that one of ``n_tests`` good lengths exceeds by chance only so often.

    Two-sided normal quantile, ``significance`` shared equally (Bonferroni).
    """
    return float(norm.isf(0.5 * significance / n_tests))


def adjust_and_screen(
    adjust: Adjust, grid: Grid, start: Floats, significance: float
) -> tuple[Grid, Adjustment, dict[int, str]]:
    """Adjust ``grid`` from ``start`` (m, 4) until no length stands out.

    Returns the grid with the rejected lengths unused, the last adjustment, and why each was
    rejected, by row of the problem.
    """
    limit = critical_value(significance, int(grid.used.sum()))
    why: dict[int, str] = {}
    fit = adjust(grid, start)
    while (rejected := _outliers(grid, fit, limit)).any():
        for j, i in np.argwhere(rejected):
            why[int(grid.row[j, i])] = (
                f"station {grid.station_ids[j]}, target {grid.target_ids[i]}: test value "
                f"{fit.test_value[j, i]:+.1f} beyond {limit:.2f} "
                f"(residual {fit.residual[j, i]:+.3g} m)"
            )
        grid = replace(grid, used=grid.used & ~rejected)
        fit = adjust(grid, fit.state)
    return grid, fit, why


def _outliers(grid: Grid, fit: Adjustment, limit: float) -> NDArray[np.bool_]:
    """Return (m, n) which lengths to reject in this round."""
    size = np.where(grid.used, np.abs(fit.test_value), 0.0)
    size[grid.used.sum(axis=1) <= STATION_MINIMUM] = 0.0
    if grid.free:
        size[:, grid.used.sum(axis=0) <= FREE_TARGET_MINIMUM] = 0.0
    outliers = (size > limit) & (size == size.max(axis=1, keepdims=True))
    if fit.unknowns > 4 * len(size):  # targets were adjusted too
        outliers &= size == size.max(axis=0)
    return np.asarray(outliers, dtype=np.bool_)
