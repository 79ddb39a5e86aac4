"""The constrained least squares as printed (Eq. 10 to 21), one dense matrix.

Opponent of the benchmark and referee of the tests. Slow and large (N = 72, R = 12: 709 unknowns
and multipliers), but nothing in it is clever.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.methods.ball_plate.solver import model
from rotcal_ros.methods.ball_plate.solver.model import Solution
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem


def solve_dense(problem: BallPlateProblem) -> Solution:
    """Solve Eq. 20 and invert its matrix for Eq. 21.

    Raises ObservabilityError when the matrix is singular.
    """
    design, constraints = model.design_matrix(problem), model.constraint_matrix(problem)
    observed = problem.deviations.ravel()
    if problem.std is not None:
        weight = 1.0 / problem.std.ravel()
        weight_design, observed = design * weight[:, None], observed * weight
    else:
        weight_design = design
    size = design.shape[1]
    normal = weight_design.T @ weight_design
    scale = np.trace(normal) / size  # brings the constraints to the size of T'T
    border = np.zeros((size + len(constraints),) * 2)
    border[:size, :size] = normal / scale
    border[size:, :size], border[:size, size:] = constraints, constraints.T
    try:
        inverse = np.linalg.inv(border)[:size, :size] / scale
    except np.linalg.LinAlgError:
        raise ObservabilityError("the matrix of Eq. 20 is singular") from None
    vector = inverse @ (weight_design.T @ observed)
    residuals = problem.deviations - (design @ vector).reshape(-1, 3)
    return Solution(
        estimate=model.unpack(problem, vector),
        unit_std=model.unpack(problem, np.sqrt(np.maximum(np.diag(inverse), 0.0))),
        unit_covariance=partial(model.covariance_of, problem, inverse),
        residuals=residuals,
        cofactor=partial(model.residual_cofactor, problem, inverse),
        weighted_square_sum=model.weighted_square_sum(problem, residuals),
        dof=model.degrees_of_freedom(problem),
        way="dense",
    )
