"""Which of the ways solves a problem: one model, one answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.methods.ball_plate.solver import (
    drift,
    gaps,
    general_least_squares,
    model,
    rigorous,
    spectral,
)
from rotcal_ros.methods.ball_plate.solver.model import LinearFit, PlateParameters, Solution
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem

FEW_GAPS = 20
"""Gaps up to which correcting the spectral solution is quicker than the elimination."""
MANY_GAPS = 300
"""Gaps up to which it is also done where the elimination does not fit into memory."""


def least_squares(problem: BallPlateProblem) -> Solution:
    """Solve the exact model: the linear one, iterated until the neglected products are gone.

    Raises ObservabilityError when the centres do not determine all parameters, DataError when
    plate or frame are too far off for the iteration to settle.
    """
    return solved(problem)[1]


def solved(problem: BallPlateProblem) -> tuple[LinearFit, Solution]:
    """Return the factored linear model and the solution of the exact one; a drift is estimated.

    Raises what :func:`least_squares` does.
    """
    plain = factored(problem)
    if not problem.drift:
        return plain, rigorous.settle(problem, plain)
    border = drift.Border(problem, plain.fit)
    return border.fit(plain), border.settled(problem, plain, rigorous.settle)


def factored(problem: BallPlateProblem) -> LinearFit:
    """Factor complete, equally weighted data harmonic by harmonic, all others by elimination.

    This is the model of Eq. 12 alone, without a drift. A few gaps are corrected for exactly; see
    :mod:`gaps`. Raises ObservabilityError when the centres do not determine all parameters.
    """
    axes = _same_everywhere(problem)
    if axes is not None:
        return _scaled(factored(replace(problem, std=None)), axes)
    if problem.complete and problem.std is None:
        return spectral.factored(problem)
    cells = _few_gaps(problem)
    return (
        general_least_squares.factored(problem) if cells is None else gaps.factored(problem, cells)
    )


def _same_everywhere(problem: BallPlateProblem) -> Floats | None:
    """Return the standard deviations (3,) of all rows when x and y have the same one.

    The linear model keeps z apart from x and y, so such weights change no estimate.
    """
    if problem.std is None or np.ptp(problem.std, axis=0).any():
        return None
    axes: Floats = problem.std[0]
    return axes if axes[0] == axes[1] else None


def _scaled(linear: LinearFit, axes: Floats) -> LinearFit:
    """Return the fit whose unit covariances belong to noise of ``axes`` (3,)."""

    def solution(estimate: PlateParameters, residuals: Floats) -> Solution:
        unit = linear.solution(estimate, residuals)

        def covariance(first: str, second: str) -> Floats:
            scale = model.of_component(axes, first) * model.of_component(axes, second)
            scaled: Floats = scale * unit.unit_covariance(first, second)
            return scaled

        return replace(
            unit,
            unit_std=model.scaled(unit.unit_std, axes),
            unit_covariance=covariance,
            cofactor=lambda: unit.cofactor() * np.outer(axes, axes),
            weighted_square_sum=float(np.sum((residuals / axes) ** 2)),
        )

    return LinearFit(linear.fit, solution)


def _few_gaps(problem: BallPlateProblem) -> Ints | None:
    """Return the missing cells when correcting for them is the better way, else None."""
    if problem.std is not None or problem.bidirectional:
        return None
    whole = (problem.table_positions, problem.cmm_positions)
    if min(map(len, whole)) < problem.grid:
        return None  # a filled grid would have unknowns that no centre sees
    cells = gaps.gap_cells(problem)
    large = model.offsets(problem).total > general_least_squares.MAX_UNKNOWNS
    if cells is None or len(cells) > (MANY_GAPS if large else FEW_GAPS):
        return None
    general_least_squares.require_balls(problem)
    return cells
