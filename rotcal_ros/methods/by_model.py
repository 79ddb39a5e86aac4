"""Methods whose observations the engine adjusts: from a model to all that a method offers.

A method says what it measures in one :class:`~rotcal_ros.adjust.model.Model` (see
``docs/engine.md``). From that follow the result with its doubts and protections, Monte Carlo
trials, and measurements that are spoiled on purpose.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from rotcal_ros.adjust.engine import Adjusted, adjust
from rotcal_ros.adjust.model import Model
from rotcal_ros.capture.attempt import CaptureRules
from rotcal_ros.capture.decisions import mean_point, points
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR, SHOWN_IN
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.observations import Observation, PointKind
from rotcal_ros.foundation.protection import EFFECTS, Protection
from rotcal_ros.foundation.results import Result
from rotcal_ros.methods.arrivals import Arrivals, RepeatedTrials, mean_of_runs
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.disturbance import (
    Disturbance,
    Disturbances,
    DisturbedMeasurement,
    Sizes,
    spoiled,
)
from rotcal_ros.methods.method import Method, Trials
from rotcal_ros.methods.result_tables import ResultTable
from rotcal_ros.planning.plan import Plan
from rotcal_ros.planning.readings import Readings

TRUE_SIZE: Final = 2.0
"""Standard deviation of the deviations that a measurement on purpose has, in units of people."""


def tables_of_also(result: Result) -> list[ResultTable]:
    """Return what the model tells beside the deviations, a table for each name."""
    factor, label = SHOWN_IN["rad" if result.residuals is None else result.residuals.unit]
    unit = label.replace("µ", "u")
    return [
        ResultTable.of(
            name.replace(" ", "_"),
            name.capitalize(),
            number=range(len(found["value"])),
            **{
                f"value_{unit}": np.asarray(found["value"]) / factor,
                f"U_value_{unit}": COVERAGE_FACTOR * np.asarray(found["std"]) / factor,
            },
        )
        for name, found in result.details["also"].items()
    ]


@dataclass(frozen=True)
class Statement:
    """What a method says itself of a result; its word on an effect takes that of the engine."""

    doubts: Sequence[str] = ()
    protections: Sequence[Protection] = ()
    details: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class ByModel:
    """A method with the ``name``, by its ``model`` of readings.

    The first observations of a model are the readings, in their order. Its outputs are the
    deviations at the first table positions of the plan, one of the ``components`` after the other.
    ``states`` tells what the engine cannot know; all that every method lists has to be said.
    ``counts_from``: what they count from, see :class:`~rotcal_ros.foundation.results.Zeros`.
    ``arrivals`` returns those of a plan that comes to its angles more than once: their mean is
    the result, and the curves from each side.
    """

    name: str
    model: Callable[[Configuration, Readings], Model]
    states: Callable[[Configuration, Adjusted], Statement]
    components: tuple[str, ...] = ("ECC",)
    counts_from: str = "first angle"
    arrivals: Callable[[Configuration], Arrivals | None] = lambda _configuration: None

    def solve(
        self, configuration: Configuration, plan: Plan, observations: Sequence[Observation]
    ) -> Result:
        """Return the result of accepted observations."""
        found, read = self._adjusted(configuration, observations), Readings.of(observations)
        statement = self.states(configuration, found)
        count = len(found.value) // len(self.components)
        result = found.result(
            self.name,
            np.array(plan.table_angles[:count]),
            {c: slice(k * count, (k + 1) * count) for k, c in enumerate(self.components)},
            (read.position % count, read.target),
            counts_from=self.counts_from,
            doubts=statement.doubts,
            protections=statement.protections,
            details=statement.details,
        )
        if silent := set(EFFECTS) - {p.effect for p in result.protections}:
            raise DataError(
                f"the method {self.name} says nothing of {', '.join(sorted(silent))}: declare an "
                "effect of the model, or state a protection"
            )
        arrivals = self.arrivals(configuration)
        return result if arrivals is None else mean_of_runs(result, arrivals)

    def trials(
        self, configuration: Configuration, plan: Plan, observations: Sequence[Observation]
    ) -> Trials:
        """Prepare Monte Carlo trials about accepted observations."""
        prepared = self._adjusted(configuration, observations).trials
        arrivals = self.arrivals(configuration)
        if arrivals is None:
            return prepared
        alone = replace(self, arrivals=lambda _configuration: None)
        every = alone.solve(configuration, plan, observations)
        return RepeatedTrials.of(prepared, every, arrivals)

    def measure(
        self, configuration: Configuration, plan: Plan, sizes: Sizes, seed: int
    ) -> DisturbedMeasurement:
        """Return readings of every step, with noise and the effects of ``sizes``.

        The table deviates at random; all else is as near to perfect as the outputs allow.
        """
        nothing = [step.observed((0.0, 0.0, 0.0)) for step in plan.steps]
        model = self.model(configuration, Readings.of(nothing))
        random = np.random.default_rng([seed, 2])
        true = TRUE_SIZE * model.unit.si * random.standard_normal(len(model.outputs))
        unknowns = model.first + np.linalg.pinv(model.outputs) @ (
            true - model.outputs @ model.first
        )
        found = spoiled(model.at(unknowns), plan, sizes, seed)
        steps = zip(plan.steps, found.tolist(), strict=False)  # what is known comes after them
        read = tuple(step.observed((value, 0.0, 0.0)) for step, value in steps)
        return DisturbedMeasurement(read, self._curves(model.outputs @ unknowns, plan))

    def method(self, *, disturbances: Sequence[Disturbance] = (), **more: Any) -> Method:
        """Return the method; ``more`` are fields of a :class:`~.method.Method`.

        Unless they say otherwise its instrument sends points of the kind READING, and reads zero
        where nothing is wrong.
        """
        usual: dict[str, Any] = {
            "topics": ("probe_point", "joint_states"),
            "capture": CaptureRules({PointKind.READING: points(mean_point)}),
            "nominal": lambda _configuration, _plan: lambda _step: (0.0, 0.0, 0.0),
            "tables": tables_of_also,
        }
        return Method(
            name=self.name,
            solve=self.solve,
            trials=self.trials,
            disturbances=Disturbances(tuple(disturbances), self.measure),
            **{**usual, **more},
        )

    def _adjusted(
        self, configuration: Configuration, observations: Sequence[Observation]
    ) -> Adjusted:
        if not observations:
            raise DataError("nothing was read: there is nothing to solve")
        return adjust(self.model(configuration, Readings.of(observations)))

    def _curves(self, outputs: Floats, plan: Plan) -> dict[str, Floats]:
        """Return the deviations (n,) by component at the distinct angles; a turn begins anew."""
        curves = outputs.reshape(len(self.components), -1)
        whole = [np.resize(curve, len(plan.distinct_angles)) for curve in curves]
        return dict(zip(self.components, whole, strict=True))
