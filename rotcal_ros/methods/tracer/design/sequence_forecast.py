"""What a drift of the machine or a knock of the tracer would do in an order of measurement.

The solver's own statement (:mod:`rotcal_ros.methods.tracer.solver.protections`) at the nominal
geometry: a plan is solved once with lengths that have the stated noise, and judged for as many
orders as wanted. Exact lengths would be taken for a quieter instrument.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, isfinite

import numpy as np

from rotcal_ros.foundation.arrays import Ints
from rotcal_ros.foundation.protection import TOLERABLE
from rotcal_ros.methods.tracer.solver.problem import TracerProblem
from rotcal_ros.methods.tracer.solver.protections import of_the_order
from rotcal_ros.methods.tracer.solver.solution import TracerSolution, adjust


@dataclass(frozen=True, slots=True)
class Forecast:
    """The largest errors that may stay unseen, in standard uncertainties; infinite: any."""

    drift: float
    knock: float

    @property
    def worst(self) -> float:
        """The larger one of both."""
        return max(self.drift, self.knock)

    @property
    def protected(self) -> bool:
        """Whether both are small enough not to be named in a verdict."""
        return self.worst <= TOLERABLE

    def to_dict(self) -> dict[str, float | None]:
        """Return the forecast as plain data, None where nothing bounds an error."""
        return {
            name: value if isfinite(value) else None
            for name, value in (("drift", self.drift), ("knock", self.knock))
        }


class SequenceForecast:
    """Judges orders of the lengths of one plan; ``problem`` holds lengths with the stated noise.

    Raises ObservabilityError when the plan cannot tell the angle at all.
    """

    def __init__(self, problem: TracerProblem) -> None:
        self._solution: TracerSolution = adjust(problem)

    def __call__(self, order: Ints) -> Forecast:
        """Return the forecast for ``order`` (k,): rows of the problem as they are measured."""
        problem = replace(self._solution.problem, order=ranks(order))
        solution = replace(self._solution, problem=problem)
        drift, knock = (
            _unseen(effect.treatment, effect.error) for effect in of_the_order(solution)
        )
        return Forecast(drift=drift, knock=knock)


def ranks(order: Ints) -> Ints:
    """Return when each row (k,) is measured in an ``order`` (k,) of rows."""
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    return rank


def _unseen(treatment: str, error: float | None) -> float:
    """Return the error of a statement: none where it is harmless, any where nothing tells it."""
    if error is not None:
        return error
    return 0.0 if treatment == "harmless" else inf
