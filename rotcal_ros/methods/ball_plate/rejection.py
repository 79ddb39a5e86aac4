"""Fit, test, reject, fit again: until every centre fits or the plate is found to have moved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.errors import DataError, ObservabilityError
from rotcal_ros.methods.ball_plate.estimate import least_squares
from rotcal_ros.methods.ball_plate.knock import Knock, find_knock
from rotcal_ros.methods.ball_plate.model import Solution
from rotcal_ros.methods.ball_plate.outliers import CentreTest, choose, judge_centres
from rotcal_ros.methods.ball_plate.problem import BallPlateProblem
from rotcal_ros.methods.ball_plate.separability import require_separable
from rotcal_ros.results import Rejection

MOST = 0.1
"""Part of the centres that may be rejected before the data are called contradictory."""


@dataclass(frozen=True)
class Fitted:
    """The rows that were kept, their solution and tests, the rejected ones and why."""

    problem: BallPlateProblem
    solution: Solution
    test: CentreTest
    rejected: tuple[Rejection, ...]
    knock: Knock | None


def fit_and_reject(problem: BallPlateProblem) -> Fitted:
    """Solve, and reject centres beyond their critical value, worst first.

    A jump of the plate that explains more than the worst centre ends the rejection: the moved
    rows are not wrong one by one. Raises ObservabilityError when too little is left, DataError
    when more than a tenth of the centres would have to go.
    """
    whole, rejected = problem, list[Rejection]()
    while True:
        solution = _solve(problem)
        if solution.dof < 1:
            raise DataError(
                f"{len(problem.centres)} centres leave no redundancy: nothing can be checked; "
                "measure more balls or CMM positions"
            )
        sigma = 1.0 if problem.std is not None else problem.sigma
        test = judge_centres(problem, solution, sigma)
        knock = find_knock(problem, solution)
        if knock is not None and knock.gain > test.gain.max():
            return Fitted(problem, solution, test, tuple(rejected), knock)
        bad = choose(problem, test)
        if not len(bad):
            return Fitted(problem, solution, test, tuple(rejected), None)
        rejected += [
            Rejection(int(problem.rows[r]), _reason(problem, solution.residuals[r], test, int(r)))
            for r in bad
        ]
        _check_share(len(rejected), whole, rejected[0])
        problem = problem.take(np.setdiff1d(np.arange(len(problem.centres)), bad))


def _solve(problem: BallPlateProblem) -> Solution:
    """Solve, or say in words which harmonics of which component cannot be separated."""
    try:
        return least_squares(problem)
    except ObservabilityError:
        require_separable(problem)  # names the harmonics, where it is the harmonics
        raise


def _reason(problem: BallPlateProblem, residual: Floats, test: CentreTest, r: int) -> str:
    size = float(np.linalg.norm(residual)) / 1e-6
    return (
        f"row {problem.rows[r]} (ball step {problem.ball_step[r]}, table position "
        f"{problem.position[r]}): residual {size:.3g} um, normalised {test.value[r]:.1f} where "
        f"{test.critical[r]:.1f} is the limit"
    )


def _check_share(count: int, problem: BallPlateProblem, worst: Rejection) -> None:
    if count > MOST * len(problem.centres):
        raise DataError(
            f"{count} of {len(problem.centres)} centres contradict the others, more than "
            f"{MOST:.0%} may not be rejected; the worst: {worst.why}"
        )
