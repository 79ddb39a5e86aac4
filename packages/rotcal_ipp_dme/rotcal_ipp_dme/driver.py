"""The thread that drives a machine behind I++ DME: orders in, feedback and points out.

OrderRunner carries out an order of the cell, from the command to its points. The tip goes around a
ball from above, beside it, against it, and up again. No part of its way leads through the ball,
whichever points of the upper half are touched in whichever order; between balls the tip travels at
the height of clearance.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass, field
from itertools import count
from math import cos, pi, sin, sqrt
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Final

from rotcal_ipp_dme.client import DmeClient
from rotcal_ipp_dme.protocol import DmeError, DmeFault
from rotcal_ipp_dme.settings import DmeSettings
from rotcal_ros.foundation.node_state import NodeState, State, Why
from rotcal_ros.foundation.observations import (
    Approach,
    Command,
    PointKind,
    ProbeSample,
    TableSample,
)
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.planning.plan import Point, Step

_Order = tuple[Command, Step]


@dataclass
class _Clear:
    """A person's permission to clear the errors."""

    done: Future[str] = field(default_factory=Future)


class Driver:
    """Carries out the latest order, and asks where the machine stands while there is none.

    Nothing is sent before :meth:`begin`.
    ``publish_table``, ``publish_point`` and ``complain`` are called by the threads of the driver.
    ``state`` says in words what it does, ``busy`` whether the machine may be moving: for an order,
    or because it is homed at the start of a session.
    """

    def __init__(
        self,
        settings: DmeSettings,
        publish_table: Callable[[TableSample], None],
        publish_point: Callable[[ProbeSample], None],
        complain: Callable[[str], None],
        now_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self.client = DmeClient(settings, self._heard, self._warned, now_ns)
        self.state = NodeState.of(State.PREPARING, Why.STARTING_SESSION)
        self.busy, self.refused, self.warnings = False, 0, 0
        self._publish_table, self._publish_point = publish_table, publish_point
        self._complain = complain
        self._measuring = OrderRunner(self.client, now_ns)
        self._jobs: SimpleQueue[_Order | _Clear | None] = SimpleQueue()
        self._wanted: _Order | None = None
        self._stopping = False
        self._thread: Thread | None = None

    @property
    def alive(self) -> bool:
        """Whether the thread still works."""
        return self._thread is not None and self._thread.is_alive()

    def begin(self, stopped: str | None = None) -> None:
        """Begin a session; if the cell is ``stopped``, only with the first :meth:`clear`."""
        self.client.blocked = stopped or self.client.blocked
        self._thread = Thread(target=self._work, args=(not stopped,), name="DME", daemon=True)
        self._thread.start()

    def order(self, command: Command, step: Step) -> None:
        """Carry out ``command``; the order before it is given up at its next motion."""
        self._wanted = command, step
        self._jobs.put(self._wanted)

    def forget(self) -> None:
        """Begin no order that waits; one that is being carried out ends at its next motion."""
        self._wanted = None

    def clear(self) -> Future[str]:
        """Clear the machine's errors for a person; the future holds the outcome.

        It has the DmeError of a failed attempt.
        """
        request = _Clear()
        self._jobs.put(request)
        return request.done

    def abort(self, why: str) -> None:
        """Stop all motion now; nothing moves again before :meth:`clear`.

        A machine that does not answer blocks no caller: a thread of its own waits for it.
        """
        Thread(target=self._abort, args=(why,), name="AbortE", daemon=True).start()

    def stop(self) -> None:
        """End: what moves is aborted, then the session is closed."""
        self._stopping = True
        if self.busy:
            self.abort("the adapter was ended in the middle of a motion")
        self._jobs.put(None)

    def _work(self, starts: bool) -> None:
        if starts:
            self._move(self.client.start)
        while not self._stopping:
            self.state = self._at_rest()
            try:
                job = self._jobs.get(timeout=self.client.settings.idle_period_s)
            except Empty:
                if not self.client.blocked:
                    self._try(self._tell_where)
                continue
            if isinstance(job, _Clear):
                self._clear(job)
            elif job is not None:
                self._obey(job)
        self.client.close()

    def _at_rest(self) -> NodeState:
        if blocked := self.client.blocked:
            return NodeState.of(State.FAILED, Why.BLOCKED, blocked)
        return NodeState(State.READY)

    def _abort(self, why: str) -> None:
        try:
            self.client.abort(why)
        except DmeError as error:
            self._complain(f"{why}; {error}")
        if self._stopping:  # what was aborted need not be answered
            self.client.close()

    def _obey(self, order: _Order) -> None:
        """Carry out an order that is still wanted, or report why not."""

        def given_up() -> bool:
            return self._stopping or self._wanted is not order or bool(self.client.blocked)

        if self._wanted is not order:
            return
        command, step = order
        name = f"step {command.step}, attempt {command.attempt}"
        if self.client.blocked:
            self.refused += 1
            self._complain(f"{name} refused until a person clears: {self.client.blocked}")
            return
        self.state = NodeState.of(State.WORKING, Why.ORDERED, command.step, command.attempt)

        def carry_out() -> None:
            for point in self._measuring.carry_out(command, step, given_up):
                self._publish_point(point)
            self._tell_where()

        self._move(carry_out)

    def _clear(self, request: _Clear) -> None:
        why, self.busy = self.client.blocked or "nothing", True
        try:
            self.client.clear()
        except DmeError as error:
            request.done.set_exception(error)
        else:
            request.done.set_result(f"cleared: {why}")
        finally:
            self.busy = False

    def _tell_where(self) -> None:
        """Publish the position without an order, so that a preflight hears the machine."""
        self._publish_point(self._measuring.unsolicited(self.client.where().position))

    def _move(self, work: Callable[[], None]) -> None:
        """Do work in which the machine moves; ending it in the middle aborts the motion."""
        self.busy = not self._stopping
        self._try(work)
        self.busy = False

    def _try(self, work: Callable[[], None]) -> None:
        """Do work whose errors are reported instead of raised: they block the session."""
        try:
            work()
        except DmeError as error:
            if not self._stopping:
                self._complain(str(error))

    def _heard(self, feedback: TableSample | None, _position: Point) -> None:
        if feedback is not None:
            self._publish_table(feedback)

    def _warned(self, fault: DmeFault) -> None:
        self.warnings += 1
        self._complain(f"the machine reports: {fault}")


NO_ORDER: Final = Command(0, 0, 0.0, Approach.UNKNOWN, PointKind.UNKNOWN, 0, (0.0, 0.0, 0.0))
"""Step of a point that was not ordered: its kind says so."""


class OrderRunner:
    """Carries out orders one after the other; its points count up from 0."""

    def __init__(self, client: DmeClient, now_ns: Callable[[], int]) -> None:
        self._client, self._now_ns = client, now_ns
        self._numbers = count()

    def carry_out(
        self, order: Command, step: Step, given_up: Callable[[], bool]
    ) -> Iterator[ProbeSample]:
        """Turn the table, go to the target of ``order`` and yield its points as they are made.

        ``step`` says how often which ball is touched. ``given_up`` is called before every motion
        and ends the order early if true. Raises DmeError.
        """
        if order.kind == PointKind.SURFACE:
            return self._touches(order, step, given_up)
        if order.kind == PointKind.REFLECTOR:
            return self._stands(order, given_up)
        raise DmeError(
            f"step {order.step} requests a point of kind {order.kind.name}: through I++ DME there "
            "are touch points (plan.measure: surface) and positions of a reflector"
        )

    def unsolicited(self, position: Point) -> ProbeSample:
        """Return where the machine stands (m) as a point that was not ordered."""
        return self._sample(NO_ORDER, self._now_ns(), position)

    def _touches(
        self, order: Command, step: Step, given_up: Callable[[], bool]
    ) -> Iterator[ProbeSample]:
        client, s = self._client, self._client.settings
        tip, ball = client.tip_radius, 0.5 * step.ball_diameter
        height = order.position[2] + ball + tip + max(s.clearance_m, s.approach_m)
        if client.where().position[2] < height:
            if given_up():
                return
            client.go(None, None, height)
        if not client.turn(order.table_angle, order.approach, given_up):
            return
        client.settle()
        number = count()
        moves = ball_touch_moves(
            order.position, step.ball_diameter, step.n_points, tip, s.approach_m, height
        )
        for move in moves:
            if given_up():
                return
            match move:
                case MoveOrder(x, y, z):
                    client.go(x, y, z)
                case TouchOrder(nominal, direction):
                    stamp_ns, position = client.touch(nominal, direction)
                    yield self._sample(order, stamp_ns, position, next(number), tip)

    def _stands(self, order: Command, given_up: Callable[[], bool]) -> Iterator[ProbeSample]:
        """Yield the one position of a reflector, at rest at its target."""
        client = self._client
        if not client.turn(order.table_angle, order.approach, given_up) or given_up():
            return
        client.go(*order.position)
        client.settle()
        position = client.where().position
        yield self._sample(order, self._now_ns(), position)

    def _sample(
        self,
        order: Command,
        stamp_ns: int,
        position: Point,
        number: int = 0,
        tip_radius: float = 0.0,
    ) -> ProbeSample:
        std = self._client.settings.point_std_um * MICROMETRE
        return order.answered(
            stamp_ns, next(self._numbers), position, (std, std, std), number, tip_radius
        )


_GOLDEN: Final = pi * (3.0 - sqrt(5.0))


@dataclass(frozen=True, slots=True)
class MoveOrder:
    """Move the tip in a straight line; what is None stays as it is. Metres."""

    x: float | None
    y: float | None
    z: float | None


@dataclass(frozen=True, slots=True)
class TouchOrder:
    """Touch the surface at ``nominal`` (m) against ``direction``, which leads away from it."""

    nominal: Point
    direction: Point


def upper_half_directions(count: int) -> Iterator[Point]:
    """Yield ``count`` directions that cover the upper half of a ball evenly, unit vectors."""
    for number in range(count):
        height = (number + 0.5) / count
        flat = sqrt(1.0 - height * height)
        yield flat * cos(number * _GOLDEN), flat * sin(number * _GOLDEN), height


def ball_touch_moves(
    centre: Point, diameter: float, count: int, tip_radius: float, approach: float, height: float
) -> Iterator[MoveOrder | TouchOrder]:
    """Yield the moves that touch a ball ``count`` times, from ``height`` (z, m) back to it.

    ``approach`` (m) is the distance from the surface at which a probing motion begins.
    """
    radius = 0.5 * diameter
    beside = radius + tip_radius + approach
    for direction in upper_half_directions(count):
        nominal = _along(centre, direction, radius)
        start = _along(centre, direction, beside)
        yield MoveOrder(start[0], start[1], height)
        yield MoveOrder(None, None, start[2])
        yield TouchOrder(nominal, direction)
        yield MoveOrder(None, None, height)


def _along(centre: Point, direction: Point, distance: float) -> Point:
    x, y, z = (c + distance * d for c, d in zip(centre, direction, strict=True))
    return x, y, z
