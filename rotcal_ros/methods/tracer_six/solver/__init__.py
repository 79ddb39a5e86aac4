"""Laser tracer at three or more places on the table: all six deviations from lengths alone.

``solve(SixProblem(...)) -> Result``; docs/tracer_six.md has the derivation. The noise, outliers,
zeros and verdict of lengths are those of :mod:`rotcal_ros.methods.tracer.solver`; here is what a
rigid table with several places adds, each module knowing those before it:

* :mod:`.problem`: lengths as they are given, and in their places;
* :mod:`.network`: table, places and targets together, their covariance, and the six curves;
* :mod:`.scatter`: how differently the table arrives, and what has moved;
* :mod:`.solution`: all of that for one problem, and Monte Carlo about it;
* :mod:`.solve`: what could spoil it, and the result.
"""

from rotcal_ros.methods.tracer_six.settings import TracerSixSolverSettings
from rotcal_ros.methods.tracer_six.solver.problem import SixProblem
from rotcal_ros.methods.tracer_six.solver.solve import METHOD, SixTrials, adjust, solve

__all__ = ["METHOD", "SixProblem", "SixTrials", "TracerSixSolverSettings", "adjust", "solve"]
