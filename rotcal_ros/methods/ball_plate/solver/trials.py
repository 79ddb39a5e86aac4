"""Monte Carlo trials of the ball plate method: the estimate is linear in the centres."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.raw_data import MOST_INFLUENCES, Influence
from rotcal_ros.methods.ball_plate.solver import general_least_squares, model
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem
from rotcal_ros.methods.ball_plate.solver.solution import PlateSolution, adjust


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
    if _linear(problem):
        used = solution.fits[0].problem
        std = _std(used, solution.noise.scale).ravel()
        return LinearTrials(_in_order(solution), general_least_squares.table_gain(used).T, std)
    return SolvedTrials(problem, _std(problem, solution.noise.used))


def influence_of(solution: PlateSolution) -> Influence | None:
    """Return what a standard error of each coordinate does to the curves.

    None for what :func:`plate_trials` solves trial by trial, and for too many centres.
    """
    used = solution.fits[0].problem
    rows = len(COMPONENTS) * len(used.table_positions)
    if not _linear(solution.problem) or rows * used.centres.size > MOST_INFLUENCES:
        return None
    gain = general_least_squares.table_gain(used) * _std(used, solution.noise.scale).ravel()
    by_component = dict(zip(COMPONENTS, np.split(gain, len(COMPONENTS)), strict=True))
    return Influence(used.rows, 3, by_component)


def _linear(problem: BallPlateProblem) -> bool:
    """Whether one matrix takes all centres to all deviations."""
    large = model.offsets(problem).total > general_least_squares.MAX_UNKNOWNS
    return not (problem.separate_groups or large or problem.drift > 0)


def _std(problem: BallPlateProblem, factor: Floats) -> Floats:
    return np.asarray(
        factor * (np.ones_like(problem.centres) if problem.std is None else problem.std)
    )


def _in_order(solution: PlateSolution) -> Floats:
    """Return all deviations, component by component."""
    deviations = solution.deviations()
    return np.concatenate([deviations[name] for name in COMPONENTS])
