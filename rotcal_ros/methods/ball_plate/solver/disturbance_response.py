"""What any disturbance of the centres does: to the deviations found, and to the residuals.

The estimate is linear in the centres, so a drift or a knock of unit size tells all others. The
factors are made once and used for any number of right-hand sides; complete data keep the speed of
the spectral solution.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.methods.ball_plate.solver.model import PlateParameters
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem

Responder = Callable[[Floats], tuple[PlateParameters, Floats]]
"""Takes displacements (n, 3) of the centres, m, to the parameters and residuals (n, 3)."""


def responses(respond: Responder, displacements: Floats) -> tuple[list[PlateParameters], Floats]:
    """Return the parameters for each of the displacements (n, 3, m), and residuals (n, 3, m)."""
    found = [respond(displacements[:, :, m]) for m in range(displacements.shape[2])]
    return [parameters for parameters, _ in found], np.stack([left for _, left in found], axis=2)


def curves(parameters: list[PlateParameters]) -> Floats:
    """Return the six deviations (6, N, m), m and rad, in the order of COMPONENTS."""
    return np.array(
        [np.stack([p.component(name) for p in parameters], axis=1) for name in COMPONENTS]
    )


def weights(problem: BallPlateProblem) -> Floats:
    """Return the weights (n, 3) of the coordinates: 1, or 1 / std^2 where rows have their own."""
    if problem.std is None:
        return np.ones_like(problem.centres)
    own: Floats = problem.std**-2
    return own


def unit_std(parameters: PlateParameters) -> Floats:
    """Return the standard deviations (6, N) of the six deviations out of all of them."""
    return np.array([parameters.component(name) for name in COMPONENTS])
