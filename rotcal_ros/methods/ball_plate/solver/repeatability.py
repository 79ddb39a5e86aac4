"""How well the table comes back to a position, from the stops that it makes there.

Every stop has a motion of its own, six variances in all. Quadratic forms of the residuals, one for
each of the six and the residuals' sum of squares, are set equal to their expectations
(Henderson's third method); these depend on the layout only and come from seeded random patterns
that pass through the model. Lengths count in units of the rows' ``std`` where they have one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.methods.ball_plate.solver import model
from rotcal_ros.methods.ball_plate.solver.closure import visit_numbers
from rotcal_ros.methods.ball_plate.solver.disturbance_response import Responder, curves
from rotcal_ros.methods.ball_plate.solver.estimate import factored
from rotcal_ros.methods.ball_plate.solver.order_effects import RowOrder, layout_of
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem

MIN_STOPS: Final = 10
"""Repeated stops needed to tell a scatter."""
MIN_BALLS: Final = 1.4
"""Balls per stop, in the mean, below which stops cannot be told from noise."""
DRAWS: Final = 10
NOISE_DRAWS: Final = 30
"""Random patterns for each motion, and for noise."""
MOST_CENTRES: Final = 10_000
CONDITION: Final = 1e6
SIGNIFICANT: Final = 3.3
"""Standard deviations above zero from which on a scatter counts."""


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

    @property
    def significant_std(self) -> Floats:
        """Return the significant ones, m and rad, zero for the others (6,)."""
        return np.where(self.significant, self.std, 0.0)


@dataclass(frozen=True, eq=False)
class _Expected:
    """Expectations of the seven forms (7, 7), what imitates a variance, and the effect.

    ``inverse`` (7, 7) takes forms to variances; ``spread`` (7, 6) is how much each of the seven,
    at unit variance, scatters what is found of each motion, zero for its own; ``gain`` (6, 6) is
    the variance of each deviation per unit variance of each motion.
    """

    inverse: Floats
    spread: Floats
    gain: Floats


def arrivals(problem: BallPlateProblem) -> tuple[int, float]:
    """Return the number of repeated stops, and how many balls a stop has in the mean."""
    visit = visit_numbers(problem)
    n_visits = int(visit.max()) + 1
    return n_visits - len(np.unique(problem.position)), len(visit) / n_visits


def repeatability(problem: BallPlateProblem, residuals: Floats) -> Repeatability | None:
    """Estimate the table's repeatability from residuals (n, 3) of a fit; None where it cannot be.

    Repeated stops with several balls are needed, and centres that differ in weight by axis only.
    """
    stops, balls = arrivals(problem)
    small = len(problem.centres) <= MOST_CENTRES
    alike = problem.std is None or not np.ptp(problem.std, axis=0).any()
    if stops < MIN_STOPS or balls < MIN_BALLS or not alike or not small:
        return None
    expected = _expected(layout_of(problem, None))
    if expected is None:
        return None
    found = expected.inverse @ _forms(_Stops(problem), residuals)
    limit = SIGNIFICANT * np.sqrt(np.maximum(found, 0.0) ** 2 @ expected.spread**2)
    variance = np.maximum(found[:6], 0.0)
    significant = variance > limit
    length = np.repeat([1.0, problem.radius], 3)
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
        self.visit: Ints = visit_numbers(problem)
        self.count = int(self.visit.max()) + 1
        cross = model.cross_unit(problem.angles[problem.cmm_index])
        shift = np.broadcast_to(np.eye(3), cross.shape)
        self.own = np.ones_like(problem.centres) if problem.std is None else problem.std
        self.columns = np.concatenate([shift, cross], axis=2)
        self.size = self.sums(np.sum((self.columns / self.own[:, :, None]) ** 2, axis=1))

    def sums(self, rows: Floats) -> Floats:
        """Add rows (n, m) up over each stop (v, m)."""
        total = np.zeros((self.count, rows.shape[1]))
        np.add.at(total, self.visit, rows)
        return total


def _forms(stops: _Stops, residuals: Floats) -> Floats:
    """Return the seven quadratic forms of residuals (n, 3), m."""
    counted = residuals / stops.own
    columns = stops.columns / stops.own[:, :, None]
    along = stops.sums(np.einsum("nia,ni->na", columns, counted))
    share = np.sum(along**2 / np.maximum(stops.size, 1e-12), axis=0)
    return np.append(share, np.sum(counted**2))


@lru_cache(maxsize=4)
def _expected(layout: RowOrder) -> _Expected | None:
    problem = layout.problem()
    stops, respond = _Stops(problem), factored(problem).fit
    rng = np.random.default_rng(20250101)
    every, gain = [], np.zeros((6, 6))
    for motion in range(6):
        forms, gain[:, motion] = _of_motion(stops, respond, motion, rng)
        every.append(forms)
    noise = [
        _forms(stops, respond(stops.own * rng.standard_normal(stops.own.shape))[1])
        for _ in range(NOISE_DRAWS)
    ]
    every.append(np.array(noise))
    expected = np.stack([forms.mean(axis=0) for forms in every], axis=1)
    if not np.linalg.cond(expected / np.abs(expected).max(axis=0)) < CONDITION:
        return None
    inverse = np.asarray(np.linalg.inv(expected), dtype=np.float64)
    spread = np.stack([np.std(forms @ inverse.T, axis=0, ddof=1)[:6] for forms in every])
    spread[np.arange(6), np.arange(6)] = 0.0
    return _Expected(inverse, np.asarray(spread, dtype=np.float64), gain)


def _of_motion(
    stops: _Stops, respond: Responder, motion: int, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Return the forms (draws, 7), and mean squares of the six deviations, of unit scatter."""
    forms, effect = np.zeros((DRAWS, 7)), np.zeros(6)
    for draw in range(DRAWS):
        size = rng.standard_normal(stops.count)
        size /= np.sqrt(np.mean(size**2))
        found, left = respond(size[stops.visit, None] * stops.columns[:, :, motion])
        forms[draw] = _forms(stops, left)
        effect += np.mean(curves([found])[:, :, 0] ** 2, axis=1) / DRAWS
    return forms, effect
