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
from rotcal_ros.adjust.engine import Trials as DrawnTrials
from rotcal_ros.adjust.fit import require_determined
from rotcal_ros.adjust.model import CurveModel, Model, block_rows
from rotcal_ros.capture.attempt import CaptureRules
from rotcal_ros.capture.decisions import decide_by_points, mean_point
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR, SHOWN_IN
from rotcal_ros.foundation.errors import DataError, ObservabilityError, PlanError
from rotcal_ros.foundation.language import Phrase
from rotcal_ros.foundation.observations import Observation, PointKind
from rotcal_ros.foundation.protection import EFFECTS, Effect, Protection
from rotcal_ros.foundation.results import AxisLine, Result
from rotcal_ros.methods.arrivals import Arrivals, RepeatedTrials, mean_of_arrivals, mean_of_runs
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.disturbance import (
    Disturbance,
    Disturbances,
    DisturbedMeasurement,
    Sizes,
    simulate_disturbed,
    table_deviations,
)
from rotcal_ros.methods.method import Method, See, Trials
from rotcal_ros.methods.result_tables import ResultTable
from rotcal_ros.planning.plan import Plan
from rotcal_ros.planning.readings import Readings

TRUE_SIZE: Final = 2.0
"""Standard deviation of the deviations that a measurement on purpose has, in units of people."""


def tables_of_also(result: Result) -> list[ResultTable]:
    """Return what the model determines beside the deviations, a table for each name."""
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
    """What a method says itself of a result; its word on an effect takes that of the engine.

    ``axes``: where rotary axes stand, of a method that measures this.
    """

    doubts: Sequence[Phrase] = ()
    protections: Sequence[Protection] = ()
    details: Mapping[str, Any] = field(default_factory=dict)
    axes: tuple[AxisLine, ...] = ()


@dataclass(frozen=True)
class RestatedConfiguration:
    """A configuration whose statements fit what was found, and why others did not."""

    configuration: Configuration
    doubts: tuple[Phrase, ...] = ()


