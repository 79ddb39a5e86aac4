"""Laser tracer on the table, reflector on the probe: the multi-station method.

``solve(TracerProblem(...)) -> Result``. Source: the laser tracer multi-station paper, Eq. 1-36.
From the problem to the result, each module knowing those before it:

* :mod:`.problem`: lengths as they are given, and in their places on a grid;
* :mod:`.circle`, :mod:`.observability`: table angles from stations; what cannot be determined;
* :mod:`.adjustment`, :mod:`.network`, :mod:`.joint`: station by station, or all together;
* :mod:`.start`, :mod:`.zeros`: start values; what zeros do while it is measured;
* :mod:`.screening`: noise, outliers, disturbances in one place;
* :mod:`.uncertainty`, :mod:`.verdict`: of the angles, and whether they are to be believed;
* :mod:`.solution`: all of that for one problem;
* :mod:`.reported`, :mod:`.protections`: what could spoil the result;
* :mod:`.solve`, :mod:`.trials`, :mod:`.joined_runs`: the result, Monte Carlo, several runs as one;
* :mod:`.carried_lengths`: the lengths beside other instruments.
"""

from rotcal_ros.methods.tracer.settings import TracerLimits, TracerSolverSettings
from rotcal_ros.methods.tracer.solver.problem import TracerProblem
from rotcal_ros.methods.tracer.solver.solution import adjust
from rotcal_ros.methods.tracer.solver.solve import METHOD, solve
from rotcal_ros.methods.tracer.solver.trials import TracerTrials, trials_about

__all__ = [
    "METHOD",
    "TracerLimits",
    "TracerProblem",
    "TracerSolverSettings",
    "TracerTrials",
    "adjust",
    "solve",
    "trials_about",
]
