"""A configuration with its plan, ready to take observations.

Lengths that count vacuum wavelengths, corrected for the index of refraction of the air.

A tracer that corrects nothing reads n D - P, with the index n at that time, the distance D and a
constant P, about the optical path where it reads zero. What is recorded stays as it was read: the
correction is part of solving.

What clocks that may still differ make uncertain: a table at rest creeps from one to the other.

A length and the angle that it belongs to are of the same moment only as far as the clocks of
table, probe and instrument agree.

What static transforms say of the cell, held against what the lengths say: where they differ.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import dist
from typing import Any, Final

import numpy as np
from threadpoolctl import threadpool_limits

from rotcal_ros.arrays import Floats
from rotcal_ros.bags.names import TRACER_LENGTH
from rotcal_ros.capture import Capture
from rotcal_ros.capture.settings import CaptureSettings
from rotcal_ros.catalogue.air_settings import AirSettings
from rotcal_ros.catalogue.configuration import Configuration, read_policy
from rotcal_ros.catalogue.continuation import ATTEMPTS_PER_RUN, Continuation, continued
from rotcal_ros.catalogue.disturbance import DisturbedMeasurement, Sizes
from rotcal_ros.catalogue.method import Adaptive, Method, Trials
from rotcal_ros.catalogue.stations import Stations
from rotcal_ros.circumstances import Circumstances, Counts, Range
from rotcal_ros.errors import ConfigurationError, DataError, PlanError
from rotcal_ros.escapes import printable
from rotcal_ros.geometry.frames import FrameTree, StaticFrame
from rotcal_ros.geometry.rotations import carried, rotation_from_vector
from rotcal_ros.in_force import UNKNOWN, agreed
from rotcal_ros.observations import Observation, PointKind
from rotcal_ros.planning.cell_settings import CellSettings
from rotcal_ros.planning.plan import Plan, Point, Step
from rotcal_ros.planning.policy.as_listed import AsListed
from rotcal_ros.planning.policy.choices import Policy
from rotcal_ros.planning.policy.names import AS_LISTED, UNTIL_GOAL
from rotcal_ros.protection import Protection
from rotcal_ros.raw_data import RawData
from rotcal_ros.refraction import EQUATIONS, Air, Equation, Sensors, index_std
from rotcal_ros.results import Directions, Result
from rotcal_ros.units import DEGREE, MILLIMETRE

_DATED_NS: Final = 10**17
"""A stamp before 1973 counts from the start of something: it is no date."""
RunStep = tuple[int, int]
"""Number of the run, step."""


@dataclass(frozen=True)
class Calibration:
    """One configured calibration: what to measure, how to capture it, how to solve it.

    The live nodes and the offline replay use it alike: equal observations give results that are
    equal to the last bit.
    """

    configuration: Configuration
    plan: Plan

    @property
    def method(self) -> Method:
        """What the method of the configuration brings."""
        return self.configuration.method

    @property
    def of_distances(self) -> Calibration:
        """The same for lengths that are distances already, as predicted ones are.

        What :meth:`nominal_observations` and :meth:`measured` return is solved with it.
        """
        return replace(self, configuration=replace(self.configuration, air=AirSettings()))

    def capture(self, run: int = 0) -> Capture:
        """Return a new capture for one run of the plan."""
        settings = self.configuration.capture
        required = self.refraction.required(settings)
        single_shot = self.configuration.topics.length_single_shot
        return Capture(
            self.plan, settings, self.method.capture, run, required, single_shot=single_shot
        )

    def solve(
        self,
        observations: Iterable[Observation],
        announced: Iterable[str] = (),
        frames: Iterable[StaticFrame] = (),
    ) -> Result:
        """Solve with the observations that count; see :func:`final_observations`.

        ``announced`` are the tables in force that the cell announced meanwhile, ``frames`` the
        static transforms that it has: where they contradict the result, that has a warning.
        """
        used = self._that_count(observations)
        with threadpool_limits(1, "blas"):  # else the last bits depend on the number of cores
            result = self.refraction.solve(
                used, partial(self.method.solve, self.configuration, self.plan)
            )
        result = with_clock_errors(result, self.arrival_std())
        measured_on = agreed(self.in_force(announced))
        if measured_on != UNKNOWN:
            result = replace(result, measured_on=measured_on)
        conflicts = frame_conflicts(self.configuration.cell, self.plan, result, frames)
        warnings = (*result.warnings, *conflicts)
        result = _numbered_by_feedback(result, used)
        raw = replace(RawData.of(used, _DATED_NS), influence=result.raw_data.influence)
        return replace(
            result, warnings=warnings, circumstances=self._circumstances(used), raw_data=raw
        )

    def _circumstances(self, used: Sequence[Observation]) -> Circumstances:
        """Return under which circumstances the observations ``used`` were made."""
        steps = {o.step for o in used}
        retried = {o.step for o in used if o.attempt % ATTEMPTS_PER_RUN}
        planned = len(self.plan.steps)
        # Offline the group planner has done its work and is not read.
        chosen = read_policy(self.configuration.text) == UNTIL_GOAL
        dated = [o for o in used if o.window_start_ns > _DATED_NS]
        return Circumstances(
            simulated=self.configuration.simulated,
            axis=self.configuration.cell.axis,
            identity=self.configuration.identity,
            begun_ns=min((o.window_start_ns for o in dated), default=None),
            ended_ns=max((o.window_end_ns for o in dated), default=None),
            temperature_c=Range.of([o.temperature_c for o in used]),
            pressure_pa=Range.of([o.pressure_pa for o in used]),
            humidity=Range.of([o.humidity for o in used]),
            refraction=self.refraction.in_words(used),
            counts=Counts(
                planned, len(steps), 0 if chosen else planned - len(steps), len(retried)
            ),
        )

    @property
    def refraction(self) -> Refraction:
        """What is done about the index of refraction of the air."""
        lengths = TRACER_LENGTH in self.method.topics
        return Refraction(self.configuration.air, self.configuration.source, lengths=lengths)

    def arrival_std(self) -> float:
        """Return what clocks that may differ make uncertain of every arrival, rad.

        Raises ConfigurationError where lengths may be of a motion then.
        """
        bound_s, capture = self.configuration.topics.clock_bound_s, self.configuration.capture
        if TRACER_LENGTH in self.method.topics:
            require_settled(bound_s, capture)
        return arrival_std(bound_s, capture)

    def stand_at(self, step: Step) -> Point | None:
        """Return where the instrument stands at a step (m, machine frame), if it stands apart."""
        places, rides = self._stations.places, self._stations.carried
        if not places:
            return None
        place = places[step.station if step.station < len(places) else 0]
        return carried(place, step.table_angle) if rides else place

    def place_on_table(self) -> Point | None:
        """Return where an instrument rides on the table, at angle 0; None: none is known to."""
        places = self._stations.places
        return places[0] if places and self._stations.carried else None

    @cached_property
    def beams_m(self) -> tuple[float, float]:
        """The shortest and the longest beam of the plan, m.

        Where nobody says where the instrument stands, by the distances between the targets.
        """
        stands = [(step, self.stand_at(step)) for step in self.plan.steps]
        beams = [dist(step.position, at) for step, at in stands if at is not None]
        if beams:
            return min(beams), max(beams)
        places = [step.position for step in self.plan.steps]
        size = dist(*(tuple(map(of, zip(*places, strict=True))) for of in (min, max)))
        return 0.3 * size, 3.0 * size

    @cached_property
    def _stations(self) -> Stations:
        find = self.method.stations
        return Stations() if find is None else find(self.configuration)

    def in_force(self, announced: Iterable[str]) -> tuple[str, ...]:
        """Return what configuration and cell say about the table in force.

        A configuration that says "unknown" says nothing.
        """
        stated = self.configuration.cell.table_in_force
        return (*(() if stated == UNKNOWN else (stated,)), *announced)

    def trials(self, observations: Iterable[Observation]) -> Trials:
        """Prepare Monte Carlo trials about the observations that count."""
        if self.method.trials is None:
            raise ConfigurationError(f"the method {self.method.name} brings no Monte Carlo trials")
        used = self.refraction.corrected(self._that_count(observations))
        return self.method.trials(self.configuration, self.plan, used)

    def policy(self, continuation: Continuation) -> Policy:
        """Return the policy of the configuration, ready to choose what ``continuation`` leaves.

        Raises ConfigurationError or PlanError when it cannot be followed.
        """
        if self.configuration.planner.policy == AS_LISTED:
            return AsListed(continuation.steps)
        if self.method.adaptive is None:
            raise ConfigurationError(
                f"{self.configuration.source}: planner: policy: the method {self.method.name} has "
                f"no policy {self.configuration.planner.policy}; leave it out"
            )
        if self.refraction.equation is not None:
            raise ConfigurationError(
                f"{self.configuration.source}: planner: the policy "
                f"{self.configuration.planner.policy} compares lengths as they are captured: let "
                "the instrument correct them (air.refraction: instrument), or leave the policy out"
            )
        return self._adaptive(continuation)

    @cached_property
    def _adaptive(self) -> Adaptive:
        assert self.method.adaptive is not None
        return self.method.adaptive(self.configuration, self.plan)

    def from_the_start(self, start_index: int = 0) -> Continuation:
        """Return the first run of the plan, from step ``start_index`` on."""
        steps = tuple(range(start_index, len(self.plan.steps)))
        return Continuation(self.configuration.plan_id, 0, start_index, (), steps, ())

    def continued(
        self, run: int, observations: Sequence[Observation], from_step: int = 0
    ) -> Continuation:
        """Return how run number ``run`` goes on after what the earlier ones observed."""
        settings = self.configuration.planner
        return continued(
            self.plan,
            self.configuration.plan_id,
            run,
            observations,
            max_attempts=settings.max_attempts,
            max_failed_steps=settings.max_failed_steps,
            join_steps=settings.join_steps if self.method.joins_runs else 0,
            from_step=from_step,
        )

    def check(self, observations: Iterable[Observation]) -> tuple[str, ...]:
        """Return in words what a person has to put right, as far as the method can tell."""
        if self.method.check is None:
            return ()
        used = self.refraction.corrected(final_observations(observations))
        return self.method.check(self.configuration, self.plan, used)

    def nominal_observations(self) -> tuple[Observation, ...]:
        """Return one exact observation for every step of the plan, the table being perfect."""
        if self.method.nominal is None:
            raise ConfigurationError(
                f"{self.configuration.source}: the method {self.method.name} does not tell what "
                "is seen without error: give a recorded bag instead of the configuration"
            )
        see = self.method.nominal(self.configuration, self.plan)
        return tuple(step.observed(see(step)) for step in self.plan.steps)

    def measured(self, sizes: Sizes, seed: int) -> DisturbedMeasurement:
        """Return observations of every step with the stated noise and the effects of ``sizes``."""
        if self.method.disturbances is None:
            raise ConfigurationError(
                f"the method {self.method.name} does not say how noise and disturbances look"
            )
        return self.method.disturbances.measure(self.configuration, self.plan, sizes, seed)

    def _that_count(self, observations: Iterable[Observation]) -> tuple[Observation, ...]:
        """Return the last accepted one of each step, for a method that joins runs in each run."""
        accepted = last_accepted(observations)
        if self.method.joins_runs:
            return tuple(accepted.values())
        return final_observations(accepted.values())


def prepare(configuration: Configuration) -> Calibration:
    """Return the calibration that a configuration describes; PlanError for an impossible plan."""
    return Calibration(configuration, configuration.method.plan(configuration))


def prepare_to_measure(configuration: Configuration) -> Calibration:
    """Return :func:`prepare_whole` of a configuration that will be measured.

    Raises ConfigurationError or PlanError, too, where its policy cannot reach its goal.
    """
    calibration = prepare_whole(configuration)
    calibration.refraction.require_sources(configuration.capture)
    calibration.arrival_std()  # clocks may differ by more than an uncertainty can cover
    calibration.policy(calibration.from_the_start())
    return calibration


def prepare_whole(configuration: Configuration) -> Calibration:
    """Return :func:`prepare` of a configuration whose plan is meant to be measured as a whole.

    Raises PlanError, with the place, where the data of the whole plan could not be solved. What is
    recorded already may be less than that, and is read all the same.
    """
    calibration = prepare(configuration)
    if calibration.method.check_plan is not None:
        try:
            calibration.method.check_plan(configuration, calibration.plan)
        except PlanError as error:
            raise PlanError(f"{configuration.source}: plan: {error}") from error
    return calibration


def _numbered_by_feedback(result: Result, used: Sequence[Observation]) -> Result:
    """Return the result; what was captured cannot be numbered off, as a table written down can."""
    if any(not o.window_end_ns for o in used):
        return result
    captured = Protection(
        "numbering",
        "harmless",
        "all was captured while the table's own feedback stood at the commanded angle",
    )
    protections = [captured if p.effect == captured.effect else p for p in result.protections]
    return replace(result, protections=tuple(protections))


def last_accepted(observations: Iterable[Observation]) -> dict[RunStep, Observation]:
    """Return the accepted observation of the last attempt by (run, step), in that order."""
    last: dict[RunStep, Observation] = {}
    for observation in observations:
        key = (observation.run, observation.step)
        if observation.accepted and (key not in last or observation.attempt >= last[key].attempt):
            last[key] = observation
    return {key: last[key] for key in sorted(last)}


def final_observations(observations: Iterable[Observation]) -> tuple[Observation, ...]:
    """Return the accepted observation of the last attempt at every step, in step order.

    The order in which observations arrive therefore never changes a result.
    """
    last = {step: observation for (_, step), observation in last_accepted(observations).items()}
    return tuple(last[step] for step in sorted(last))


Observations = Sequence[Observation]
BY_INSTRUMENT: Final = "corrected by the instrument, not here"
_COLUMNS: Final = {
    "temperature_c": ("temperature", "temperature"),
    "pressure_pa": ("air_pressure", "pressure"),
    "humidity": ("relative_humidity", "humidity"),
}
"""Column of an observation and setting of the air -> topic, quantity of the capture."""


@dataclass(frozen=True)
class Refraction:
    """What is done about the index of refraction; ``lengths``: whether the method has any."""

    settings: AirSettings
    source: str
    lengths: bool

    @property
    def equation(self) -> Equation | None:
        """The equation that corrects; None where nothing is corrected here."""
        return EQUATIONS.get(self.settings.refraction) if self.lengths else None

    def require_sources(self, capture: CaptureSettings) -> None:
        """Raise ConfigurationError, before anything moves, for air that nobody will tell."""
        if self.equation is None:
            return
        for column, (topic, quantity) in _COLUMNS.items():
            expected = getattr(capture, f"{quantity}_expected")
            if getattr(self.settings, column) is None and not expected:
                raise ConfigurationError(
                    f"{self.source}: air: refraction {self.settings.refraction} needs {column}: "
                    f"publish {topic} and set capture.{quantity}_expected: true, or give "
                    f"air.{column}"
                )

    def required(self, capture: CaptureSettings) -> frozenset[str]:
        """Return the quantities of the capture without which a length cannot be corrected."""
        if self.equation is None:
            return frozenset()
        return frozenset(
            quantity
            for column, (_, quantity) in _COLUMNS.items()
            if getattr(self.settings, column) is None and getattr(capture, f"{quantity}_expected")
        )

    def corrected(self, observations: Observations) -> tuple[Observation, ...]:
        """Return the observations with lengths of distance instead of optical path.

        Raises DataError where an observation does not tell the air.
        """
        return self._over(observations, 0.0)

    def solve(self, observations: Observations, solve: Callable[[Any], Result]) -> Result:
        """Solve corrected observations; what the index is uncertain by is part of the result.

        One error of the sensors and of the equation is common to all lengths: the solution with
        every index larger by its standard uncertainty tells what that does to each deviation.
        """
        if self.equation is None:
            return solve(tuple(observations))
        result = solve(self.corrected(observations))
        return with_common(result, solve(self._over(observations, 1.0)))

    def in_words(self, observations: Observations) -> str:
        """Say who corrects, by what, and how uncertain it is; empty without lengths."""
        if not self.lengths:
            return ""
        equation, settings = self.equation, self.settings
        if equation is None:
            return BY_INSTRUMENT
        air = self._air(observations)
        index = equation.index(air, settings.vacuum_wavelength_nm, settings.co2_ppm)
        std = float(np.max(self._std(air, equation)))
        return (
            f"{equation.name} with {settings.vacuum_wavelength_nm:g} nm in vacuum, CO2 "
            f"{settings.co2_ppm:g} umol/mol, dead path {settings.dead_path_m:g} m: index "
            f"{index.min():.8f} to {index.max():.8f}, standard uncertainty {std:.1e} from "
            f"{settings.temperature_std_k:g} K, {settings.pressure_std_pa:g} Pa, "
            f"{settings.humidity_std:g} of humidity and {equation.std:.0e} of the equation, "
            "common to all lengths and part of the uncertainties"
        )

    def _over(self, observations: Observations, errors: float) -> tuple[Observation, ...]:
        """Return the observations corrected with every index ``errors`` of its std larger."""
        equation, settings = self.equation, self.settings
        if equation is None or not observations:
            return tuple(observations)
        air = self._air(observations)
        index = equation.index(air, settings.vacuum_wavelength_nm, settings.co2_ppm)
        index = index + errors * self._std(air, equation)
        return tuple(
            _divided(o, n, settings.dead_path_m)
            for o, n in zip(observations, index.tolist(), strict=True)
        )

    def _std(self, air: Air, equation: Equation) -> Floats:
        settings = self.settings
        sensors = Sensors(
            settings.temperature_std_k, settings.pressure_std_pa, settings.humidity_std
        )
        wavelength, co2 = settings.vacuum_wavelength_nm, settings.co2_ppm
        return index_std(equation, air, sensors, wavelength, co2)

    def _air(self, observations: Observations) -> Air:
        return Air(**{column: self._column(observations, column) for column in _COLUMNS})

    def _column(self, observations: Observations, column: str) -> Floats:
        """Return what was captured, else what is given; DataError where it is neither."""
        given, (topic, quantity) = getattr(self.settings, column), _COLUMNS[column]
        values = [getattr(o, column) for o in observations]
        known = [given if value is None else value for value in values]
        if None in known:
            step = observations[known.index(None)].step
            raise DataError(
                f"step {step}: its length cannot be corrected by {self.settings.refraction}, the "
                f"{column} of the air is not known: capture {topic} "
                f"(capture.{quantity}_expected: true) or give air.{column}"
            )
        return np.array(known, dtype=np.float64)


def _divided(observation: Observation, index: float, dead_path_m: float) -> Observation:
    """Return the observation with its length in metres of distance, not of optical path.

    (n D - P + d) / n - d is D less a constant, but for P - d times the changes of the index.
    """
    if observation.kind != PointKind.REFLECTOR:
        return observation
    mean = tuple((length + dead_path_m) / index - dead_path_m for length in observation.mean)
    return replace(observation, mean=mean)


def with_common(result: Result, moved: Result) -> Result:
    """Return a result whose uncertainties hold an error that is common to all that was measured.

    ``moved`` is the result with this error at its standard uncertainty: the differences of the
    deviations are fully correlated.
    """
    if moved.components != result.components or len(moved.angles) != len(result.angles):
        raise DataError(
            "the index of refraction cannot be judged: other angles or deviations are solved with "
            "every index larger by its standard uncertainty"
        )
    shift = {n: moved.deviations[n] - values for n, values in result.deviations.items()}
    return replace(
        result,
        std={n: np.hypot(values, shift[n]) for n, values in result.std.items()},
        covariance={n: c + np.outer(shift[n], shift[n]) for n, c in result.covariance.items()},
        adjacent_std=_adjacent_std(result, moved),
        directions={n: _both(d, moved.directions[n]) for n, d in result.directions.items()},
    )


def _adjacent_std(result: Result, moved: Result) -> Floats | None:
    before, after = result.adjacent_deviations, moved.adjacent_deviations
    if result.adjacent_std is None or before is None or after is None:
        return result.adjacent_std
    return np.asarray(np.hypot(result.adjacent_std, after - before), dtype=np.float64)


def _both(sides: Directions, moved: Directions) -> Directions:
    shift = np.append(moved.forward - sides.forward, moved.reverse - sides.reverse)
    return replace(sides, covariance=sides.covariance + np.outer(shift, shift))


SOURCE: Final = "clocks"
"""Its name in the budget of a method that has one."""
COMPONENT: Final = "ECC"
"""The deviation that a turn of the table about its axis goes into."""


def require_settled(bound_s: float, settings: CaptureSettings) -> None:
    """Raise ConfigurationError where clocks may differ by more than a table settles."""
    if bound_s > settings.settle_time_s:
        raise ConfigurationError(
            f"topics.clock_bound_s = {bound_s:g} is longer than capture.settle_time_s = "
            f"{settings.settle_time_s:g}: a length may then be of the motion before, which no "
            "uncertainty covers; let the table settle longer, or the clocks agree better"
        )


def arrival_std(bound_s: float, settings: CaptureSettings) -> float:
    """Return the standard uncertainty, rad, of one arrival by clocks that differ within a bound.

    The error is the product of the clocks' difference and the table's creep, both within bounds
    and without a favourite (rectangular: JCGM 100, 4.3.7); the creep is another at every arrival.
    """
    return bound_s * settings.velocity_tolerance_deg_s * DEGREE / 3.0


def with_clock_errors(result: Result, std: float) -> Result:
    """Return a result whose ECC has an error of ``std`` (rad) besides, at every arrival.

    An ECC that counts from the first angle has the error of that one too; where it is the mean
    from both sides, either side has its own. One creep is taken for all that was measured at an
    angle from a side: no other deviation feels it then.
    """
    if not std or COMPONENT not in result.deviations:
        return result
    mean, sides = _errors(result)
    share = std**2 * (mean @ mean.T)
    covariance = result.covariance[COMPONENT] + share
    adjacent = result.adjacent_std
    if adjacent is not None:
        steps = np.diff(mean, axis=0)
        adjacent = np.sqrt(adjacent**2 + std**2 * np.sum(steps**2, axis=1))
    return replace(
        result,
        std={**result.std, COMPONENT: np.sqrt(covariance.diagonal())},
        covariance={**result.covariance, COMPONENT: covariance},
        adjacent_std=adjacent,
        directions=_with_sides(result.directions, std**2 * (sides @ sides.T)),
        details=_with_source(result.details, np.sqrt(share.diagonal())),
    )


def _errors(result: Result) -> tuple[Floats, Floats]:
    """Return by how much the errors (p,) of all arrivals go into ECC (n, p) and its sides (2k, p).

    The first n errors are those of the angles, from the only side or with increasing angle, the
    other k those with decreasing angle.
    """
    n = len(result.angles)
    both = result.directions.get(COMPONENT)
    at = np.zeros(0, int) if both is None else _places(both.angles, result.angles)
    forward, reverse = np.eye(n + len(at))[at], np.eye(n + len(at))[n:]
    mean = np.eye(n, n + len(at))
    mean[at] = 0.5 * (forward + reverse)
    counts_from_first = n > 0 and result.covariance[COMPONENT][0, 0] == 0.0
    zero = mean[:1] if counts_from_first else np.zeros((1, n + len(at)))
    return mean - zero, np.vstack([forward, reverse]) - zero


def _places(angles: Floats, among: Floats) -> Any:
    """Return which of the angles ``among`` the ``angles`` are."""
    return np.argmin(np.abs(angles[:, None] - among), axis=1)


def _with_sides(directions: Mapping[str, Directions], share: Floats) -> Mapping[str, Directions]:
    both = directions.get(COMPONENT)
    if both is None:
        return directions
    return {**directions, COMPONENT: replace(both, covariance=both.covariance + share)}


def _with_source(details: Mapping[str, Any], std: Floats) -> Mapping[str, Any]:
    budget = details.get("budget")
    return details if budget is None else {**details, "budget": {**budget, SOURCE: std}}


@dataclass(frozen=True)
class Axis:
    """The axis of the table in the machine frame: a ``point`` (3,) m on it, its ``direction``."""

    point: Floats
    direction: Floats

    def distance(self, place: Floats) -> float:
        """Return how far (m) a ``place`` is from it."""
        return float(np.linalg.norm(np.cross(place - self.point, self.direction)))

    def carried(self, place: Floats, angle: float) -> Floats:
        """Return where ``place`` gets when the table turns by ``angle`` (rad)."""
        turn: Floats = rotation_from_vector(angle * self.direction)
        return np.asarray(turn @ (place - self.point) + self.point)


def solved_axis(details: Mapping[str, Any]) -> Axis | None:
    """Return the axis that a result tells of; None for a method that finds none."""
    try:
        if "axis" in details:
            point, direction = details["axis"]["origin"], details["axis"]["direction"]
        else:
            point, direction = details["circle"]["centre"], details["plane"]["normal"]
    except (IndexError, KeyError, TypeError):
        return None
    unit = np.asarray(direction, dtype=np.float64)
    unit = unit / np.linalg.norm(unit)
    return Axis(np.asarray(point, dtype=np.float64), unit if unit[2] >= 0 else -unit)


def frame_conflicts(
    cell: CellSettings, plan: Plan, result: Result, frames: Iterable[StaticFrame]
) -> tuple[str, ...]:
    """Return in words where static ``frames`` contradict a result by more than is allowed.

    Empty where they agree, where none joins the frames of the cell, or the method finds no axis.
    """
    tree, axis = FrameTree(frames), solved_axis(result.details)
    if axis is None:
        return ()
    return (*_of_the_table(cell, tree, axis), *_of_the_tracer(cell, plan, result, tree, axis))


def _of_the_table(cell: CellSettings, tree: FrameTree, axis: Axis) -> Iterator[str]:
    """Yield where the table's frame is not on the axis, or its z not along it."""
    pose = tree.pose(cell.table_frame, cell.machine_frame)
    if pose is None:
        return
    names = f"tf has {printable(cell.table_frame)} in {printable(cell.machine_frame)}"
    off = axis.distance(pose.origin)
    if off > cell.frame_tolerance_m:
        yield (
            f"{names} at {_place(pose.origin)}, {off / MILLIMETRE:.1f} mm from the axis of the "
            f"solution, which goes through {_place(axis.point)}; allowed "
            f"{cell.frame_tolerance_m / MILLIMETRE:g} mm (cell.frame_tolerance_m)"
        )
    z = pose.axes[:, 2]
    tilt = float(np.arctan2(np.linalg.norm(np.cross(z, axis.direction)), z @ axis.direction))
    if tilt > cell.frame_tolerance_deg * DEGREE:
        yield (
            f"{names} with z along {_direction(z)}, {tilt / DEGREE:.2f} degrees from the axis of "
            f"the solution, {_direction(axis.direction)}; allowed {cell.frame_tolerance_deg:g} "
            "(cell.frame_tolerance_deg)"
        )


