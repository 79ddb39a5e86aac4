"""Laser tracer on the table, reflector on the probe: the multi-station method.

``solve(TracerProblem(...)) -> Result``. Source: the laser tracer multi-station paper, Eq. 1-36.
From the problem to the result, each module knowing those before it:

* :mod:`.problem`: lengths as they are given, and in their places on a grid;
* :mod:`.circle`, :mod:`.observability`: table angles from stations; what cannot be determined;
* :mod:`.station_by_station`, :mod:`.start`: the paper's own way, and start values;
* :mod:`.carried_lengths`, :mod:`.posed`: the lengths as a model of the engine, and what is stated;
* :mod:`.solution`: what nobody stated, and the problem solved;
* :mod:`.reported`, :mod:`.reporting`: places believed as reported, what is said about each length;
* :mod:`.solve`: the result.
"""

from rotcal_ros.methods.tracer.settings import TracerLimits, TracerSolverSettings
from rotcal_ros.methods.tracer.solver.problem import TracerProblem
from rotcal_ros.methods.tracer.solver.solution import adjust
from rotcal_ros.methods.tracer.solver.solve import METHOD, solve

__all__ = [
    "METHOD",
    "TracerLimits",
    "TracerProblem",
    "TracerSolverSettings",
    "adjust",
    "solve",
]
