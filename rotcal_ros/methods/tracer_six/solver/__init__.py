"""Laser tracer at three or more places on the table: all six deviations from lengths alone.

``solve(SixProblem(...)) -> Result``; docs/tracer_six.md has the derivation. Each module knows
those before it:

* :mod:`.problem`: lengths as they are given, and in their places;
* :mod:`.poses`: those of the table to start from, and six curves in the frames that define them;
* :mod:`.model`: the lengths, and what could spoil them, as a model of the engine;
* :mod:`.solve`: its solution, what only the method can say of it, and the result.
"""

from rotcal_ros.methods.tracer_six.settings import TracerSixSolverSettings
from rotcal_ros.methods.tracer_six.solver.problem import SixProblem
from rotcal_ros.methods.tracer_six.solver.solve import METHOD, adjust, solve

__all__ = ["METHOD", "SixProblem", "TracerSixSolverSettings", "adjust", "solve"]
