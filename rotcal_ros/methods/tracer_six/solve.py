"""The six-deviations method from problem to result."""

from __future__ import annotations

from rotcal_ros.errors import ObservabilityError
from rotcal_ros.methods.tracer_six.problem import SixProblem
from rotcal_ros.results import Result

METHOD = "tracer_six"


def solve(problem: SixProblem) -> Result:
    """Return EXC, EYC, EZC (m), EAC, EBC, ECC (rad) of the table at the commanded angles."""
    raise ObservabilityError(f"{len(problem.length)} lengths: solving follows in the next commit")
