"""Laser tracer at three or more places on the table: all six deviations from lengths alone.

``solve(SixProblem(...)) -> Result``; docs/tracer_six.md has the derivation. The noise, outliers,
zeros and verdict of lengths are those of :mod:`rotcal_ros.methods.tracer.solver`; here is what a
rigid table with several places adds, each module knowing those before it:

* :mod:`.problem`, :mod:`.layout`: lengths as they are given, and in their places;
* :mod:`.curves`: from poses of the table to its six curves;
* :mod:`.network`: table, places and targets together, and their covariance;
* :mod:`.scatter`: how differently the table arrives, and what has moved;
* :mod:`.adjustment`, :mod:`.solution`: all of that for one problem;
* :mod:`.protections`, :mod:`.solve`, :mod:`.trials`: what could spoil it; the result; Monte Carlo.
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
