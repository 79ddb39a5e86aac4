"""Which lengths are believed: data snooping with a stated chance of a false alarm.

Rule: the normalised residual (residual over its own standard deviation, after Baarda) of every
length is compared with the two-sided normal quantile at ``rejection_significance`` shared among
all lengths. While any exceeds it, the largest of each station is rejected - in the joint variant
only where it is also the largest of its target, because there residuals smear over both - and
everything is adjusted again. A station keeps at least five lengths, a free target four. Rejected
lengths keep their residual against the final solution, and are flagged.

Where the machine's coordinates are observations too, they are tested by the same rule: a target
whose correction stands out more than any of its lengths loses all of them.

The joint variant is preceded by a coarse round of the same rule, station by station: a free
network is too limber to be bent by gross errors and still converge.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from rotcal_ros.arrays import Bools, Floats
from rotcal_ros.methods.distributions import normal_isf
from rotcal_ros.methods.tracer.adjustment import Adjustment
from rotcal_ros.methods.tracer.grid import FREE_TARGET_MINIMUM, STATION_MINIMUM, Grid

GROSS: Final = 5.0
"""Margin of the coarse round over the fine one."""
NORMAL_QUARTILE: Final = 0.6745
"""Median of |x| for a standard normal x."""

Adjust = Callable[[Grid, Floats], Adjustment]


def critical_value(significance: float, n_tests: int) -> float:
    """Return the |test value| from which a length is not believed.

    Two-sided normal quantile, ``significance`` shared equally among ``n_tests`` (Bonferroni).
    """
    return normal_isf(0.5 * significance / n_tests)


def rejection_limit(grid: Grid, significance: float) -> float:
    """Return the critical value for all lengths of ``grid`` and, unless free, all coordinates."""
    n_lengths = int((grid.row >= 0).sum())
    return critical_value(significance, n_lengths + (0 if grid.free else grid.targets.size))


def adjust_and_screen(
    adjust: Adjust, grid: Grid, start: Floats, significance: float
) -> tuple[Grid, Adjustment, dict[int, str]]:
    """Adjust ``grid`` from ``start`` (m, 4) until no length stands out.

    Returns the grid with the rejected lengths unused, the last adjustment, and why each was
    rejected, by row of the problem.
    """
    limit = rejection_limit(grid, significance)
    why: dict[int, str] = {}
    fit = adjust(grid, start)
    while (rejected := _outliers(grid, fit, limit)).any():
        for j, i in np.argwhere(rejected):
            why[int(grid.row[j, i])] = _reason(grid, fit, j, i, limit)
        grid = replace(grid, used=grid.used & ~rejected)
        fit = adjust(grid, fit.state)
    return grid, fit, why


def _reason(grid: Grid, fit: Adjustment, j: int, i: int, limit: float) -> str:
    name = f"station {grid.position_ids[j]}, target {grid.target_ids[i]}"
    value = fit.test_value[j, i]
    if fit.target_test[i] > max(limit, abs(value)):
        miss = float(np.linalg.norm(fit.targets[i] - grid.targets[i]))
        return (
            f"{name}: the target's coordinates miss its lengths by {miss:.3g} m, test value "
            f"{fit.target_test[i]:.1f} beyond {limit:.2f}"
        )
    residual = fit.residual[j, i]
    return f"{name}: test value {value:+.1f} beyond {limit:.2f} (residual {residual:+.3g} m)"


def reject_gross(
    adjust: Adjust, grid: Grid, start: Floats, significance: float
) -> tuple[Grid, dict[int, str]]:
    """Return ``grid`` without gross errors, and why those were rejected, by row.

    ``adjust`` works station by station. What targets and lengths usually miss there is read off
    the median residual; a length is gross when it misses by GROSS times as much as the rule
    of :func:`adjust_and_screen` would allow. Repeated while it finds something.
    """
    why: dict[int, str] = {}
    while True:
        residual = np.abs(adjust(grid, start).residual[grid.used])
        usual = GROSS * max(float(np.median(residual)) / NORMAL_QUARTILE, 1e-9)
        coarse = replace(grid, target_std=np.full_like(grid.target_std, usual))
        coarse, _, found = adjust_and_screen(adjust, coarse, start, significance)
        if not found:
            return grid, why
        why |= found
        grid = replace(grid, used=coarse.used)


def _outliers(grid: Grid, fit: Adjustment, limit: float) -> Bools:
    """Return (m, n) which lengths to reject in this round."""
    size = np.where(grid.used, np.abs(fit.test_value), 0.0)
    size[grid.used.sum(axis=1) <= STATION_MINIMUM] = 0.0
    if grid.free:
        size[:, grid.used.sum(axis=0) <= FREE_TARGET_MINIMUM] = 0.0
    outliers = (size > limit) & (size == size.max(axis=1, keepdims=True))
    if fit.unknowns > 4 * len(size):  # targets were adjusted too
        outliers &= size == size.max(axis=0)
    worst = int(np.argmax(fit.target_test))
    if fit.target_test[worst] > max(limit, size[:, worst].max()):
        outliers[:, worst] = grid.used[:, worst]
    return np.asarray(outliers, dtype=np.bool_)
