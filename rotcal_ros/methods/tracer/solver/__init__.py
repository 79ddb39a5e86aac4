"""Laser tracer on the table, reflector on the probe: the multi-station method.

``solve(TracerProblem(...)) -> Result``; see :mod:`.problem` for what goes in and
:mod:`.solve` for what comes out. Source: the laser tracer multi-station paper, Eq. 1-36.
"""

from rotcal_ros.methods.tracer.solver.problem import TracerProblem
from rotcal_ros.methods.tracer.solver.solve import METHOD, solve
from rotcal_ros.methods.tracer.solver.trials import TracerTrials, tracer_trials
from rotcal_ros.methods.tracer.solver_settings import TracerLimits, TracerSolverSettings

__all__ = [
    "METHOD",
    "TracerLimits",
    "TracerProblem",
    "TracerSolverSettings",
    "TracerTrials",
    "solve",
    "tracer_trials",
]
