"""Which of the ways solves a problem: one model, one answer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from rotcal_ros.methods.ball_plate import general
from rotcal_ros.methods.ball_plate.general import solve_general
from rotcal_ros.methods.ball_plate.model import Solution
from rotcal_ros.methods.ball_plate.problem import BallPlateProblem, Floats
from rotcal_ros.methods.ball_plate.spectral import solve_spectral


def least_squares(problem: BallPlateProblem) -> Solution:
    """Solve complete, equally weighted data harmonic by harmonic, all others by elimination.

    Raises ObservabilityError when the centres do not determine all parameters.
    """
    if problem.complete and problem.std is None:
        return solve_spectral(problem)
    return solve_general(problem)


def residual_operator(problem: BallPlateProblem) -> Callable[[Floats], Floats]:
    """Return the function that takes deviations (n, 3) of these rows to their residuals."""
    if not problem.complete or problem.std is not None:
        return general.residual_operator(problem)
    nominal = problem.centres - problem.deviations

    def residuals(observed: Floats) -> Floats:
        return solve_spectral(replace(problem, centres=nominal + observed)).residuals

    return residuals
