"""A plate as the engine has it: its rows one by one, in the dense reference of all methods."""

import numpy as np

from rotcal_ros.adjust.fit import fitted, require_determined
from rotcal_ros.adjust.model import Model, linear
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.methods.ball_plate.solver import model
from rotcal_ros.methods.ball_plate.solver.estimate import drift_columns
from rotcal_ros.methods.ball_plate.solver.gathering import WORDS


def in_the_engine(problem):
    """The dense fit of the engine to the rows one by one; its outputs are the six deviations."""
    design, constraints = model.design_matrix(problem), model.constraint_matrix(problem)
    free = model.null_space(problem)
    to_constraints = np.eye(len(free)) - free @ np.linalg.solve(constraints @ free, constraints)
    to_constraints[np.abs(to_constraints) < 1e-12] = 0.0  # an output feels no rounding
    places = (model.component_places(problem, name) for name in COMPONENTS)
    plate = Model(
        blocks={name: own.stop - own.start for name, own in model.blocks(problem).items()},
        observed=problem.deviations.ravel(),
        std=problem.noise_unit.ravel(),
        equations=linear(design),
        outputs=np.concatenate([to_constraints[own] / length for own, length in places]),
        words=WORDS,
    )
    require_determined(plate)
    drift = drift_columns(problem.run_time, problem.drift).reshape(len(plate.observed), -1)
    every = np.ones(len(plate.observed), dtype=bool)
    return fitted(plate, every, plate.std, plate.first, drift)
