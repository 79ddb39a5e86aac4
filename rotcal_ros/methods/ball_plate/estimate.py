"""Which of the ways solves a problem: one model, one answer."""

from __future__ import annotations

from rotcal_ros.methods.ball_plate.general import solve_general
from rotcal_ros.methods.ball_plate.model import Solution
from rotcal_ros.methods.ball_plate.problem import BallPlateProblem
from rotcal_ros.methods.ball_plate.spectral import solve_spectral


def least_squares(problem: BallPlateProblem) -> Solution:
    """Solve complete, equally weighted data harmonic by harmonic, all others by elimination.

    Raises ObservabilityError when the centres do not determine all parameters.
    """
    if problem.complete and problem.std is None:
        return solve_spectral(problem)
    return solve_general(problem)
