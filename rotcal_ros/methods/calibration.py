"""A configuration with its plan, ready to take observations.

What static transforms say of the cell is held against what the lengths say.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import dist
from typing import TYPE_CHECKING, Final

import numpy as np
from threadpoolctl import threadpool_limits

from rotcal_ros.bags.names import JOINT_STATES, PROBE_POINT, TRACER_LENGTH
from rotcal_ros.capture import Capture
from rotcal_ros.capture.decisions import decide_length
from rotcal_ros.foundation.circumstances import Circumstances, Range, StepCounts
from rotcal_ros.foundation.errors import ConfigurationError, ObservabilityError, PlanError
from rotcal_ros.foundation.in_force import UNKNOWN, agreed_state
from rotcal_ros.foundation.language import join_texts, phrase
from rotcal_ros.foundation.observations import ATTEMPTS_PER_RUN, Observation
from rotcal_ros.foundation.protection import Protection
from rotcal_ros.foundation.raw_data import RawData
from rotcal_ros.foundation.results import FreeDirection, Result, Zeros
from rotcal_ros.geometry.frames import StaticFrame
from rotcal_ros.geometry.rotations import rotate_about_table_axis
from rotcal_ros.methods.added_errors import arrival_std, require_settled, with_clock_errors
from rotcal_ros.methods.air import Refraction
from rotcal_ros.methods.air_settings import AirSettings
from rotcal_ros.methods.configuration import Configuration, read_policy
from rotcal_ros.methods.continuation import Continuation, continued
from rotcal_ros.methods.method import Adaptive, Method, Stations, Trials
from rotcal_ros.planning.choices import AS_LISTED, UNTIL_GOAL, ListedPolicy, StepPolicy
from rotcal_ros.planning.plan import Plan, Point, Step

if TYPE_CHECKING:
    from rotcal_ros.adjust.model import CurveModel
    from rotcal_ros.methods.disturbance import DisturbedMeasurement, Sizes


from collections.abc import Iterator

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.escapes import printable
from rotcal_ros.foundation.language import Phrase
from rotcal_ros.foundation.results import Placement
from rotcal_ros.foundation.units import DEGREE, MILLIMETRE
from rotcal_ros.geometry.frames import FrameTree
from rotcal_ros.geometry.rotations import rotation_from_vector
from rotcal_ros.planning.settings import CellSettings


def frame_conflicts(
    cell: CellSettings, plan: Plan, result: Result, frames: Iterable[StaticFrame]
) -> tuple[Phrase, ...]:
    """Return in words where static ``frames`` contradict a result by more than is allowed.

    Empty where they agree, where none joins the frames of the cell, or the method finds no axis.
    """
    tree, placed = FrameTree(frames), result.placement
    if placed is None:
        return ()
    return (*_of_the_table(cell, tree, placed), *_of_the_tracer(cell, plan, tree, placed))


def _of_the_table(cell: CellSettings, tree: FrameTree, axis: Placement) -> Iterator[Phrase]:
    """Yield where the table's frame is not on the axis, or its z not along it."""
    pose = tree.pose(cell.table_frame, cell.machine_frame)
    if pose is None:
        return
    names = phrase("tf has {0} in {1}", printable(cell.table_frame), printable(cell.machine_frame))
    off = axis.distance(pose.origin)
    if off > cell.frame_tolerance_m:
        yield phrase(
            "{0} at {1}, {2:.1f} mm from the axis of the solution, which goes through {3}; "
            "allowed {4:g} mm", names, _place(pose.origin),
            off / MILLIMETRE, _place(axis.point), cell.frame_tolerance_m / MILLIMETRE
        )  # fmt: skip
    z = pose.axes[:, 2]
    tilt = float(np.arctan2(np.linalg.norm(np.cross(z, axis.direction)), z @ axis.direction))
    if tilt > cell.frame_tolerance_deg * DEGREE:
        yield phrase(
            "{0} with z along {1}, {2:.2f} degrees from the axis of the solution, {3}; allowed "
            "{4:g}",
            names, _direction(z), tilt / DEGREE, _direction(axis.direction),
            cell.frame_tolerance_deg,
        )  # fmt: skip


def _of_the_tracer(
    cell: CellSettings, plan: Plan, tree: FrameTree, placed: Placement
) -> Iterator[Phrase]:
    """Yield where the tracer's frame, carried by the table, is not at the solved stations."""
    pose = tree.pose(cell.tracer_frame, cell.machine_frame)
    if pose is None or not len(placed.positions):
        return
    angles = [plan.table_angles[number] for number in placed.positions.tolist()]
    turns = [rotation_from_vector(angle * placed.direction) for angle in angles]
    by_tf = np.array(turns) @ (pose.origin - placed.point) + placed.point
    off = np.linalg.norm(placed.stations - by_tf, axis=1)
    worst = int(np.argmax(off))
    if off[worst] > cell.frame_tolerance_m:
        yield phrase(
            "tf has {0} in {1} at {2}; with the table at {3:g} degrees that is {4:.1f} mm "
            "from the station of the solution, {5}; allowed {6:g} mm",
            printable(cell.tracer_frame), printable(cell.machine_frame), _place(pose.origin),
            angles[worst] / DEGREE, off[worst] / MILLIMETRE, _place(placed.stations[worst]),
            cell.frame_tolerance_m / MILLIMETRE,
        )  # fmt: skip


