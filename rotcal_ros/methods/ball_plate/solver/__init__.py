"""Ball plate: all six deviations of a rotary table by the reduced three-rosette method.

The model and its constraints are those of the reduced three-rosette method with six degrees of
freedom; closed form and groups follow a second paper. docs/ball_plate.md has the derivation.
"""

from rotcal_ros.methods.ball_plate.solver.closed_form import ClosedForm, closed_form
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, select
from rotcal_ros.methods.ball_plate.solver.solution import adjust
from rotcal_ros.methods.ball_plate.solver.solve import result_of, solve
from rotcal_ros.methods.ball_plate.solver.trials import plate_trials

__all__ = [
    "BallPlateProblem",
    "ClosedForm",
    "adjust",
    "closed_form",
    "plate_trials",
    "result_of",
    "select",
    "solve",
]
