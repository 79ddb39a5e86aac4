"""Ball plate, reduced three-rosette: all six deviations from ball centres of your own.

``solve(Problem(...))`` gives a ``Result``, ``closed_form`` the same by means alone for as many
balls as table positions, ``select`` leaves balls or positions out. Centres in m in a frame on
the axis, deviation = actual - commanded in m and rad. Raises DataError for a contradictory table,
ObservabilityError if balls and positions do not separate the errors, PlanError for an incomplete
grid.

>>> import numpy as np
>>> import rotcal_ros as rc
>>> grid, radius = 12, 0.185
>>> table, ball = np.divmod(np.arange(grid * grid), grid)
>>> turn = 2 * rc.ARCSEC * np.cos(2 * 2 * np.pi * np.arange(grid) / grid)  # ECC, injected
>>> place = 2 * np.pi * (table + ball) / grid + turn[table]
>>> centres = radius * np.column_stack([np.cos(place), np.sin(place), np.zeros(grid * grid)])
>>> problem = rc.ball_plate.Problem(grid, radius, table, ball, centres, sigma=1e-8)
>>> result = rc.ball_plate.solve(problem)
>>> bool(np.all(np.abs(result.deviations["ECC"] - turn) < 1e-3 * rc.ARCSEC))
True
>>> form = rc.ball_plate.closed_form(problem)
>>> bool(np.all(np.abs(form.rotation[:, 2] - turn) < 1e-3 * rc.ARCSEC))
True
"""

from rotcal_ros.methods.ball_plate.solver import BallPlateProblem as Problem
from rotcal_ros.methods.ball_plate.solver import ClosedForm, closed_form, select, solve

__all__ = ["ClosedForm", "Problem", "closed_form", "select", "solve"]