@dataclass(frozen=True)
class ByModel:
    """A method with the ``name``, by its ``model`` of readings.

    The first observations of a model are the readings, in their order, of as many ``coordinates``
    each. Its outputs are the deviations at the first table positions of the plan, one of the
    ``components`` after the other; ``further`` outputs below them count in every test. Rows of
    ``untold`` deviations are of those that the model has, and other instruments may determine.
    ``states`` says what the engine cannot know, last of a configuration before it was
    ``restated``; all that every method lists has to be said.
    ``counts_from``: what they count from, see :class:`~rotcal_ros.foundation.results.Zeros`.
    ``arrivals`` returns those of a plan that comes to its angles more than once: their mean is
    the result, and the curves from each side. ``nominal``: what is read at a step where nothing is
    wrong. ``wrong``: blocks of what may be wrong beside the table, with the effect that it is.
    ``sign``: -1.0 where the model takes a reading with the other sign. ``drawn``: unknowns (p,)
    of what is measured beside the table, where that is not perfect. ``restated`` returns a
    configuration whose statements fit what was found, and what is doubtful of them; None where
    they fit as they are.
    """

    name: str
    model: Callable[[Configuration, Readings], Model]
    states: Callable[[Configuration, Readings, Adjusted, Configuration], Statement]
    components: Callable[[Configuration], tuple[str, ...]] = lambda _configuration: ("ECC",)
    arrivals: Callable[[Configuration], Arrivals | None] = lambda _configuration: None
    nominal: Callable[[Configuration, Plan], See] = lambda _configuration, _plan: (
        lambda _step: (0.0, 0.0, 0.0)
    )
    coordinates: Callable[[Configuration], int] = lambda _configuration: 1
    further: Callable[[Configuration], int] = lambda _configuration: 0
    untold: Callable[[Configuration], Mapping[str, Floats]] = lambda _configuration: {}
    counts_from: str = "first angle"
    wrong: Mapping[str, Effect] = field(default_factory=dict)
    sign: Callable[[Configuration], float] = lambda _configuration: 1.0
    drawn: Callable[[Configuration, Model, np.random.Generator], Floats] = (
        lambda _configuration, model, _random: np.zeros(model.size[1])
    )
    restated: Callable[[Configuration, Readings, Adjusted], RestatedConfiguration | None] = (
        lambda _configuration, _read, _found: None
    )

    def solve(
        self, configuration: Configuration, plan: Plan, observations: Sequence[Observation]
    ) -> Result:
        """Return the result of accepted observations."""
        found, restated = self._adjusted(configuration, observations)
        stated, read = configuration, Readings.of(observations)
        configuration = restated.configuration
        statement = self.states(configuration, read, found, stated)
        parts, count = self._parts(configuration, found.model)
        arrivals = self.arrivals(configuration)
        result = found.result(
            self.name,
            np.array(plan.table_angles[:count]),
            parts,
            (read.position % count, read.target),
            counts_from=self.counts_from,
            coordinates=self.coordinates(configuration),
            doubts=(*restated.doubts, *statement.doubts),
            protections=statement.protections,
            details=statement.details,
            joint=arrivals is not None,
        )
        result = replace(result, axes=statement.axes)
        if silent := set(EFFECTS) - {p.effect for p in result.protections}:
            raise DataError(
                f"the method {self.name} says nothing of {', '.join(sorted(silent))}: declare an "
                "effect of the model, or state a protection"
            )
        return result if arrivals is None else mean_of_runs(result, arrivals)

    def model_of_curves(
        self, configuration: Configuration, plan: Plan, observations: Sequence[Observation]
    ) -> CurveModel:
        """Return what accepted observations determine of the curves, to be solved with others.

        Where the table comes to its angles from both sides, of the mean.
        """
        model = self.model(configuration, Readings.of(observations))
        parts, count = self._parts(configuration, model)
        curves = {name: model.outputs[part] for name, part in parts.items()}
        arrivals, width = self.arrivals(configuration), model.size[1]
        untold = {  # of the unknowns before those of what scatters
            c: np.pad(rows, ((0, 0), (0, width - rows.shape[1])))
            for c, rows in self.untold(configuration).items()
        }
        found = CurveModel(
            model, np.array(plan.table_angles[:count]), {**curves, **untold}, tuple(untold)
        )
        return found if arrivals is None else mean_of_arrivals(found, arrivals)

    def check_plan(self, configuration: Configuration, plan: Plan) -> None:
        """Raise PlanError, with the unknowns, for a plan whose readings could not be solved."""
        read = Readings.of(self._nothing_wrong(configuration, plan))
        try:
            require_determined(self.model(configuration, read))
        except ObservabilityError as error:
            raise PlanError(f"with {len(plan.table_angles)} table angles {error}") from error

    def _nothing_wrong(self, configuration: Configuration, plan: Plan) -> list[Observation]:
        """Return what is read at every step of a plan where nothing is wrong."""
        see = self.nominal(configuration, plan)
        return [step.observed(see(step)) for step in plan.steps]

    def _parts(self, configuration: Configuration, model: Model) -> tuple[dict[str, slice], int]:
        """Return which outputs are the deviations of which component, and how many each has."""
        components = self.components(configuration)
        count = (len(model.outputs) - self.further(configuration)) // len(components)
        return {c: slice(k * count, (k + 1) * count) for k, c in enumerate(components)}, count

    def trials(
        self, configuration: Configuration, plan: Plan, observations: Sequence[Observation]
    ) -> Trials:
        """Prepare Monte Carlo trials about accepted observations."""
        prepared = self._adjusted(configuration, observations)[0].trials
        if further := self.further(configuration):
            prepared = DrawnTrials(prepared.value[:-further], prepared.causes[:-further])
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

        The table deviates at random; all else that is not ``drawn`` is as near to perfect as the
        outputs allow.
        """
        count, sign = self.coordinates(configuration), self.sign(configuration)
        nothing = self._nothing_wrong(configuration, plan)
        model = self.model(configuration, Readings.of(nothing))
        random = np.random.default_rng([seed, 2])
        true = TRUE_SIZE * model.unit.si * random.standard_normal(len(model.outputs))
        unknowns = model.first + np.linalg.pinv(model.outputs) @ (
            true - model.outputs @ model.first
        )
        unknowns = unknowns + self._wandering(model, sizes, random)
        unknowns = unknowns + self.drawn(configuration, model, random)
        found = simulate_disturbed(model.at(unknowns), plan, sizes, seed, count)
        values = np.array([o.mean for o in nothing])
        first = slice(len(values) * count)  # what is known comes after them
        # of displacements a model has the places, which they are from where a nest was sent
        sent = model.observed[first].reshape(-1, count) - sign * values[:, :count]
        values[:, :count] = sign * (found[first].reshape(-1, count) - sent)
        seen = zip(plan.steps, map(tuple, values.tolist()), strict=True)
        read = tuple(step.observed(point) for step, point in seen)
        further = self.further(configuration)
        components = self.components(configuration)
        curves = (model.outputs @ unknowns)[: len(model.outputs) - further]
        each, angles = curves.reshape(len(components), -1), len(plan.distinct_angles)
        # a turn that closes begins anew
        whole = {name: np.resize(c, angles) for name, c in zip(components, each, strict=True)}
        return DisturbedMeasurement(read, whole)

    def method(self, *, disturbances: Sequence[Disturbance] = (), **more: Any) -> Method:
        """Return the method; ``more`` are fields of a :class:`~.method.Method`.

        Unless they say otherwise its instrument sends points of the kind READING, and reads zero
        where nothing is wrong; a plan that the model could not be solved from is refused.
        """
        usual: dict[str, Any] = {
            "capture": CaptureRules({PointKind.READING: decide_by_points(mean_point)}),
            "nominal": self.nominal,
            "check_plan": self.check_plan,
            "tables": tables_of_also,
        }
        return Method(
            name=self.name,
            solve=self.solve,
            model_of_curves=self.model_of_curves,
            trials=self.trials,
            disturbances=Disturbances(tuple(disturbances), self.measure),
            **{**usual, **more},
        )

    def _adjusted(
        self, configuration: Configuration, observations: Sequence[Observation]
    ) -> tuple[Adjusted, RestatedConfiguration]:
        if not observations:
            raise DataError("nothing was read: there is nothing to solve")
        read = Readings.of(observations)
        found = adjust(self.model(configuration, read))
        restated = self.restated(configuration, read, found)
        if restated is None:
            return found, RestatedConfiguration(configuration)
        return adjust(self.model(restated.configuration, read)), restated

    def _wandering(self, model: Model, sizes: Sizes, random: np.random.Generator) -> Floats:
        """Return the unknowns (p,) of a table that wanders by ``sizes``, and of what is wrong.

        Only of a model with blocks of that name: what another cannot determine is harmless to it.
        """
        moved, largest = np.zeros(model.size[1]), max(model.blocks.values())
        every = table_deviations(largest, sizes, random)
        for name, effect in self.wrong.items():
            every[name] = sizes.get(effect, 0.0) * random.standard_normal(largest)
        for name in every.keys() & model.blocks.keys():
            moved += block_rows(model.blocks, name).T @ every[name][: model.blocks[name]]
        return moved
