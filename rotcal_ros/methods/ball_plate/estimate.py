"""Which of the ways solves a problem: one model, one answer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from rotcal_ros.arrays import Floats, Ints
from rotcal_ros.methods.ball_plate import gaps, general, model
from rotcal_ros.methods.ball_plate.general import solve_general
from rotcal_ros.methods.ball_plate.model import Solution
from rotcal_ros.methods.ball_plate.problem import BallPlateProblem
from rotcal_ros.methods.ball_plate.spectral import solve_spectral

FEW_GAPS = 20
"""Gaps up to which correcting the spectral solution is quicker than the elimination."""
MANY_GAPS = 300
"""Gaps up to which it is also done where the elimination does not fit into memory."""


def least_squares(problem: BallPlateProblem) -> Solution:
    """Solve complete, equally weighted data harmonic by harmonic, all others by elimination.

    A few gaps are corrected for exactly; see :mod:`gaps`. Raises ObservabilityError when the
    centres do not determine all parameters.
    """
    if problem.complete and problem.std is None:
        return solve_spectral(problem)
    cells = _few_gaps(problem)
    return solve_general(problem) if cells is None else gaps.solve_with_gaps(problem, cells)


def residual_operator(problem: BallPlateProblem) -> Callable[[Floats], Floats]:
    """Return the function that takes deviations (n, 3) of these rows to their residuals."""
    cells = _few_gaps(problem)
    if cells is not None and len(cells):
        return gaps.residual_operator(problem, cells)
    if cells is None:
        return general.residual_operator(problem)
    nominal = problem.centres - problem.deviations

    def residuals(observed: Floats) -> Floats:
        return solve_spectral(replace(problem, centres=nominal + observed)).residuals

    return residuals


def _few_gaps(problem: BallPlateProblem) -> Ints | None:
    """Return the missing cells when correcting for them is the better way, else None."""
    cells = None if problem.std is not None else gaps.gap_cells(problem)
    large = model.offsets(problem).total > general.MAX_UNKNOWNS
    if cells is None or len(cells) > (MANY_GAPS if large else FEW_GAPS):
        return None
    general.require_balls(problem)
    return cells
