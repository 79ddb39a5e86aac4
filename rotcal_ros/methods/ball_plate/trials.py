"""Monte Carlo trials of the ball plate method: the estimate is linear in the centres."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.components import COMPONENTS
from rotcal_ros.methods.ball_plate import general, model
from rotcal_ros.methods.ball_plate.problem import BallPlateProblem
from rotcal_ros.methods.ball_plate.solution import PlateSolution, adjust


@dataclass(frozen=True, eq=False)
class LinearTrials:
    """Trials by the linear map itself: ``value`` (6 N,) + noise @ ``gain`` (3 n, 6 N).

    ``std`` (3 n,), metres, belongs to the coordinates of the centres.
    """

    value: Floats
    gain: Floats
    std: Floats

    def __call__(self, rng: np.random.Generator, count: int) -> Floats:
        """Return EXC, EYC, EZC (m), EAC, EBC, ECC (rad) at all angles one after the other."""
        noise = self.std * rng.standard_normal((count, len(self.std)))
        return self.value + noise @ self.gain


@dataclass(frozen=True, eq=False)
class SolvedTrials:
    """Trials by solving each; for separate groups, an estimated drift, and too large grids."""

    problem: BallPlateProblem
    std: Floats

    def __call__(self, rng: np.random.Generator, count: int) -> Floats:
        """Return the same as :class:`LinearTrials`."""
        return np.stack([self._trial(rng.standard_normal(self.std.shape)) for _ in range(count)])

    def _trial(self, noise: Floats) -> Floats:
        centres = self.problem.centres + self.std * noise
        return _in_order(adjust(replace(self.problem, centres=centres)))


def plate_trials(problem: BallPlateProblem) -> LinearTrials | SolvedTrials:
    """Prepare Monte Carlo trials about a measured problem; refuses what ``solve`` refuses.

    Rejected centres stay rejected; the noise is the one that the standard deviations of the
    result belong to.
    """
    solution = adjust(problem)
    large = model.offsets(problem).total > general.MAX_UNKNOWNS
    alone = problem.separate_groups or large or problem.drift > 0
    used = problem if alone else solution.fits[0].problem
    factor = solution.noise.used if alone else solution.noise.scale
    std = factor * (np.ones_like(used.centres) if used.std is None else used.std)
    if alone:
        return SolvedTrials(used, std)
    return LinearTrials(_in_order(solution), general.table_gain(used).T, std.ravel())


def _in_order(solution: PlateSolution) -> Floats:
    """Return all deviations, component by component."""
    deviations = solution.deviations()
    return np.concatenate([deviations[name] for name in COMPONENTS])
