"""A plan gone through without moving anything: what comes first, how long, what it gives."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np

from rotcal_ros.foundation.components import COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.protection import Effect
from rotcal_ros.foundation.units import DEGREE, MILLIMETRE
from rotcal_ros.methods.calibration import Calibration, prepare
from rotcal_ros.methods.check_lines import CheckLine, State
from rotcal_ros.planning.approach import path_to
from rotcal_ros.planning.choices import AS_LISTED
from rotcal_ros.planning.plan import Step
from rotcal_ros.planning.sequence_time import constant_time_model

PART = "plan"
QUICK = 1000
"""Steps up to which a plan is solved to say what it would give."""
_SIDES = {Approach.POSITIVE: " from below", Approach.NEGATIVE: " from above"}


@dataclass(frozen=True)
class DryRun:
    """The plan of a calibration, begun with the table at ``start`` (rad).

    ``tracer_hz`` is the rate of the lengths as heard; None: none were.
    """

    calibration: Calibration
    start: float = 0.0
    tracer_hz: float | None = None

    def lines(self) -> Iterator[CheckLine]:
        """Yield what there is to know before anything moves."""
        yield self._first()
        yield self._size()
        yield self._travel()
        yield self._reach()
        yield from self._beams()
        yield self._time()
        yield from self._prospects()

    @property
    def _steps(self) -> tuple[Step, ...]:
        return self.calibration.plan.steps

    def _first(self) -> CheckLine:
        step, plan = self._steps[0], self.calibration.plan
        x, y, z = step.position
        there = f"{'past' if step.turn else 'to'} {step.table_angle / DEGREE:.6g}°"
        found = (
            f"table {there}{_SIDES.get(step.approach, '')}, probe to "
            f"({x:.4g}, {y:.4g}, {z:.4g}) m ({step.kind.name}, target {step.target})"
        )
        pause = plan.pause_before(step.index)
        if pause is not None and pause.again_from is None:
            found = f"a person's work first: {pause.instruction}; then {found}"
        return CheckLine(PART, "first order", "note", found)

    def _size(self) -> CheckLine:
        plan, policy = self.calibration.plan, self.calibration.configuration.planner.policy
        most = "" if policy == AS_LISTED else "at most "
        turns = self._ways + sum(step.turn is not None for step in self._ordered)
        counts = (
            _count(len(plan.distinct_angles), "table angle"),
            _count(len(plan.targets), "target"),
            f"{_count(turns, 'turn')} of the table",
            *([_count(len(plan.pauses), "pause") + " for a person"] if plan.pauses else []),
        )
        found = f"{most}{_count(len(self._steps), 'step')}: {', '.join(counts)}"
        return CheckLine(PART, "steps", "note", found)

    @property
    def _ordered(self) -> list[Step]:
        """The steps that are ordered: one for each turn, and all at rest."""
        steps = self._steps
        later = [b for a, b in pairwise(steps) if not b.follows(a)]
        return [*steps[:1], *later]

    @property
    def _ways(self) -> int:
        """How often the table goes from rest to rest, without the turns past its angles."""
        ways, here = 0, self.start
        for step in self._ordered:
            begin, end = (step.table_angle,) * 2
            if step.turn is not None:
                begin, end = step.turn.begin, step.turn.end
            ways += abs(begin - here) > 1e-9
            here = end
        return ways

    def _travel(self) -> CheckLine:
        """Say whether the table comes to all angles, where the travel is known."""
        ends = [end for s in self._steps if s.turn for end in (s.turn.begin, s.turn.end)]
        angles = [angle / DEGREE for angle in (*(s.table_angle for s in self._steps), *ends)]
        extent = f"{min(angles):.6g}° to {max(angles):.6g}°"
        configuration = self.calibration.configuration
        adapter = configuration.table_adapter
        if "table_adapter" not in configuration.given or adapter.lower_deg is None:
            todo = "compare with the travel of your table"
            if "table_adapter" in configuration.given:
                todo += ", or state it: table_adapter.lower_deg, upper_deg"
            return CheckLine(PART, "table", "open", f"{extent}; its travel is not stated", todo)
        try:
            self._ways_s()
        except DataError as error:
            todo = "change the table angles of the plan, or table_adapter.lower_deg and upper_deg"
            return CheckLine(PART, "table", "missing", str(error), todo)
        travel = f"{adapter.lower_deg:g}° to {adapter.upper_deg:g}°"
        return CheckLine(PART, "table", "good", f"{extent}, all within its travel of {travel}")

    def _ways_s(self) -> float:
        """Return the time (s) of all turns through the adapter; DataError: one cannot be."""
        settings, here, seconds = self.calibration.configuration.table_adapter, self.start, 0.0
        before = None
        for step in self._steps:
            if (step.table_angle, step.approach) != before:
                way = path_to(step.table_angle, step.approach, here, settings)
                here, seconds = way.goal, seconds + way.times_s[-1]
            before = step.table_angle, step.approach
        return seconds

    def _reach(self) -> CheckLine:
        """Say whether the probe comes to all targets, where the machine's volume is known."""
        places = np.array([step.position for step in self._steps])
        low, high = places.min(axis=0), places.max(axis=0)
        extent = ", ".join(
            f"{axis} {a:.4g} to {b:.4g}" for axis, a, b in zip("xyz", low, high, strict=True)
        )
        cell = self.calibration.configuration.cell
        if not cell.volume_from_m:
            todo = (
                "compare with your machine's volume, or state it: cell.volume_from_m, volume_to_m"
            )
            return CheckLine(PART, "probe", "open", f"{extent} m; its volume is not stated", todo)
        outside = ((places < cell.volume_from_m) | (places > cell.volume_to_m)).any(axis=1)
        if not outside.any():
            return CheckLine(PART, "probe", "good", f"{extent} m, all within the stated volume")
        first = self._steps[int(np.argmax(outside))]
        found = (
            f"{outside.sum()} of {len(places)} steps lie outside the stated volume, the first is "
            f"step {first.index} at ({', '.join(f'{x:.4g}' for x in first.position)}) m"
        )
        todo = "make the plan smaller (group plan), or correct cell.volume_from_m, volume_to_m"
        return CheckLine(PART, "probe", "missing", found, todo)

    def _beams(self) -> Iterator[CheckLine]:
        most = self.calibration.configuration.capture.max_length_m
        if self.calibration.instrument_place(self._steps[0]) is None:
            return
        shortest, longest = self.calibration.beam_range_m
        state: State = "good" if longest <= most else "missing"
        todo = "" if state == "good" else "bring the targets nearer, or raise capture.max_length_m"
        found = f"{shortest / MILLIMETRE:.0f} to {longest / MILLIMETRE:.0f} mm"
        yield CheckLine(PART, "beams", state, f"{found} from where the instrument stands", todo)

    def time_estimate(self) -> tuple[float, str]:
        """Return the time (s) of the plan, and what it rests on; DataError where none is known."""
        (seconds, why), each_s = self._measuring(), self.calibration.configuration.planner.pause_s
        works = sum(pause.again_from is None for pause in self.calibration.plan.pauses)
        if not (works and each_s):
            return seconds, why
        return seconds + works * each_s, f"{why}, {each_s:g} s for a pause (planner.pause_s)"

    def _measuring(self) -> tuple[float, str]:
        """Return the time (s) of the plan without a person's work, and what it rests on."""
        configuration = self.calibration.configuration
        planner, capture = configuration.planner, configuration.capture
        least = 0.0  # what the capture needs at a step at least, where it is known
        if self.tracer_hz:
            least = capture.settle_time_s + capture.window_samples / self.tracer_hz
        length_s = max(planner.step_s, least)
        if turns := [step.turn for step in self._ordered if step.turn is not None]:
            rests, way_s = len(self._ordered) - len(turns), self._ways * planner.turn_s
            each_s = [abs((turn.end - turn.begin) / turn.speed) for turn in turns]
            seconds = sum(each_s) + way_s + length_s * rests
            why = f"{sum(each_s) / len(each_s):.3g} s for each of {len(turns)} turns"
            return seconds, f"{why} and {length_s:g} s before one (planner.step_s)"
        first_turn = abs(self._steps[0].table_angle - self.start) > 1e-9
        if "table_adapter" in configuration.given:
            turns_s, turning = self._ways_s(), "turns as table_adapter moves the table"
            turn_s = 0.0
        else:
            turn_s = planner.turn_s
            turns_s = turn_s if first_turn else 0.0
            turning = f"{turn_s:g} s for a turn (planner.turn_s)"
        seconds = constant_time_model(turn_s, length_s).seconds(self._steps) + length_s + turns_s
        window = f", of which settling and readings {least:.2g} s" if least else ""
        return seconds, f"{turning} and {length_s:g} s for a step (planner.step_s{window})"

    def _time(self) -> CheckLine:
        try:
            seconds, why = self.time_estimate()
        except DataError:
            return CheckLine(PART, "time", "open", "not known: the table cannot go there")
        return CheckLine(PART, "time", "note", f"about {describe_duration(seconds)}, with {why}")

    def _prospects(self) -> Iterator[CheckLine]:
        """Yield what the plan cannot show, and what one more would bring, where that is quick."""
        turning = self._ordered[-1].turn is not None
        if not turning and (self.calibration.method.one_more is None or len(self._steps) > QUICK):
            return
        before, *more = prospects(self.calibration)
        yield CheckLine(PART, "result", "note", before.describe(before))
        for each in more:
            yield CheckLine(PART, "one more", "note", each.describe(before))


