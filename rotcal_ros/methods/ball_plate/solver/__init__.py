"""Ball plate: all six deviations of a rotary table by the reduced three-rosette method.

The model and its constraints are those of the reduced three-rosette method with six degrees of
freedom; closed form and groups follow a second paper. Derivation:
docs/ball_plate_derivation.md.

To read in this order:

* :mod:`.problem`: the centres; :mod:`.model`: unknowns, linear model, constraints
* :mod:`.spectral` and :mod:`.general_least_squares`: its solution, for complete and for any data;
  :mod:`.separability`: whether there is one
* :mod:`.estimate`: the way to solve, gaps, drift, the exact model
* :mod:`.screening`, :mod:`.rejection`, :mod:`.gathering`: rows that are not fitted, before the
  first fit, one by one, and together in one place
* :mod:`.noise`, :mod:`.order_effects`, :mod:`.repeated_stops`: what the residuals show
* :mod:`.solution`: all of this for each group of table positions; :mod:`.result`: the result, what
  may be wrong with it all the same, and trials of it
* :mod:`.curve_model`: the centres beside other instruments
"""

from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, select
from rotcal_ros.methods.ball_plate.solver.result import (
    plate_trials,
    result_of,
    solve,
    trials_about,
)
from rotcal_ros.methods.ball_plate.solver.solution import adjust
from rotcal_ros.methods.ball_plate.solver.spectral import ClosedForm, closed_form

__all__ = [
    "BallPlateProblem",
    "ClosedForm",
    "adjust",
    "closed_form",
    "plate_trials",
    "result_of",
    "select",
    "solve",
    "trials_about",
]
