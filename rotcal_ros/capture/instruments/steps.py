"""Finds the step that a bare position belongs to: by the orders, or without them by the plan.

``geometry_msgs`` hold the position of the probe, but no step. A reflector that is carried stands
at its step as soon as table and probe are both in position; a point that is measured (a touch, the
centre of a ball) belongs to the step at whose angle the table rests at that time.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from math import dist, isfinite
from typing import Any, Final

from rotcal_ros.capture import CaptureSettings
from rotcal_ros.capture.table import describe_offset
from rotcal_ros.foundation.observations import Command, PointKind, ProbeSample, TableSample
from rotcal_ros.foundation.units import ARCSEC, DEGREE, NANOSECOND
from rotcal_ros.planning.plan import Plan, Point, Step
from rotcal_ros.planning.table_feedback import is_near

DELAY_NS: Final = 200_000_000
"""Events are judged this long after their stamps: by then all streams have arrived."""
PATIENCE_NS: Final = 3_000_000_000
"""Table and probe must stand still elsewhere for this long before it is reported: they travel."""
_REMEMBERED: Final = 4096
"""Orders, and events that wait to be judged; beyond that the oldest are forgotten."""
_SILENT_NS: Final = 1_000_000_000
"""A probe that has sent nothing for this long stands at its last position."""
_ARRIVED_SHARE: Final = 0.01
"""A probe has arrived when two positions in a row differ by less than this share of its
tolerance."""
_FACTORS: Final = (1e-3, 1e3, 1e-6, 1e6)
"""Factors between the units of lengths."""


@dataclass(frozen=True, slots=True)
class Position:
    """Where the probe is (m, machine frame), without the step it belongs to."""

    stamp_ns: int
    position: Point


@dataclass(frozen=True, slots=True)
class Order:
    """An order with its stamp."""

    command: Command
    stamp_ns: int


@dataclass(slots=True)
class _Awaited:
    """A step whose points are awaited since ``since_ns``; ``points`` of them have come."""

    step: Step
    attempt: int
    since_ns: int
    points: int = 0


class StepFinder:
    """Answers orders on behalf of a machine that sends positions without steps.

    The table is in position within ``position_tolerance_arcsec`` of the angle, full turns left
    out; the probe within ``probe_tolerance_m`` of its target, a touched ball within
    ``ball_tolerance_m``. With a planner, the step is the one that it has ``ordered``; without one
    (a bag from elsewhere) it is the next one of the plan that fits, and steps that were left out
    are skipped. A carried reflector that still moves within the tolerance has not arrived; a
    ``single_shot`` probe has, because it sends only then. A reading (PointKind.READING) is no
    place: it may have any value, and while the table turns all of them belong to the last order.
    Events are judged in the order of their stamps, whichever stream arrives first.
    """

    def __init__(
        self,
        plan: Plan,
        settings: CaptureSettings,
        tip_radius_m: float = 0.0,
        *,
        ordered: bool = False,
        single_shot: bool = False,
    ) -> None:
        self._plan, self._settings, self._tip_radius = plan, settings, tip_radius_m
        self._angle_tolerance = settings.position_tolerance_arcsec * ARCSEC
        self._speed_limit = settings.velocity_tolerance_deg_s * DEGREE
        self._orders: deque[_Awaited] = deque(maxlen=_REMEMBERED)
        self.ordered = ordered
        self._planned = _Awaited(plan.steps[0], 0, 0)
        self._next = self._answered = 0
        self._active = False
        self._waiting: list[tuple[int, TableSample | Position]] = []
        self._newest_ns: int | None = None
        self._angle: float | None = None
        self._position: Position | None = None
        self._single_shot, self._stands = single_shot, True
        self._feedback: TableSample | None = None
        self._had_velocity = False
        self._stood: dict[type, Position | TableSample] = {}
        self._moved_ns = 0

    def understood(self, record: Any) -> Iterator[Any]:
        """Yield the records for the capture: a position becomes the step it stands at."""
        match record:
            case Order():
                yield record.command
                self.order(record)
            case Position():
                self._active = True
                self._keep(record.stamp_ns, record)
            case TableSample():
                yield record
                yield from self.table(record)
            case _:
                yield record

    def order(self, order: Order) -> None:
        """Take an order; one stamped by a clock that is far off counts from its arrival."""
        command, stamp_ns = order.command, order.stamp_ns
        if not 0 <= command.step < len(self._plan.steps):
            return
        now_ns = stamp_ns if self._newest_ns is None else self._newest_ns
        if abs(stamp_ns - now_ns) * NANOSECOND > self._settings.clock_tolerance_s:
            stamp_ns = now_ns
        self.ordered = True
        step = self._plan.steps[command.step]
        self._orders.append(_Awaited(step, command.attempt, stamp_ns))

    def table(self, sample: TableSample) -> tuple[ProbeSample, ...]:
        """Take a feedback of the table; return the answers that are certain now."""
        newest_ns = sample.stamp_ns if self._newest_ns is None else self._newest_ns
        set_back = (newest_ns - sample.stamp_ns) * NANOSECOND > self._settings.clock_tolerance_s
        self._newest_ns = sample.stamp_ns if set_back else max(newest_ns, sample.stamp_ns)
        if not self._active:  # no position without its step has come so far
            self._event(sample.stamp_ns, sample)
            return ()
        self._keep(sample.stamp_ns, sample)
        return self._judge_until(self._newest_ns - DELAY_NS)

    def current_fault(self) -> str | None:
        """Return why the last order has no answer, once table and probe stand still."""
        if not self._orders or self._orders[-1].points or self._position is None:
            return None
        if self._orders[-1].step.turn is not None:
            return None
        still_since_ns = max(self._orders[-1].since_ns, self._moved_ns)
        if self._newest_ns is None or self._newest_ns - still_since_ns < PATIENCE_NS:
            return None
        step = self._orders[-1].step
        if not self._is_at(step):
            return f"step {step.index}: {self._table_in_words(step)}"
        off = dist(self._position.position, step.position)
        text = (
            f"step {step.index}: the probe says {self._position.position}, {off:.6g} m from where "
            f"it was sent, {step.position} (allowed {self._reach(step):g} m)"
        )
        if (times := self._wrong_factor(step)) is not None:
            text += f": {times:g} times as far; which is topics.position_unit?"
        return text

    def _table_in_words(self, step: Step) -> str:
        table = self._feedback
        if table is None:
            return "no table feedback since the order"
        return describe_offset(
            table.angle, table.velocity, step.table_angle, self._settings,
            had_velocity=self._had_velocity,
        )  # fmt: skip

    def _wrong_factor(self, step: Step) -> float | None:
        """Return the factor by which a position is too large, if another unit would explain it."""
        assert self._position is not None
        for factor in _FACTORS:
            position = tuple(factor * x for x in self._position.position)
            if dist(position, step.position) <= self._reach(step):
                return 1.0 / factor
        return None

    def _keep(self, stamp_ns: int, event: TableSample | Position) -> None:
        at = bisect_right(self._waiting, stamp_ns, key=lambda waiting: waiting[0])
        self._waiting.insert(at, (stamp_ns, event))
        del self._waiting[:-_REMEMBERED]

    def _judge_until(self, horizon_ns: int) -> tuple[ProbeSample, ...]:
        """Judge the events up to ``horizon_ns``; return the answers that they give."""
        count = bisect_right(self._waiting, horizon_ns, key=lambda waiting: waiting[0])
        due, self._waiting = self._waiting[:count], self._waiting[count:]
        answers = (self._event(stamp_ns, event) for stamp_ns, event in due)
        return tuple(answer for answer in answers if answer is not None)

    def _event(self, stamp_ns: int, event: TableSample | Position) -> ProbeSample | None:
        """Handle the next event; return the answer that it gives."""
        self._note_motion(stamp_ns, event)
        if isinstance(event, TableSample):
            resting = abs(event.velocity) <= self._speed_limit
            self._had_velocity |= isfinite(event.velocity)
            self._feedback, self._angle = event, event.angle if resting else None
        elif all(map(isfinite, event.position)):
            self._stands = self._single_shot or self._stays(event)
            self._position = event
        waited = self._turning(stamp_ns)
        if waited is not None:
            return self._answer(waited, stamp_ns) if event is self._position else None
        if self._angle is None or self._position is None:
            return None
        self._stands |= stamp_ns - self._position.stamp_ns >= _SILENT_NS
        waited = self._waited_for(stamp_ns)
        if waited is None:
            return None
        carried = waited.step.kind == PointKind.REFLECTOR
        if waited.points >= (1 if carried else waited.step.n_points):
            return None
        if not carried and not isinstance(event, Position):
            return None
        return self._answer(waited, stamp_ns)

    def _note_motion(self, stamp_ns: int, event: TableSample | Position) -> None:
        """Note when table or probe last moved further than tolerated from where they stood."""
        before = self._stood.get(type(event))
        match before, event:
            case TableSample(), TableSample():
                # Written with "not", so that an angle that is NaN counts as motion.
                moved = not abs(event.angle - before.angle) <= self._angle_tolerance
            case Position(), Position():
                off = dist(event.position, before.position)
                moved = off > self._settings.probe_tolerance_m
            case _:
                moved = True
        if moved:
            self._stood[type(event)], self._moved_ns = event, stamp_ns

    def _stays(self, event: Position) -> bool:
        """Return whether the probe has not moved since its last position; True for the first."""
        if self._position is None:
            return True
        moved = dist(event.position, self._position.position)
        return moved <= _ARRIVED_SHARE * self._settings.probe_tolerance_m

    def _waited_for(self, stamp_ns: int) -> _Awaited | None:
        """Return the step that is awaited at this time, if table and probe have reached it."""
        if self.ordered:
            waited = next((o for o in reversed(self._orders) if o.since_ns <= stamp_ns), None)
            return waited if waited is not None and self._is_reached(waited.step) else None
        planned = self._planned
        if planned.points and planned.points < planned.step.n_points:
            return planned if self._is_reached(planned.step) else None
        for step in self._plan.steps[self._next :]:
            if self._is_reached(step):
                self._next, self._planned = step.index + 1, _Awaited(step, 0, stamp_ns)
                return self._planned
        return None

    def _turning(self, stamp_ns: int) -> _Awaited | None:
        """Return the step that is awaited at this time, if the table passes it without a stop."""
        waited = next((o for o in reversed(self._orders) if o.since_ns <= stamp_ns), None)
        return None if waited is None or waited.step.turn is None else waited

    def _answer(self, waited: _Awaited, stamp_ns: int) -> ProbeSample:
        assert self._position is not None
        step, point = waited.step, waited.points
        waited.points, self._answered = point + 1, self._answered + 1
        order = step.command(waited.attempt)
        return order.answered(
            stamp_ns,
            self._answered - 1,
            self._position.position,
            point=point,
            tip_radius=self._tip_radius,
        )

    def _is_reached(self, step: Step) -> bool:
        assert self._position is not None
        near = step.kind == PointKind.READING or (
            dist(self._position.position, step.position) <= self._reach(step)
        )
        arrived = self._stands or step.kind != PointKind.REFLECTOR
        return near and arrived and self._is_at(step)

    def _is_at(self, step: Step) -> bool:
        """Return whether the table rests at the angle of a step."""
        here = self._angle
        return here is not None and is_near(here, step.table_angle, self._angle_tolerance)

    def _reach(self, step: Step) -> float:
        """Return how far (m) a position may be from that of its step."""
        if step.kind == PointKind.CENTRE:
            return self._settings.ball_tolerance_m
        if step.kind == PointKind.SURFACE:
            radius = 0.5 * step.ball_diameter + self._tip_radius
            return radius + self._settings.ball_tolerance_m
        return self._settings.probe_tolerance_m
