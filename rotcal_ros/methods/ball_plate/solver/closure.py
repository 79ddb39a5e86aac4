"""Centres measured again at the end: the fit does without them, they tell whether anything moved.

Keeping them out leaves one centre for every cell, and so the speed of the spectral solution. The
difference to the first measurement needs no model: beside noise it holds what has moved since,
plate, table and CMM alike, as one rigid motion for each table position.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from rotcal_ros.adjust.distributions import f_isf, f_sf
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.methods.ball_plate.solver import model
from rotcal_ros.methods.ball_plate.solver.drift import drift_columns
from rotcal_ros.methods.ball_plate.solver.model import OriginDrift
from rotcal_ros.methods.ball_plate.solver.order_effects import SIGNIFICANCE
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem

MOST_REPEATED: Final = 0.2
"""Part of the rows up to which repetitions are a closure; more of them belong into the fit."""
GROSS: Final = 1e-3
"""A repetition farther from its first measurement than this, m, is a wrong row."""


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

    @property
    def closed(self) -> bool:
        """Whether noise explains the difference."""
        return self.p_value >= SIGNIFICANCE

    def sentence(self) -> str:
        """Say in words what has changed."""
        x, y, z = self.shift / MICROMETRE
        a, b, c = self.rotation / ARCSEC
        return (
            f"measured again at the end, the balls at table position {self.position} are "
            f"displaced by ({x:.3f}, {y:.3f}, {z:.3f}) um and turned by ({a:.3f}, {b:.3f}, "
            f"{c:.3f}) arcsec, more than their noise explains (p = {self.p_value:.2g}): the "
            "CMM drifted, the plate moved or the table does not repeat"
        )


def visit_numbers(problem: BallPlateProblem) -> Ints:
    """Return the number of the table's stop, in the order of the rows, for each row (n,)."""
    order = np.argsort(problem.rows, kind="stable")
    stops = np.cumsum(np.diff(problem.position[order], prepend=-1) != 0) - 1
    numbers = np.empty(len(order), dtype=np.int64)
    numbers[order] = stops
    return numbers


def split(problem: BallPlateProblem) -> tuple[BallPlateProblem, BallPlateProblem | None]:
    """Return the rows to fit, and those of the last stops that measure the same again.

    Repetitions within a stop, in the middle of the run, or of more than MOST_REPEATED of the
    rows stay where they are.
    """
    again = _closing(problem)
    if not again.any() or again.sum() > MOST_REPEATED * len(again):
        return problem, None
    return problem.take(~again), problem.take(again)


def _closing(problem: BallPlateProblem) -> Bools:
    """Return which rows the last stops repeat (n,)."""
    visit = visit_numbers(problem)
    cell = problem.position * problem.grid + problem.ball_step
    _, inverse = np.unique(cell, return_inverse=True)
    earliest = np.full(inverse.max() + 1, np.iinfo(np.int64).max)
    np.minimum.at(earliest, inverse, visit)
    repeated = visit > earliest[inverse]
    again = np.zeros(len(visit), dtype=np.bool_)
    for last in range(int(visit.max()), 0, -1):
        here = visit == last
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
) -> tuple[PlateClosure, ...]:
    """Compare the rows ``closing`` with the fitted rows of ``problem`` that they repeat.

    ``sigma`` are the standard deviations (3,) of the coordinates of fitted and of closing rows (of
    unit weight where rows have their own), from ``dof`` degrees of freedom; what an estimated
    ``drift`` explains is taken off. ``repeatability`` (6,), m, of the table, rotations times
    radius, is part of the scatter.
    """
    cell = problem.position * problem.grid + problem.ball_step
    again = closing.position * problem.grid + closing.ball_step
    fair = np.isin(again, cell) & np.isfinite(closing.centres).all(axis=1)
    order = np.argsort(cell, kind="stable")
    first = np.zeros(len(again), dtype=np.int64)
    first[fair] = order[np.searchsorted(cell[order], again[fair])]
    away = np.linalg.norm(closing.centres - problem.centres[first], axis=1)
    fair &= away < GROSS
    found = []
    for position in np.unique(closing.position):
        rows = np.flatnonzero(fair & (closing.position == position))
        if len(rows) > 2:
            pairs = _BallPairs(problem, closing, first[rows], rows, sigma, drift, repeatability)
            found.append(pairs.compare(dof))
    return tuple(found)


class _BallPairs:
    """First and last measurements of the balls at one table position."""

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
        place = problem.angles[problem.cmm_index[first]]
        self.motion = np.concatenate(
            [np.broadcast_to(np.eye(3), (len(first), 3, 3)), model.cross_unit(place)], axis=2
        )
        early_std = sigma[0] * (1.0 if problem.std is None else problem.std[first])
        late_std = sigma[1] * (1.0 if closing.std is None else closing.std[last])
        noise = np.broadcast_to(early_std**2 + late_std**2, self.change.shape)
        scattered = self.motion.reshape(-1, 6)
        self.variance = np.diag(noise.ravel())
        self.variance += 2.0 * (scattered * repeatability**2) @ scattered.T
        if drift is not None:
            late = drift_columns(closing.run_time_on(problem)[last], len(drift.amount))
            early = drift_columns(problem.run_time[first], len(drift.amount))
            self.change -= (late - early) @ drift.amount.ravel()
            columns = (late - early).reshape(len(scattered), -1)
            columns = columns * np.tile(sigma[0], len(drift.amount))
            self.variance += columns @ drift.unit_covariance @ columns.T

    def compare(self, dof: float) -> PlateClosure:
        """Fit one motion to the changes; the worst ball goes while it contradicts the others."""
        kept = np.arange(len(self.change))
        while True:
            motion, covariance, gain, left = self._fit(kept)
            worst = int(np.argmax(left))
            limit = 3.0 * float(f_isf(SIGNIFICANCE / len(self.change), 3, dof))
            if left[worst] <= limit or len(kept) <= 4:
                break
            kept = np.delete(kept, worst)
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

    def _fit(self, kept: Ints) -> tuple[Floats, Floats, float, Floats]:
        """Return motion (6,), covariance, what it explains, and what is left of each ball."""
        rows = (3 * kept[:, None] + np.arange(3)).ravel()
        factor = cho_factor(self.variance[np.ix_(rows, rows)])
        design = self.motion[kept].reshape(-1, 6)
        change = self.change[kept].ravel()
        normal = design.T @ cho_solve(factor, design)
        covariance = np.linalg.pinv(0.5 * (normal + normal.T), hermitian=True, rcond=1e-10)
        right = design.T @ cho_solve(factor, change)
        motion = covariance @ right
        left = change - design @ motion
        own = np.diag(self.variance)[rows]
        return (
            motion,
            covariance,
            float(right @ motion),
            np.sum((left**2 / own).reshape(-1, 3), axis=1),
        )
