"""How large the noise really is, and which lengths are believed.

Nothing is rejected before the noise is consistent. The observations fall into components, each
with a factor s on its stated standard deviations:

lengths
    the constant part of the noise of a length;
distance
    the part that grows with the distance, where one is stated;
targets x, targets y, targets z
    the machine's coordinates, axis by axis, where they are observations.

They are tested, and estimated where the statement is contradicted, as in ``adjust.noise``.
The targets' axes are coupled in the prior, so that an axis which the lengths cannot check follows
the others. While outliers are searched for, large residuals are bent, so that outliers do not pass
for noise, and the factors are estimated again after every round.

Rule of rejection: the normalised residual (residual over its own standard deviation, after Baarda)
of every length is compared with the two-sided normal quantile at ``rejection_significance`` shared
among all lengths. While any exceeds it, the largest of each station is rejected - in the joint
variant only where it is also the largest of its target, because there residuals smear over both -
and everything is adjusted again. A station keeps one length more than it has unknowns, which is
five where nothing ties it to others, a free target four. Rejected lengths keep their residual
against the final solution, and are flagged.

Where the machine's coordinates are observations too, they are tested by the same rule: a target
whose correction stands out more than any of its lengths loses all of them.

Before single lengths are judged, groups are: a disturbance often spoils several lengths at once.
Warm air or a person beside the machine makes the beams of *one* station too long in one sector,
something happens for a while. Groups are the stations and the stretches of time, of which the
engine says what gathers in them (:mod:`rotcal_ros.adjust`), and the targets, whose chi-squared and
rejected share are judged by the same rules. Where it is proved that some of a station's lengths
are off together, that subset is left out which explains them best, and then the rest is judged: a
length that is the largest of its station is often a good one there. What is only probable joins
the covariance.

A network is preceded by a coarse round of the same rule, station by station: a free network is too
limber to be bent by gross errors and still converge.

The variant "station" sees the targets' errors as noise, five times that of a length or more, and
would miss what its angles feel: they owe their accuracy to errors that are common to all stations.
So its lengths are screened as a joint network too. A length that goes at one station takes its
target's error out of what is common; see :func:`without_targets`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np

from rotcal_ros.adjust import gathering as engine
from rotcal_ros.adjust.distributions import normal_isf
from rotcal_ros.adjust.gathering import SUSPECTED, Gathering, Words, judged
from rotcal_ros.adjust.groups import Group, Undivided
from rotcal_ros.adjust.noise import (
    LEAST_FACTOR,
    NEARLY_SETTLED,
    PRIOR,
    SETTLED,
    EstimatedFactors,
    NoiseEvidence,
    bent_squares,
    estimate_factors,
)
from rotcal_ros.adjust.reliability import hidden
from rotcal_ros.adjust.subsets import neighbourhoods, runs
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.protection import POWER, Protection
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.methods.tracer.settings import TracerLimits
from rotcal_ros.methods.tracer.solver.adjustment import MINIMAL_REDUNDANCY, Adjuster, Adjustment
from rotcal_ros.methods.tracer.solver.network import LengthView
from rotcal_ros.methods.tracer.solver.problem import FREE_TARGET_MINIMUM, Grid

LEAST_OF_GROUP: Final = 4
"""Lengths that are a group."""
LARGEST: Final = 1e-4
"""Error (m) of several lengths that could not be overlooked."""
WORDS: Final = Words(
    "lengths", "warm air, a person or an obstacle", "in the beams", "in its beams"
)


def left_out(
    gathering: Gathering, grid: Grid, limits: TracerLimits
) -> tuple[Gathering, Bools, dict[int, str]] | None:
    """Return what is proved to be wrong together: (p, n) which lengths, and why by row.

    None where nothing is proved, or where too few lengths would be left.
    """
    case = gathering.proved(limits.rejection_significance)
    if case is None:
        return None
    rejected = np.zeros(grid.used.shape, dtype=np.bool_)
    rejected.flat[case.group.members[case.subset]] = True
    left = grid.used & ~rejected
    hit = np.unique(grid.station[rejected.any(axis=1)])
    if (grid.per_station(left)[hit] < grid.station_minimum + 1).any():
        return None
    if grid.free and (left.sum(axis=0)[rejected.any(axis=0)] < FREE_TARGET_MINIMUM).any():
        return None
    why = {
        int(grid.row[j, i]): f"station {grid.position_ids[grid.station[j]]}, target "
        f"{grid.target_ids[i]}: one of {int(case.subset.sum())} lengths of {case.group.name} that "
        f"are off together, by {WORDS.size(case.size)}"
        for j, i in np.argwhere(rejected)
    }
    return gathering.without(case), rejected, why


def gathering_protection(gathering: Gathering, std: Floats) -> tuple[Protection, ...]:
    """Return the statement about errors that gather; none where no group was judged.

    ``std`` (o,): standard uncertainties of the outputs.
    """
    judgement = gathering.judgement
    if judgement is None:
        return ()
    worst = hidden(judgement.groups, std, SUSPECTED, POWER, LARGEST, judgement.gathered)
    if worst is None:
        return ()
    what = "several lengths of one station that are too long together (warm air, a person)"
    size = f"{worst.size / MICROMETRE:.2g} um"
    return (engine.protection(worst, what, size, searched=" in every sector"),)


def groups_of(
    grid: Grid, fit: Adjustment, view: LengthView, residual: Floats, order: Ints
) -> tuple[Group | Undivided, ...]:
    """Return the groups of a network, by the ``view`` at it and its ``residual`` (p, n), m.

    ``order`` (k,): when each row of the problem was taken. What lies together in no way is judged
    as a whole only.
    """
    found: list[Group | Undivided] = []
    for places in places_of(grid, fit, order):
        strip, target = places.at.T
        unit = 1.0 / grid.length_std[strip, target]
        white = residual[strip, target] * unit
        if not len(places.gathered):
            cofactor = view.cofactor(strip, target, unit)
            found.append(Undivided(places.kind, places.name, white, cofactor, places.lost))
            continue
        leverage = view.leverage(strip, target)
        sensitivity = view.sensitivity(strip, target)
        number = np.ravel_multi_index((strip, target), grid.used.shape)
        found.append(
            Group.of(
                places.kind, places.name, number, white[:, None], unit[:, None],
                leverage * unit * unit[:, None], partial(sensitivity.weighted, unit),
                places.gathered, places.lost,
            )
        )  # fmt: skip
    return tuple(found)


class Places(NamedTuple):
    """The places ``at`` (e, 2) of the grid that are a group, and how many were rejected of it."""

    kind: str
    name: str
    at: Ints
    gathered: Bools
    lost: int


def places_of(grid: Grid, fit: Adjustment, order: Ints) -> list[Places]:
    """Return what belongs to each station, target and stretch of time."""
    known = grid.row >= 0
    found = []
    strips = np.argsort(grid.station, kind="stable")
    ends = np.cumsum(np.bincount(grid.station, minlength=grid.n_stations))
    missing = (known & ~grid.used).sum(axis=1)
    for j, mine in enumerate(np.split(strips, ends[:-1])):
        name = grid.position_ids[j]
        strip, target = np.nonzero(grid.used[mine])
        at = np.column_stack([mine[strip], target])
        beams = fit.targets[target] - fit.stations[j]
        lost = int(missing[mine].sum())
        found.append(Places("station", f"station {name}", at, _sectors(beams), lost))
    for i, name in enumerate(grid.target_ids.tolist()):
        strip = np.flatnonzero(grid.used[:, i])
        at = np.column_stack([strip, np.full(len(strip), i)])
        lost = int((known & ~grid.used)[:, i].sum())
        found.append(Places("target", f"target {name}", at, _none(len(at)), lost))
    found += _stretches(grid, order)
    return [places for places in found if len(places.at) >= LEAST_OF_GROUP]


def _none(size: int) -> Bools:
    return np.zeros((0, size), dtype=np.bool_)


def _sectors(beams: Floats) -> Bools:
    """Return which beams (e, 3) of one station lie together, round it and all about."""
    if len(beams) < LEAST_OF_GROUP:
        return _none(len(beams))
    round_ = np.arctan2(beams[:, 1], beams[:, 0])
    unit = beams / np.linalg.norm(beams, axis=1)[:, None]
    return np.concatenate([runs(round_, closed=True), neighbourhoods(unit)])


def _stretches(grid: Grid, order: Ints) -> list[Places]:
    """Return stretches of time as long as a station's lengths; none where they are the stations.

    What gathers in them lasts for a while.
    """
    strip, target = np.nonzero(grid.row >= 0)
    rank = np.argsort(order[grid.row[strip, target]], kind="stable")
    strip, target = strip[rank], target[rank]
    arrivals = 1 + int((np.diff(grid.station[strip]) != 0).sum())
    if arrivals <= grid.n_stations:
        return []
    size = max(len(strip) // grid.n_stations, 2 * LEAST_OF_GROUP)
    found = []
    for first in range(0, len(strip) - LEAST_OF_GROUP + 1, size):
        at = np.column_stack([strip, target])[first : first + size]
        kept = at[grid.used[at[:, 0], at[:, 1]]]
        name = f"the stretch from length {first} to {first + len(at) - 1} in time"
        gathered = runs(np.arange(len(kept), dtype=np.float64))
        found.append(Places("stretch", name, kept, gathered, len(at) - len(kept)))
    return found


COMPONENTS: Final = ("lengths", "distance", "targets x", "targets y", "targets z")
"""Components of the noise, in the order of all arrays (5,) here."""
PRIOR_AXIS: Final = 0.5
"""Standard deviation of ln s of one axis of the targets against the others."""
GROSS: Final = 5.0
"""Margin of the coarse round over the fine one."""
HARDLY_CHECKED: Final = 0.01
"""Redundancy of a length below which its residual, next to none, shows nothing of its error."""
NORMAL_QUARTILE: Final = 0.6745
"""Median of |x| for a standard normal x."""
Grouping = Callable[[Grid, Adjustment], tuple[Group | Undivided, ...]]
"""What makes the groups of a network at its solution."""


@dataclass(frozen=True, eq=False)
class NoiseFactors:
    """The factors (5,) on the stated standard deviations of COMPONENTS.

    ``log_std`` (5,): standard deviations of their logarithms, ``stated`` (5,): the mean stated
    standard deviations (m; m/m for the distance); NaN where a component is absent. ``estimated``:
    the statements were contradicted; else all factors are one.
    """

    factors: Floats
    log_std: Floats
    stated: Floats
    estimated: bool

    def contradicted(self, significance: float) -> Bools:
        """Return (5,) the components whose factor cannot be one, two-sided."""
        if not self.estimated:
            return np.zeros(len(COMPONENTS), dtype=np.bool_)
        return EstimatedFactors(self.factors, self.log_std).contradicted(significance)

    def details(self) -> list[dict[str, Any]]:
        """Return each component for the details of a result: its statement, its factor."""
        return [
            {
                "component": name,
                "stated": self.stated[k],
                "factor": self.factors[k],
                "relative_std": self.log_std[k],
            }
            for k, name in enumerate(COMPONENTS)
            if self.stated[k] > 0.0 or k == 0
        ]


def noise_evidence(grid: Grid, fit: Adjustment, bent: bool = False) -> NoiseEvidence:
    """Return what the residuals of ``fit`` say; ``bent``: large ones count no more than BEND."""
    share = grid.distance_std**2 / grid.length_std**2
    lengths = grid.used * (fit.residual / fit.std) ** 2
    targets = fit.corrections**2
    if bent:
        lengths = bent_squares(lengths, fit.redundancy, MINIMAL_REDUNDANCY)
        targets = bent_squares(targets, fit.target_redundancy, MINIMAL_REDUNDANCY)
    shares = np.stack([1.0 - share, share])
    squares = np.concatenate([(shares * lengths).sum(axis=(1, 2)), targets.sum(axis=0)])
    of_lengths = (shares * fit.redundancy).sum(axis=(1, 2))
    redundancy = np.concatenate([of_lengths, fit.target_redundancy.sum(axis=0)])
    present = np.array([True, bool(share.any()), *[bool(fit.coupling.any())] * 3])
    return NoiseEvidence(present, squares, redundancy, _information(redundancy, fit, shares))


def _information(redundancy: Floats, fit: Adjustment, shares: Floats) -> Floats:
    """Return H (5, 5): rows of a projection; each component's row sums to its redundancy.

    The two parts of the lengths share what the lengths have together in proportion; the slope of
    the likelihood, which decides where the factors settle, is exact.
    """
    information = np.zeros((5, 5))
    information[2:, 2:] = fit.coupling
    with_lengths = redundancy[2:] - fit.coupling.sum(axis=1) - fit.circle_coupling[:3]
    lengths = max(float(redundancy[:2].sum()), np.finfo(np.float64).tiny)
    part = redundancy[:2] / lengths
    information[:2, 2:] = part[:, None] * with_lengths
    information[2:, :2] = information[:2, 2:].T
    within = np.einsum("gji,hji->gh", shares, shares * fit.redundancy)
    others = with_lengths.sum() + fit.circle_coupling[3]
    information[:2, :2] = within * (1.0 - others / lengths)
    return information


def _prior() -> Floats:
    """Return the information (5, 5) of the statements on ln s."""
    covariance = np.diag([PRIOR**2, PRIOR**2, *[PRIOR_AXIS**2] * 3])
    covariance[2:, 2:] += PRIOR**2
    return np.asarray(np.linalg.inv(covariance), dtype=np.float64)


def _as_stated(grid: Grid) -> NoiseFactors:
    """Return the noise of ``grid`` as it is stated."""
    return NoiseFactors(np.ones(5), np.full(5, np.nan), _stated(grid), estimated=False)


def _estimate_noise(
    adjust: Adjuster, grid: Grid, start: Adjustment, factors: Floats, bent: bool
) -> tuple[NoiseFactors, Adjustment]:
    """Return the factors that fit the residuals best, and the adjustment with them.

    From ``factors`` (5,) and the adjustment ``start``. Residuals that are ``bent`` keep outliers
    from passing for noise.
    """

    def at(factors: Floats, before: Adjustment) -> tuple[NoiseEvidence, Adjustment]:
        here = scaled(grid, factors)
        fit = adjust(here, before.state, before.targets)
        return noise_evidence(here, fit, bent), fit

    settled = NEARLY_SETTLED if bent else SETTLED
    found, fit = estimate_factors(at, start, factors, _prior(), settled)
    stated = np.where(np.isnan(found.log_std), np.nan, _stated(grid))
    return NoiseFactors(found.factors, found.log_std, stated, estimated=True), fit


def scaled(grid: Grid, factors: Floats) -> Grid:
    """Return ``grid`` with its stated standard deviations times ``factors`` (5,)."""
    if (factors == 1.0).all():
        return grid
    distance = factors[1] * grid.distance_std
    constant = factors[0] ** 2 * (grid.length_std**2 - grid.distance_std**2)
    return replace(
        grid,
        length_std=np.sqrt(constant + distance**2),
        distance_std=distance,
        target_std=grid.target_std * factors[2:],
    )


def _stated(grid: Grid) -> Floats:
    """Return (5,) the root mean squares of the stated standard deviations, m."""
    used = grid.used
    distance = (grid.distance_std**2)[used].mean()
    constant = (grid.length_std**2)[used].mean() - distance
    targets = (grid.target_std**2).mean(axis=0)
    return np.sqrt(np.maximum([constant, distance, *targets], 0.0))


def rejection_limit(grid: Grid, significance: float) -> float:
    """Return the |test value| from which a length is not believed.

    Two-sided normal quantile, ``significance`` shared equally among all lengths of ``grid`` and,
    unless it is free, all coordinates of targets (Bonferroni).
    """
    n_tests = int((grid.row >= 0).sum()) + (0 if grid.free else grid.targets.size)
    return normal_isf(0.5 * significance / n_tests)


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
    stated, noise, bent = adjust(grid, start), _as_stated(grid), True
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
        return _as_stated(grid), stated
    noise, fit = _estimate_noise(adjust, grid, stated, before.factors, bent)
    # the estimate has run to its bound
    if noise.factors[0] < LEAST_FACTOR * (1.0 + 1e-9):
        return _as_stated(grid), stated
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
