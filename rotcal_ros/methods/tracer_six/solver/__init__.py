"""Laser tracer at three or more places on the table: all six deviations from lengths alone.

``solve(SixProblem(...)) -> Result``; see :mod:`.problem` for what goes in and :mod:`.solve` for
what comes out. docs/tracer_six.md has the derivation.
"""

from rotcal_ros.methods.tracer_six.solver.problem import SixProblem
from rotcal_ros.methods.tracer_six.solver.solve import METHOD, solve
from rotcal_ros.methods.tracer_six.solver.trials import SixTrials, six_trials
from rotcal_ros.methods.tracer_six.solver_settings import TracerSixSolverSettings

__all__ = [
    "METHOD",
    "SixProblem",
    "SixTrials",
    "TracerSixSolverSettings",
    "six_trials",
    "solve",
]
