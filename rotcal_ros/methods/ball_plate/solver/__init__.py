"""Ball plate: all six deviations of a rotary table by the reduced three-rosette method.

The model and its definitions are those of the reduced three-rosette method with six degrees of
freedom; closed form and groups follow a second paper. Derivation: docs/ball_plate_derivation.md.

To read in this order:

* :mod:`.problem`: the centres; :mod:`.screening`: mistakes that are found before any fit
* :mod:`.layout`: unknowns, equations, what is open, definitions
* :mod:`.separability`: whether balls and positions suffice, in words
* :mod:`.plate_model`: noise, groups and effects for the engine, which solves it
* :mod:`.closed_form`: the second paper as printed
* :mod:`.result`: the result
"""

from rotcal_ros.methods.ball_plate.solver.closed_form import ClosedForm as ClosedForm
from rotcal_ros.methods.ball_plate.solver.closed_form import closed_form as closed_form
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem as BallPlateProblem
from rotcal_ros.methods.ball_plate.solver.problem import select as select
from rotcal_ros.methods.ball_plate.solver.result import adjust as adjust
from rotcal_ros.methods.ball_plate.solver.result import model_of_curves as model_of_curves
from rotcal_ros.methods.ball_plate.solver.result import plate_trials as plate_trials
from rotcal_ros.methods.ball_plate.solver.result import result_of as result_of
from rotcal_ros.methods.ball_plate.solver.result import solve as solve
from rotcal_ros.methods.ball_plate.solver.result import trials_about as trials_about