def _place(point: Floats) -> str:
    return f"({', '.join(f'{x:.4f}' for x in point)}) m"


def _direction(vector: Floats) -> str:
    return f"({', '.join(f'{x:.4f}' for x in vector)})"


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

    def __repr__(self) -> str:
        return f"<Calibration: {self.configuration!r}, {len(self.plan.steps)} steps>"

    @property
    def method(self) -> Method:
        """What the method of the configuration provides."""
        return self.configuration.method

    @cached_property
    def topics(self) -> tuple[str, ...]:
        """The instrument topics that must have delivered before the first motion."""
        decide = self.method.capture.decide
        of_lengths = any(decide[step.kind] is decide_length for step in self.plan.steps)
        return (TRACER_LENGTH,) * of_lengths + (PROBE_POINT, JOINT_STATES)

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
            self.plan, settings, self.method.capture, run, required,
            single_shot=single_shot, first_attempt=run * ATTEMPTS_PER_RUN,
        )  # fmt: skip

    def solve(
        self,
        observations: Iterable[Observation],
        announced: Iterable[str] = (),
        frames: Iterable[StaticFrame] = (),
    ) -> Result:
        """Solve with the observations that count; see :func:`final_observations`.

        ``announced`` are the tables in force that the cell announced meanwhile, ``frames`` the
        static transforms that it has: where they contradict the result, that has a warning.
        Raises ObservabilityError, with what was rejected, where the rest tells too little.
        """
        seen = tuple(observations)
        used = self._that_count(seen)
        try:
            with threadpool_limits(1, "blas"):  # else the last bits depend on the number of cores
                result = self.refraction.solve(
                    used, partial(self.method.solve, self.configuration, self.plan)
                )
        except ObservabilityError as error:
            raise ObservabilityError(f"{error}{self._lacking(seen, used)}") from error
        result = with_clock_errors(result, self.arrival_std())
        measured_on = agreed_state(self.in_force(announced))
        if measured_on != UNKNOWN:
            result = replace(result, measured_on=measured_on)
        conflicts = frame_conflicts(self.configuration.cell, self.plan, result, frames)
        warnings = (*result.warnings, *conflicts)
        if not self.method.set_by_hand and all(o.captured for o in used):
            # it cannot be numbered off, as a table that is written down can
            stood = phrase(
                "all was captured while the table's own feedback stood at the commanded angle"
            )
            passed = phrase(
                "all was captured while the table's own feedback passed the commanded angle"
            )
            turning = any(step.turn is not None for step in self.plan.steps)
            why = passed if turning else stood
            result = result.protected(Protection("numbering", "harmless", why))
        raw = replace(RawData.of(used, _DATED_NS), influence=result.raw_data.influence)
        return replace(
            result, warnings=warnings, circumstances=self._circumstances(used), raw_data=raw
        )

    def _lacking(self, seen: Sequence[Observation], used: Sequence[Observation]) -> str:
        """Return in words how many steps gave nothing, and the usual reason; empty if all did."""
        planned = len(self.plan.counting)
        without = planned - len({o.step for o in used})
        reasons = Counter(o.reason for o in seen if not o.accepted).most_common(1)
        usual = "".join(f", most often because {reason}" for reason, _ in reasons)
        share = f"; {without} of {planned} steps have no accepted observation"
        return f"{share}{usual}" if without else ""

    def _circumstances(self, used: Sequence[Observation]) -> Circumstances:
        steps = {o.step for o in used}
        retried = {o.step for o in used if o.attempt % ATTEMPTS_PER_RUN}
        planned = len(self.plan.counting)
        # Offline the group planner has done its work and is not read.
        chosen = read_policy(self.configuration.text) == UNTIL_GOAL
        dated = [o for o in used if o.window_start_ns > _DATED_NS]
        stated = stated_circumstances(self.configuration)
        return replace(
            stated,
            begun_ns=min((o.window_start_ns for o in dated), default=None),
            ended_ns=max((o.window_end_ns for o in dated), default=None),
            temperature_c=Range.of([o.temperature_c for o in used]) or stated.temperature_c,
            pressure_pa=Range.of([o.pressure_pa for o in used]) or stated.pressure_pa,
            humidity=Range.of([o.humidity for o in used]) or stated.humidity,
            refraction=self.refraction.describe(used),
            counts=StepCounts(
                planned, len(steps), 0 if chosen else planned - len(steps), len(retried)
            ),
        )

    @property
    def refraction(self) -> Refraction:
        """What is done about the index of refraction of the air."""
        air, source = self.configuration.air, self.configuration.source
        return Refraction(air, source, lengths=self.method.by_light)

    def arrival_std(self) -> float:
        """Return what clocks that may differ make uncertain of every arrival, rad.

        Raises ConfigurationError where lengths may be of a motion then.
        """
        bound_s, capture = self.configuration.topics.clock_bound_s, self.configuration.capture
        if TRACER_LENGTH in self.topics:
            require_settled(bound_s, capture)
        return arrival_std(bound_s, capture)

    def instrument_place(self, step: Step) -> Point | None:
        """Return where the instrument stands at a step (m, machine frame), if it stands apart."""
        places, rides = self._stations.places, self._stations.carried
        if not places:
            return None
        place = places[step.station if step.station < len(places) else 0]
        return rotate_about_table_axis(place, step.table_angle) if rides else place

    def place_on_table(self) -> Point | None:
        """Return where an instrument rides on the table, at angle 0; None: none is known to."""
        places = self._stations.places
        return places[0] if places and self._stations.carried else None

    @cached_property
    def beam_range_m(self) -> tuple[float, float]:
        """The shortest and the longest beam of the plan, m.

        Where the place of the instrument is not stated, by the distances between the targets.
        """
        stands = [(step, self.instrument_place(step)) for step in self.plan.steps]
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
            raise ConfigurationError(f"the method {self.method.name} has no Monte Carlo trials")
        used = self.refraction.corrected(self._that_count(observations))
        return self.method.trials(self.configuration, self.plan, used)

    def model_of_curves(self, observations: Iterable[Observation]) -> CurveModel | None:
        """Return the observations that count as a model, to be solved with other instruments.

        None where only the result tells all: where the method says so, and where clocks add to its
        uncertainty. What the index of the air is uncertain by is an error that lengths share.
        """
        find = self.method.model_of_curves
        if find is None or self.arrival_std():
            return None
        used = self._that_count(observations)
        return self.refraction.model_of_curves(used, partial(find, self.configuration, self.plan))

    def without_solution(self, observations: Iterable[Observation], model: CurveModel) -> Result:
        """Return a result that says nothing: of observations that need those of others.

        ``model``: what they are with them. It has the components that its curves determine.
        """
        used, count = self._that_count(observations), len(model.angles)
        names, each = [c for c in model.curves if c not in model.mixed], np.eye(count)
        return Result(
            method=self.method.name,
            angles=model.angles,
            deviations={c: np.zeros(count) for c in names},
            std={c: np.ones(count) for c in names},
            covariance=dict.fromkeys(names, each),
            sigma0=1.0,
            dof=0,
            n_observations=len(used),
            verdict="suspect",
            zeros=Zeros(
                free=tuple(FreeDirection(join_texts(()), dict.fromkeys(names, k)) for k in each)
            ),
            circumstances=self._circumstances(used),
            raw_data=RawData.of(used, _DATED_NS),
        )

    def policy(self, continuation: Continuation) -> StepPolicy:
        """Return the policy of the configuration, ready to choose what ``continuation`` leaves.

        Raises ConfigurationError or PlanError when it cannot be followed.
        """
        if self.configuration.planner.policy == AS_LISTED:
            return ListedPolicy(continuation.steps)
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

    def first_run(self, start_index: int = 0) -> Continuation:
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

    def describe_remaining(self, left: Continuation) -> str:
        """Say how far the plan is; with a goal only the policy knows how many steps it takes."""
        total, done, again = len(self.plan.steps), len(left.done), len(left.again)
        ahead = f"{len(left.steps) - again} of {total} steps are left"
        more = f"; {again} done steps are measured again" * bool(again)
        if self.configuration.planner.policy != AS_LISTED:
            ahead = f"{done} steps are done, and the policy goes on choosing among {total} offered"
            more = f"{more} if any is chosen" * bool(more)
        return f"run {left.run}: {ahead}{more}"

    def check(self, observations: Iterable[Observation]) -> tuple[str, ...]:
        """Return in words what a person has to correct, as far as the method can say."""
        if self.method.check is None:
            return ()
        used = self.refraction.corrected(final_observations(observations))
        return self.method.check(self.configuration, self.plan, used)

    def nominal_observations(self) -> tuple[Observation, ...]:
        """Return one exact observation for every step of the plan, the table being perfect."""
        if self.method.nominal is None:
            raise ConfigurationError(
                f"{self.configuration.source}: the method {self.method.name} does not predict "
                "what is seen without error: give a recorded bag instead of the configuration"
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
        accepted = last_accepted(o for o in observations if o.step in self.plan.counting)
        if self.method.joins_runs:
            return tuple(accepted.values())
        return final_observations(accepted.values())


def stated_circumstances(configuration: Configuration) -> Circumstances:
    """Return what a configuration alone states of the circumstances."""
    air = configuration.air
    return Circumstances(
        simulated=configuration.simulated,
        axis=configuration.cell.axis,
        identity=configuration.identity,
        temperature_c=Range.of([air.temperature_c]),
        pressure_pa=Range.of([air.pressure_pa]),
        humidity=Range.of([air.humidity]),
    )


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
    calibration.policy(calibration.first_run())
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
