"""Monte Carlo trials of the ball plate method: the estimate is linear in the centres."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.components import COMPONENTS
from rotcal_ros.methods.ball_plate import general, model
from rotcal_ros.methods.ball_plate.problem import BallPlateProblem
from rotcal_ros.methods.ball_plate.rejection import fit_and_reject
from rotcal_ros.methods.ball_plate.screening import screen
from rotcal_ros.methods.ball_plate.solve import solve


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
        return np.asarray(self.value + noise @ self.gain, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class SolvedTrials:
    """Trials by solving each; for separate groups, and grids too large for the linear map."""

    problem: BallPlateProblem
    std: Floats

    def __call__(self, rng: np.random.Generator, count: int) -> Floats:
        """Return the same as :class:`LinearTrials`."""
        return np.stack([self._one(rng.standard_normal(self.std.shape)) for _ in range(count)])

    def _one(self, noise: Floats) -> Floats:
        result = solve(replace(self.problem, centres=self.problem.centres + self.std * noise))
        return np.concatenate([result.deviations[name] for name in COMPONENTS])


def plate_trials(problem: BallPlateProblem) -> LinearTrials | SolvedTrials:
    """Prepare Monte Carlo trials about a measured problem; refuses what ``solve`` refuses.

    Rejected centres stay rejected; the noise is the one that the standard deviations of the
    result belong to.
    """
    result = solve(problem)
    scale = float(result.details["sigma_used"])
    large = model.offsets(problem).total > general.MAX_UNKNOWNS
    if problem.separate_groups or large:
        unit = np.ones_like(problem.centres) if problem.std is None else problem.std
        return SolvedTrials(problem, scale * unit)
    used = fit_and_reject(screen(problem).problem).problem
    unit = np.ones_like(used.centres) if used.std is None else used.std
    value = np.concatenate([result.deviations[name] for name in COMPONENTS])
    return LinearTrials(value, general.table_gain(used).T, (scale * unit).ravel())
