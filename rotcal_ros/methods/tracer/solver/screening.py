"""Which lengths are believed: data snooping with a stated chance of a false alarm.

Nothing is rejected before the noise is consistent (:mod:`.noise`): where the statements are
contradicted, the components are estimated first, with large residuals bent so that outliers do
not pass for noise, and estimated again after every round.

Rule: the normalised residual (residual over its own standard deviation, after Baarda) of every
length is compared with the two-sided normal quantile at ``rejection_significance`` shared among
all lengths. While any exceeds it, the largest of each station is rejected - in the joint variant
only where it is also the largest of its target, because there residuals smear over both - and
everything is adjusted again. A station keeps one length more than it has unknowns, which is five
where nothing ties it to others, a free target four. Rejected
lengths keep their residual against the final solution, and are flagged.

Where the machine's coordinates are observations too, they are tested by the same rule: a target
whose correction stands out more than any of its lengths loses all of them.

Before single lengths are judged, groups are (:mod:`.gathering`): where it is proved that some of a
station's lengths are off together, that subset is left out which explains them best, and then the
rest is judged. A length that is the largest of its station is often a good one there.

A network is preceded by a coarse round of the same rule, station by station: a free
network is too limber to be bent by gross errors and still converge.

The variant "station" sees the targets' errors as noise, five times that of a length or more, and
would miss what its angles feel: they owe their accuracy to errors that are common to all
stations. So its lengths are screened as a joint network too. A length that goes at one station
takes its target's error out of what is common; see :func:`without_targets`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from rotcal_ros.adjust.distributions import normal_isf
from rotcal_ros.adjust.gathering import Gathering, judged
from rotcal_ros.adjust.groups import Group, Undivided
from rotcal_ros.foundation.arrays import Bools, Floats
from rotcal_ros.methods.tracer.solver.adjustment import Adjuster, Adjustment
from rotcal_ros.methods.tracer.solver.gathering import left_out
from rotcal_ros.methods.tracer.solver.grid import FREE_TARGET_MINIMUM, Grid
from rotcal_ros.methods.tracer.solver.noise import (
    LEAST_FACTOR,
    NoiseEvidence,
    NoiseFactors,
    as_stated,
    estimate_noise,
    noise_evidence,
    scaled,
)
from rotcal_ros.methods.tracer.solver_settings import TracerLimits

GROSS: Final = 5.0
"""Margin of the coarse round over the fine one."""
HARDLY_CHECKED: Final = 0.01
"""Redundancy of a length below which its residual, next to none, tells nothing of its error."""
NORMAL_QUARTILE: Final = 0.6745
"""Median of |x| for a standard normal x."""


def critical_value(significance: float, n_tests: int) -> float:
    """Return the |test value| from which a length is not believed.

    Two-sided normal quantile, ``significance`` shared equally among ``n_tests`` (Bonferroni).
    """
    return normal_isf(0.5 * significance / n_tests)


def rejection_limit(grid: Grid, significance: float) -> float:
    """Return the critical value for all lengths of ``grid`` and, unless free, all coordinates."""
    n_lengths = int((grid.row >= 0).sum())
    return critical_value(significance, n_lengths + (0 if grid.free else grid.targets.size))


@dataclass(frozen=True, eq=False)
class ScreenedLengths:
    """A grid without outliers, as stated; its noise, and the adjustment with that noise.

    ``why`` says by row of the problem why a length was rejected, ``gathering`` what gathers.
    """

    grid: Grid
    noise: NoiseFactors
    fit: Adjustment
    why: dict[int, str]
    gathering: Gathering = field(default_factory=Gathering)

    @property
    def evidence(self) -> NoiseEvidence:
        """What the residuals say about the noise that was used."""
        return noise_evidence(scaled(self.grid, self.noise.factors), self.fit)


Grouping = Callable[[Grid, Adjustment], tuple[Group | Undivided, ...]]
"""What makes the groups of a network at its solution."""


def adjust_and_screen(
    adjust: Adjuster,
    grid: Grid,
    start: Floats,
    limits: TracerLimits,
    grouping: Grouping | None = None,
) -> ScreenedLengths:
    """Adjust ``grid`` from ``start`` (m, 4) until noise and residuals fit, and none stands out."""
    limit = rejection_limit(grid, limits.rejection_significance)
    why: dict[int, str] = {}
    stated, noise, bent = adjust(grid, start), as_stated(grid), True
    gathering = Gathering()
    while True:
        noise, fit = _settled(adjust, grid, stated, noise, limits.noise_significance, bent)
        rejected, reasons = _outliers(grid, fit, limit), None
        if grouping is not None and (rejected.any() or not bent):
            here = scaled(grid, noise.factors)
            rest = (fit.chi2, float(fit.dof)) if noise.estimated else None
            gathering = judged(gathering, grouping(here, fit), rest)
            if (found := left_out(gathering, grid, limits)) is not None:
                gathering, rejected, reasons = found
        if rejected.any():
            why |= reasons or _reasons(grid, fit, rejected, limit)
            grid = replace(grid, used=grid.used & ~rejected)
            stated = adjust(grid, fit.state)
        elif bent:
            bent = False
        else:
            return ScreenedLengths(grid, noise, fit, why, gathering)


def _settled(
    adjust: Adjuster,
    grid: Grid,
    stated: Adjustment,
    before: NoiseFactors,
    significance: float,
    bent: bool,
) -> tuple[NoiseFactors, Adjustment]:
    """Return the noise as stated, or estimated where that is contradicted, and its fit."""
    chance = noise_evidence(grid, stated, bent).probabilities()
    if chance.min() >= significance / len(chance):
        return as_stated(grid), stated
    noise, fit = estimate_noise(adjust, grid, stated, before.factors, bent)
    if noise.factors[0] < LEAST_FACTOR * (1.0 + 1e-9):
        return as_stated(grid), stated
    return noise, fit


def reject(
    adjust: Adjuster, grid: Grid, start: Floats, significance: float
) -> tuple[Grid, dict[int, str]]:
    """Return ``grid`` without what stands out from the noise as stated, and why, by row."""
    limit = rejection_limit(grid, significance)
    why: dict[int, str] = {}
    fit = adjust(grid, start)
    while (rejected := _outliers(grid, fit, limit)).any():
        why |= _reasons(grid, fit, rejected, limit)
        grid = replace(grid, used=grid.used & ~rejected)
        fit = adjust(grid, fit.state)
    return grid, why


def _reasons(grid: Grid, fit: Adjustment, rejected: Bools, limit: float) -> dict[int, str]:
    return {int(grid.row[j, i]): _reason(grid, fit, j, i, limit) for j, i in np.argwhere(rejected)}


def _name(grid: Grid, j: int, i: int) -> str:
    return f"station {grid.position_ids[grid.station[j]]}, target {grid.target_ids[i]}"


def _reason(grid: Grid, fit: Adjustment, j: int, i: int, limit: float) -> str:
    name = _name(grid, j, i)
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
    adjust: Adjuster, grid: Grid, start: Floats, significance: float
) -> tuple[Grid, dict[int, str]]:
    """Return ``grid`` without gross errors, and why those were rejected, by row.

    ``adjust`` works station by station. What targets and lengths usually miss there is read off
    the median residual of those that others check; a length is gross when it misses by GROSS
    times as much as the rule of :func:`adjust_and_screen` would allow. Repeated while it finds
    something.
    """
    why: dict[int, str] = {}
    while True:
        fit = adjust(grid, start)
        checked = grid.used & (fit.redundancy > HARDLY_CHECKED)
        if not checked.any():
            return grid, why
        miss = np.abs(fit.residual[checked]) / np.sqrt(fit.redundancy[checked])
        usual = GROSS * max(float(np.median(miss)) / NORMAL_QUARTILE, 1e-9)
        coarse = replace(grid, target_std=np.full_like(grid.target_std, usual))
        coarse, found = reject(adjust, coarse, start, significance)
        if not found:
            return grid, why
        why |= found
        grid = replace(grid, used=coarse.used)


def _outliers(grid: Grid, fit: Adjustment, limit: float) -> Bools:
    """Return (m, n) which lengths to reject in this round."""
    size = np.where(grid.used, np.abs(fit.test_value), 0.0)
    size[(grid.per_station(grid.used) <= grid.station_minimum + 1)[grid.station]] = 0.0
    if grid.free:
        size[:, grid.used.sum(axis=0) <= FREE_TARGET_MINIMUM] = 0.0
    outliers = (size > limit) & (size == grid.largest_of_station(size))
    if fit.unknowns > grid.unknowns:  # targets were adjusted too
        outliers &= size == size.max(axis=0)
    worst = int(np.argmax(fit.target_test))
    if fit.target_test[worst] > max(limit, size[:, worst].max()):
        outliers[:, worst] = grid.used[:, worst]
    return np.asarray(outliers, dtype=np.bool_)


def without_targets(grid: Grid, screened: Grid) -> tuple[Grid, dict[int, str]]:
    """Return ``screened`` without the targets that lost some of the lengths of ``grid``, and why.

    By row, for the lengths that go with the rejected ones: a target in use everywhere or nowhere
    keeps its error common to all stations, and that cancels in the angle.
    """
    lost = (grid.used & ~screened.used).any(axis=0)
    why = {
        int(grid.row[j, i]): (
            f"{_name(grid, j, i)}: left out with the target's rejected lengths, so that its "
            "error stays common to all stations"
        )
        for j, i in np.argwhere(screened.used & lost)
    }
    return replace(screened, used=screened.used & ~lost), why