def _of_the_tracer(
    cell: CellSettings, plan: Plan, result: Result, tree: FrameTree, axis: Axis
) -> Iterator[str]:
    """Yield where the tracer's frame, carried by the table, is not at the solved stations."""
    pose = tree.pose(cell.tracer_frame, cell.machine_frame)
    stations, ids = result.details.get("stations"), result.details.get("station_ids")
    if pose is None or stations is None or ids is None:
        return
    solved = np.asarray(stations, dtype=np.float64)
    angles = [plan.table_angles[number] for number in np.asarray(ids).tolist()]
    by_tf = np.array([axis.carried(pose.origin, angle) for angle in angles])
    off = np.linalg.norm(solved - by_tf, axis=1)
    worst = int(np.argmax(off))
    if off[worst] > cell.frame_tolerance_m:
        yield (
            f"tf has {printable(cell.tracer_frame)} in {printable(cell.machine_frame)} at "
            f"{_place(pose.origin)}; with the table at {angles[worst] / DEGREE:g} degrees that is "
            f"{off[worst] / MILLIMETRE:.1f} mm from the station of the solution, "
            f"{_place(solved[worst])}; allowed {cell.frame_tolerance_m / MILLIMETRE:g} mm "
            "(cell.frame_tolerance_m)"
        )


def _place(point: Floats) -> str:
    return f"({', '.join(f'{x:.4f}' for x in point)}) m"


def _direction(vector: Floats) -> str:
    return f"({', '.join(f'{x:.4f}' for x in vector)})"