def describe_duration(seconds: float) -> str:
    """Return a duration as people say it."""
    minutes = round(seconds / 60)
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60:02d} min"


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


SEED: Final = 1
"""Seed of the measurement that is drawn; what is said does not depend on it."""


@dataclass(frozen=True)
class Prospect:
    """Largest standard uncertainty of each component (m, rad), and what nothing would test.

    ``change``: what is added to the plan; empty: nothing.
    """

    change: str
    std: Mapping[str, float]
    untested: tuple[Effect, ...]

    @classmethod
    def of(cls, calibration: Calibration, change: str = "") -> Prospect:
        """Return that of a plan, by one measurement of it with its stated noise.

        Where a method knows no noise it is an exact one, with the uncertainty that is stated.
        """
        alone, noisy = calibration.of_distances, calibration.method.disturbances is not None
        result = alone.solve(
            alone.measured({}, SEED).observations if noisy else alone.nominal_observations()
        )
        std = {name: float(result.std[name].max()) for name in result.components}
        return cls(change, std, result.unprotected)

    def describe(self, before: Prospect) -> str:
        """Return it for people; of more than the plan, what is better than ``before``."""
        expanded = ", ".join(
            f"U({name}) {COVERAGE_FACTOR * std / unit_of(name)[0]:.2g} {unit_of(name)[1]}"
            for name, std in self.std.items()
        )
        if not self.change:
            return f"{expanded}; not tested for: {', '.join(self.untested) or 'nothing'}"
        more = [effect for effect in before.untested if effect not in self.untested]
        return f"with {self.change}: {expanded}; then tested for: {', '.join(more) or 'no more'}"

    def to_dict(self) -> dict[str, Any]:
        """Return plain types for JSON."""
        return {"change": self.change, "std": dict(self.std), "not_tested_for": self.untested}


def prospects(calibration: Calibration) -> Iterator[Prospect]:
    """Yield that of the plan, and that with what would help most, where the method knows it."""
    if calibration.method.disturbances is None:
        return
    yield Prospect.of(calibration)
    find = calibration.method.one_more
    if find is not None and (better := find(calibration.configuration)) is not None:
        change, configuration = better
        yield Prospect.of(prepare(configuration), change)
