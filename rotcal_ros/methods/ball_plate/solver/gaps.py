"""A nearly complete measurement: the spectral solution, corrected exactly for a few gaps.

A missing centre is filled with the value that gives it a zero residual; the fit of the filled
data is then the least squares fit of the others. The fill values follow from the residual
cofactors at the gaps (a 3m x 3m system for m gaps), and the same matrix corrects the
covariances. Works for any grid, where the general solution would not fit into memory.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.methods.ball_plate.solver import model, spectral
from rotcal_ros.methods.ball_plate.solver.model import FIELDS, LinearFit, PlateParameters, Solution
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, on_circle

DETERMINED = 1e-7
"""Smallest accepted eigenvalue of the residual cofactor at the gaps."""


def gap_cells(problem: BallPlateProblem) -> Ints | None:
    """Return the missing cells (place in the complete canonical order), None if some repeat."""
    ball = np.searchsorted(problem.balls, problem.ball_step)
    cells = ball * problem.grid + problem.position
    if len(np.unique(cells)) < len(cells):
        return None
    return np.setdiff1d(np.arange(len(problem.balls) * problem.grid), cells)


def solve_with_gaps(problem: BallPlateProblem, gaps: Ints) -> Solution:
    """Solve an equally weighted problem of which only the cells ``gaps`` (m,) are missing.

    Raises ObservabilityError when the remaining centres do not determine all parameters.
    """
    linear = factored(problem, gaps)
    return linear.solution(*linear.fit(problem.deviations))


def factored(problem: BallPlateProblem, gaps: Ints) -> LinearFit:
    """Factor such a problem; raises what :func:`solve_with_gaps` does."""
    complete, measured = _complete(problem, gaps)
    linear = spectral.factored(complete)
    responses, inverse = _correction(complete, linear, gaps)

    def fit(observed: Floats) -> tuple[PlateParameters, Floats]:
        filled = np.zeros((len(complete.centres), 3))
        filled[measured] = observed
        _, start = linear.fit(filled)
        filled[gaps] = -(inverse @ start[gaps].ravel()).reshape(-1, 3)
        estimate, residuals = linear.fit(filled)
        return estimate, residuals[measured]

    def solution(estimate: PlateParameters, residuals: Floats) -> Solution:
        start = linear.solution(estimate, np.zeros((len(complete.centres), 3)))
        estimates = tuple(response for response, _ in responses)
        moved = np.stack([left[measured] for _, left in responses], axis=2)
        return Solution(
            estimate=estimate,
            unit_std=_corrected_std(start.unit_std, estimates, inverse),
            unit_covariance=partial(_table_covariance, start, estimates, inverse),
            residuals=residuals,
            cofactor=partial(_cofactor, start, measured, moved, inverse),
            weighted_square_sum=float(residuals.ravel() @ residuals.ravel()),
            dof=model.degrees_of_freedom(problem),
            way="spectral with gaps",
        )

    return LinearFit(fit, solution)


def _correction(
    complete: BallPlateProblem, linear: LinearFit, gaps: Ints
) -> tuple[list[tuple[PlateParameters, Floats]], Floats]:
    """Return the responses (3m) to unit deviations at the gaps, and the inverse at the gaps."""
    responses = []
    for cell in gaps:
        for axis in range(3):
            unit = np.zeros((len(complete.centres), 3))
            unit[cell, axis] = 1.0
            responses.append(linear.fit(unit))
    at_gaps = np.array([residuals[gaps].ravel() for _, residuals in responses])
    at_gaps = 0.5 * (at_gaps + at_gaps.T)
    if np.linalg.eigvalsh(at_gaps)[0] < DETERMINED:
        raise ObservabilityError(
            "without the missing or rejected centres not all errors of table, plate and CMM are "
            "determined: measure more balls at the table positions of the gaps"
        )
    return responses, np.linalg.inv(at_gaps)


def _complete(problem: BallPlateProblem, gaps: Ints) -> tuple[BallPlateProblem, Ints]:
    """Fill the gaps with nominal centres; also return the places of the measured rows."""
    grid, n_balls = problem.grid, len(problem.balls)
    measured = np.setdiff1d(np.arange(n_balls * grid), gaps)
    table, ball = np.tile(np.arange(grid), n_balls), np.repeat(problem.balls, grid)
    centres = problem.radius * on_circle(problem.angles[(table + ball) % grid])
    centres[measured] = problem.centres
    return BallPlateProblem(grid, problem.radius, table, ball, centres), measured


def _corrected_std(
    std: PlateParameters, responses: tuple[PlateParameters, ...], inverse: Floats
) -> PlateParameters:
    fields = {}
    for name in FIELDS:
        columns = np.stack([getattr(response, name) for response in responses], axis=-1)
        added = np.einsum("...i,ij,...j->...", columns, inverse, columns)
        fields[name] = np.sqrt(getattr(std, name) ** 2 + added)
    return PlateParameters(**fields)


def _table_covariance(
    start: Solution,
    responses: tuple[PlateParameters, ...],
    inverse: Floats,
    first: str,
    second: str,
) -> Floats:
    """Return the unit covariance of two components, with what the gaps add."""
    columns = np.stack([response.component(first) for response in responses], axis=1)
    others = np.stack([response.component(second) for response in responses], axis=1)
    added: Floats = columns @ inverse @ others.T
    return start.unit_covariance(first, second) + added


def _cofactor(start: Solution, measured: Ints, moved: Floats, inverse: Floats) -> Floats:
    """Return the unit covariance of the residuals, less what the gaps take."""
    taken: Floats = moved @ inverse @ moved.swapaxes(1, 2)
    return start.cofactor()[measured] - taken
