"""Table positions that are visited more than once: the closure, and the table's repeatability.

The closure: centres measured again at the end. The fit does without them, which leaves one centre
for every cell, and so the speed of the spectral solution. The difference to the first measurement
needs no model: beside noise it holds what has moved since, plate, table and CMM alike, as one
rigid motion for each table position, and what the plate has grown by.

Repeatability: how well the table comes back to a position, from the stops that it makes there
during the run. Every stop has a motion of its own, six variances in all. Quadratic forms of the
residuals, one for each of the six and the residuals' sum of squares, are set equal to their
expectations (Henderson's third method); these depend on the layout only and come from seeded
random patterns that pass through the model. Lengths count in units of the rows' ``std`` where they
have one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from rotcal_ros.adjust.distributions import f_isf, f_sf
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.methods.ball_plate.solver.estimate import drift_columns, factored
from rotcal_ros.methods.ball_plate.solver.growth import GrowthTest, growth_columns, likelier
from rotcal_ros.methods.ball_plate.solver.model import LinearFit, OriginDrift, rigid_motion
from rotcal_ros.methods.ball_plate.solver.order_effects import SIGNIFICANCE, triple
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, RowLayout, places_of

MOST_REPEATED: Final = 0.2
"""Part of the rows up to which repetitions are a closure; more of them belong into the fit."""
GROSS: Final = 1e-3
"""A repetition farther from its first measurement than this, m, is a wrong row."""
MIN_STOPS: Final = 10
"""Repeated stops needed to estimate a scatter."""
MIN_BALLS_PER_STOP: Final = 1.4
"""Balls per stop, in the mean, below which stops cannot be separated from noise."""
DRAWS: Final = 10
NOISE_DRAWS: Final = 30
"""Random patterns for each motion, and for noise."""
MOST_CENTRES: Final = 10_000
"""Centres up to which the patterns are drawn: a fit of the whole problem for each."""
CONDITION: Final = 1e6
"""Condition number of the expectations from which on the variances cannot be separated."""
SIGNIFICANT: Final = 3.3
"""Standard deviations above zero from which on a scatter counts."""


@dataclass(frozen=True)
class PlateClosure:
    """How a table position measured again at the end differs from its first time.

    ``shift`` (3,) m and ``rotation`` (3,) rad, later - first, in the fixed frame, with standard
    deviations; ``value`` is the F statistic of both together, ``p_value`` its probability.
    ``n_balls`` were compared, ``n_gross`` left out because they contradict the others.
    """

    position: int
    shift: Floats
    shift_std: Floats
    rotation: Floats
    rotation_std: Floats
    value: float
    p_value: float
    n_balls: int
    n_gross: int

    def turned(self, rotation: Floats) -> PlateClosure:
        """Return the same in another frame, to which ``rotation`` (3, 3) takes vectors."""
        return replace(
            self,
            shift=rotation @ self.shift,
            shift_std=np.sqrt(rotation**2 @ self.shift_std**2),
            rotation=rotation @ self.rotation,
            rotation_std=np.sqrt(rotation**2 @ self.rotation_std**2),
        )

    @property
    def closed(self) -> bool:
        """Whether noise explains the difference."""
        return self.p_value >= SIGNIFICANCE

    def sentence(self) -> str:
        """Say in words what has changed."""
        return (
            f"measured again at the end, the balls at table position {self.position} are "
            f"displaced by {triple(self.shift / MICROMETRE, 3)} um and turned by "
            f"{triple(self.rotation / ARCSEC, 3)} arcsec, more than their noise explains (p = "
            f"{self.p_value:.2g}): the CMM drifted, the plate moved or the table does not repeat"
        )


def closing_apart(problem: BallPlateProblem) -> tuple[BallPlateProblem, BallPlateProblem | None]:
    """Return the rows to fit, and those of the last stops that measure the same again.

    Repetitions within a stop, in the middle of the run, or of more than MOST_REPEATED of the
    rows stay where they are.
    """
    if problem.complete:
        return problem, None
    again = _closing(problem)
    if not again.any() or again.sum() > MOST_REPEATED * len(again):
        return problem, None
    return problem.take(~again), problem.take(again)


def _closing(problem: BallPlateProblem) -> Bools:
    """Return which rows the last stops repeat (n,)."""
    stop = problem.stop
    _, cell = np.unique(problem.cell, return_inverse=True)
    earliest = np.full(cell.max() + 1, np.iinfo(np.int64).max)
    np.minimum.at(earliest, cell, stop)
    repeated = stop > earliest[cell]
    again = np.zeros(len(stop), dtype=np.bool_)
    for last in range(int(stop.max()), 0, -1):  # from the end, while a stop mostly repeats
        here = stop == last
        if 2 * np.count_nonzero(repeated[here]) <= np.count_nonzero(here):
            break
        again |= here & repeated
    return again


def closures(
    problem: BallPlateProblem,
    closing: BallPlateProblem,
    sigma: tuple[Floats, Floats],
    dof: float,
    drift: OriginDrift | None,
    repeatability: Floats,
) -> tuple[tuple[PlateClosure, ...], GrowthTest | None]:
    """Compare the rows ``closing`` with the fitted rows of ``problem`` that they repeat.

    And test how much the plate has grown in between; where it has, this is taken off first.

    ``sigma`` are the standard deviations (3,) of the coordinates of fitted and of closing rows (of
    unit weight where rows have their own), from ``dof`` degrees of freedom; what an estimated
    ``drift`` explains is taken off. ``repeatability`` (6,), m, of the table, rotations times
    radius, is part of the scatter.
    """
    fair = np.isin(closing.cell, problem.cell) & np.isfinite(closing.centres).all(axis=1)
    first = np.zeros(len(fair), dtype=np.int64)
    first[fair] = places_of(closing.cell[fair], problem.cell)
    away = np.linalg.norm(closing.centres - problem.centres[first], axis=1)
    fair &= away < GROSS
    found, grown = list[PlateClosure](), list[GrowthTest]()
    for position in np.unique(closing.position):
        rows = np.flatnonzero(fair & (closing.position == position))
        if len(rows) > 2:  # two balls leave the rotation about their line open
            pairs = _BallPairs(problem, closing, first[rows], rows, sigma, drift, repeatability)
            grown += pairs.without_growth(dof, problem.material)
            found.append(pairs.compare(dof))
    return tuple(found), likelier(grown)


class _BallPairs:
    """First and last measurements of the balls at one table position.

    ``change`` (k, 3) is later - first, ``motion`` (k, 3, 6) what a rigid motion of the plate does
    to it, ``growth`` (k, 3, 1) its growth, ``variance`` (3 k, 3 k) its covariance.
    """

    def __init__(
        self,
        problem: BallPlateProblem,
        closing: BallPlateProblem,
        first: Ints,
        last: Ints,
        sigma: tuple[Floats, Floats],
        drift: OriginDrift | None,
        repeatability: Floats,
    ) -> None:
        self.position, self.radius = int(closing.position[last[0]]), problem.radius
        self.change = closing.centres[last] - problem.centres[first]
        self.motion = rigid_motion(problem.angles[problem.cmm_index[first]])
        late = growth_columns(closing, closing.run_time_on(problem))[last]
        self.growth = late - growth_columns(problem, problem.run_time)[first]
        early_std = sigma[0] * problem.noise_unit[first]
        late_std = sigma[1] * closing.noise_unit[last]
        scattered = self.motion.reshape(-1, 6)
        self.variance = np.diag((early_std**2 + late_std**2).ravel())
        # the table scatters at both stops, alike for all balls of one
        self.variance += 2.0 * (scattered * repeatability**2) @ scattered.T
        if drift is not None:
            late = drift_columns(closing.run_time_on(problem)[last], len(drift.amount))
            early = drift_columns(problem.run_time[first], len(drift.amount))
            self.change -= (late - early) @ drift.amount.ravel()
            columns = (late - early).reshape(len(scattered), -1)
            columns = columns * np.tile(sigma[0], len(drift.amount))  # its covariance is unit
            self.variance += columns @ drift.unit_covariance @ columns.T

    def without_growth(self, dof: float, material: str) -> Sequence[GrowthTest]:
        """Test a growth beside a rigid motion; take it off the changes where there is one."""
        both = np.concatenate([self.motion, self.growth], axis=2)
        _, found, covariance, _ = self._agreeing(both, dof)
        amount, variance = float(found[-1]), float(covariance[-1, -1])
        if variance <= 0.0:
            return ()
        p_value = f_sf(amount**2 / variance, 1, dof)
        test = GrowthTest.of(amount, float(np.sqrt(variance)), p_value, material)
        if test.significant:
            self.change = self.change - amount * self.growth[:, :, 0]
            column = self.growth.ravel()
            self.variance = self.variance + variance * np.outer(column, column)
        return (test,)

    def compare(self, dof: float) -> PlateClosure:
        """Fit one motion to the changes."""
        kept, motion, covariance, gain = self._agreeing(self.motion, dof)
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        value = gain / 6.0
        return PlateClosure(
            position=self.position,
            shift=motion[:3],
            shift_std=std[:3],
            rotation=motion[3:] / self.radius,
            rotation_std=std[3:] / self.radius,
            value=value,
            p_value=f_sf(value, 6, dof),
            n_balls=len(kept),
            n_gross=len(self.change) - len(kept),
        )

    def _agreeing(self, columns: Floats, dof: float) -> tuple[Ints, Floats, Floats, float]:
        """Fit amounts (m,) of ``columns`` (k, 3, m); the worst ball goes while it contradicts.

        Return the balls that are left, the amounts, their covariance, and what they explain.
        """
        kept = np.arange(len(self.change))
        while True:
            amounts, covariance, gain, left = self._fit(kept, columns)
            worst = int(np.argmax(left))
            limit = 3.0 * float(f_isf(SIGNIFICANCE / len(self.change), 3, dof))
            if left[worst] <= limit or len(kept) <= 4:
                return kept, amounts, covariance, gain
            kept = np.delete(kept, worst)

    def _fit(self, kept: Ints, columns: Floats) -> tuple[Floats, Floats, float, Floats]:
        """Return amounts (m,), covariance, what they explain, and what is left of each ball.

        What it explains is a chi-squared; the rest of a ball (k,) is counted in its own variance.
        """
        rows = (3 * kept[:, None] + np.arange(3)).ravel()
        factor = cho_factor(self.variance[np.ix_(rows, rows)])
        design = columns[kept].reshape(len(rows), -1)
        change = self.change[kept].ravel()
        normal = design.T @ cho_solve(factor, design)
        covariance = np.linalg.pinv(0.5 * (normal + normal.T), hermitian=True, rcond=1e-10)
        right = design.T @ cho_solve(factor, change)
        amounts = covariance @ right
        left = change - design @ amounts
        own = np.diag(self.variance)[rows]
        return (
            amounts,
            covariance,
            float(right @ amounts),
            np.sum((left**2 / own).reshape(-1, 3), axis=1),
        )


@dataclass(frozen=True, eq=False)
class Repeatability:
    """Scatter of the table from stop to stop, of EXC to ECC: ``std`` (6,) in m and rad.

    ``significant`` (6,) says where it is more than noise imitates, ``smallest`` (6,) from which
    size on that is so. ``added`` (6,) is the variance that the significant ones add to the
    deviations, m^2 and rad^2; ``n_stops`` counts the stops beyond the first at each position.
    """

    std: Floats
    significant: Bools
    smallest: Floats
    added: Floats
    n_stops: int

    def turned(self, rotation: Floats) -> Repeatability:
        """Return the same in another frame, to which ``rotation`` (3, 3) takes vectors."""
        square = np.kron(np.eye(2), rotation**2)
        return replace(
            self,
            std=np.sqrt(square @ self.std**2),
            significant=square @ self.significant > 0.0,
            smallest=np.sqrt(square @ self.smallest**2),
            added=square @ self.added,
        )

    @property
    def significant_std(self) -> Floats:
        """Return the significant ones, m and rad, zero for the others (6,)."""
        return np.where(self.significant, self.std, 0.0)


@dataclass(frozen=True, eq=False)
class _Expected:
    """What the layout makes of the seven variances, of six motions and of noise.

    ``inverse`` (7, 7) takes the seven forms to the variances; ``spread`` (7, 6) is how much each
    of the seven, at unit variance, scatters what is found of each motion, zero for its own;
    ``gain`` (6, 6) is the variance of each deviation per unit variance of each motion.
    """

    inverse: Floats
    spread: Floats
    gain: Floats


def arrivals(problem: BallPlateProblem) -> tuple[int, float]:
    """Return the number of repeated stops, and how many balls a stop has in the mean."""
    n_stops = int(problem.stop.max()) + 1
    return n_stops - len(problem.table_positions), len(problem.rows) / n_stops


def repeatability(problem: BallPlateProblem, residuals: Floats) -> Repeatability | None:
    """Estimate the table's repeatability from residuals (n, 3) of a fit; None where it cannot be.

    Repeated stops with several balls are needed, and centres that differ in weight by axis only.
    """
    stops, balls = arrivals(problem)
    if stops < MIN_STOPS or balls < MIN_BALLS_PER_STOP:
        return None
    if not problem.weighed_alike or len(problem.centres) > MOST_CENTRES:
        return None
    expected = _expected(RowLayout.of(problem))
    if expected is None:
        return None
    found = expected.inverse @ _forms(_Stops(problem), residuals)
    limit = SIGNIFICANT * np.sqrt(np.maximum(found, 0.0) ** 2 @ expected.spread**2)
    variance = np.maximum(found[:6], 0.0)
    significant = variance > limit
    length = np.repeat([1.0, problem.radius], 3)  # the last three are rotations times radius
    return Repeatability(
        std=np.sqrt(variance) / length,
        significant=significant,
        smallest=np.sqrt(limit) / length,
        added=expected.gain @ np.where(significant, variance, 0.0),
        n_stops=stops,
    )


class _Stops:
    """The motions of the table at every stop: columns (n, 3, 6) of the rows.

    ``own`` (n, 3) are the standard deviations that lengths are counted in.
    """

    def __init__(self, problem: BallPlateProblem) -> None:
        self.stop = problem.stop
        self.count = int(self.stop.max()) + 1
        self.own = problem.noise_unit
        self.columns = rigid_motion(problem.angles[problem.cmm_index])
        self.size = self.sums(np.sum((self.columns / self.own[:, :, None]) ** 2, axis=1))

    def sums(self, rows: Floats) -> Floats:
        """Add rows (n, m) up over each stop (v, m)."""
        total = np.zeros((self.count, rows.shape[1]))
        np.add.at(total, self.stop, rows)
        return total


def _forms(stops: _Stops, residuals: Floats) -> Floats:
    """Return the seven quadratic forms of residuals (n, 3), m.

    For each motion the squares of what the residuals of a stop have along it, of all stops; and
    the sum of all squares.
    """
    counted = residuals / stops.own
    columns = stops.columns / stops.own[:, :, None]
    along = stops.sums(np.einsum("nia,ni->na", columns, counted))
    share = np.sum(along**2 / np.maximum(stops.size, 1e-12), axis=0)
    return np.append(share, np.sum(counted**2))


@lru_cache(maxsize=4)
def _expected(layout: RowLayout) -> _Expected | None:
    problem = layout.problem
    stops, linear = _Stops(problem), factored(problem)
    rng = np.random.default_rng(20250101)
    every, gain = [], np.zeros((6, 6))
    for motion in range(6):
        forms, gain[:, motion] = _of_motion(stops, linear, motion, rng)
        every.append(forms)
    noise = [
        _forms(stops, linear.fit(stops.own * rng.standard_normal(stops.own.shape))[1])
        for _ in range(NOISE_DRAWS)
    ]
    every.append(np.array(noise))
    expected = np.stack([forms.mean(axis=0) for forms in every], axis=1)
    if not np.linalg.cond(expected / np.abs(expected).max(axis=0)) < CONDITION:
        return None
    inverse = np.asarray(np.linalg.inv(expected), dtype=np.float64)
    spread = np.stack([np.std(forms @ inverse.T, axis=0, ddof=1)[:6] for forms in every])
    np.fill_diagonal(spread, 0.0)
    return _Expected(inverse, np.asarray(spread, dtype=np.float64), gain)


def _of_motion(
    stops: _Stops, linear: LinearFit, motion: int, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Return the forms (draws, 7), and mean squares of the six deviations, of unit scatter."""
    forms, effect = np.zeros((DRAWS, 7)), np.zeros(6)
    for draw in range(DRAWS):
        size = rng.standard_normal(stops.count)
        size /= np.sqrt(np.mean(size**2))
        found, left = linear.fit(size[stops.stop, None] * stops.columns[:, :, motion])
        forms[draw] = _forms(stops, left)
        effect += np.mean(found.curves() ** 2, axis=1) / DRAWS
    return forms, effect
