"""Laser tracer on the table, reflector on the probe: the multi-station method.

``solve(TracerProblem(...)) -> Result``. Source: the laser tracer multi-station paper, Eq. 1-36.
From the problem to the result, each module knowing those before it:

* :mod:`.problem`, :mod:`.grid`: lengths as they are given, and in their places;
* :mod:`.circle`, :mod:`.observability`: table angles from stations; what cannot be told;
* :mod:`.adjustment`, :mod:`.network`, :mod:`.joint`: station by station, or all together;
* :mod:`.start`, :mod:`.zeros`: start values; what zeros do while it is measured;
* :mod:`.gathering`, :mod:`.screening`: disturbances in one place; noise and outliers;
* :mod:`.uncertainty`, :mod:`.verdict`: of the angles, and whether they are to be believed;
* :mod:`.solution`: all of that for one problem;
* :mod:`.reported`, :mod:`.protections`: what could spoil the result;
* :mod:`.solve`, :mod:`.trials`, :mod:`.joined_runs`: the result, Monte Carlo, several runs as one;
* :mod:`.carried_lengths`: the lengths beside other instruments.
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
