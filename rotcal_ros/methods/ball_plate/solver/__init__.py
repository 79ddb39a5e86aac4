"""Ball plate: all six deviations of a rotary table by the reduced three-rosette method.

The model and its definitions are those of the reduced three-rosette method with six degrees of
freedom; closed form and groups follow a second paper. Derivation: docs/ball_plate_derivation.md.

To read in this order:

* :mod:`.problem`: the centres; :mod:`.screening`: mistakes that are found before any fit
* :mod:`.layout`: unknowns, equations, what is open, definitions
* :mod:`.separability`: whether balls and positions suffice, in words, by :mod:`.harmonics`
* :mod:`.plate_model`: noise, groups and effects for the engine, which solves it
* :mod:`.closed_form`: the second paper as printed
* :mod:`.result`: the result
"""

from rotcal_ros.methods.ball_plate.solver.closed_form import ClosedForm, closed_form
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, select
from rotcal_ros.methods.ball_plate.solver.result import (
    adjust,
    of_curves,
    plate_trials,
    result_of,
    solve,
    trials_about,
)

__all__ = [
    "BallPlateProblem",
    "ClosedForm",
    "adjust",
    "closed_form",
    "of_curves",
    "plate_trials",
    "result_of",
    "select",
    "solve",
    "trials_about",
]
