"""An order of the cell, carried out by a machine behind I++ DME: from a command to its points."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import count
from typing import Final

from rotcal_ros.dme.client import DmeClient
from rotcal_ros.dme.faults import DmeError
from rotcal_ros.dme.touching import Go, Touch, around_ball
from rotcal_ros.observations import Approach, Command, PointKind, ProbeSample
from rotcal_ros.planning.plan import Point, Step
from rotcal_ros.units import MICROMETRE

NO_ORDER: Final = Command(0, 0, 0.0, Approach.UNKNOWN, PointKind.UNKNOWN, 0, (0.0, 0.0, 0.0))
"""Of a point that nobody ordered: its kind says so."""


class Measuring:
    """Carries out orders one after the other; its points count up from 0."""

    def __init__(self, client: DmeClient, now_ns: Callable[[], int]) -> None:
        self._client, self._now_ns = client, now_ns
        self._numbers = count()

    def carry_out(
        self, order: Command, step: Step, given_up: Callable[[], bool]
    ) -> Iterator[ProbeSample]:
        """Turn the table, go to the target of ``order`` and yield its points as they are made.

        ``step`` says how often which ball is touched. ``given_up`` is asked before every motion,
        whether somebody has: then it ends early. Raises DmeError.
        """
        if order.kind == PointKind.SURFACE:
            return self._touches(order, step, given_up)
        if order.kind == PointKind.REFLECTOR:
            return self._stands(order, given_up)
        raise DmeError(
            f"step {order.step} asks for a point of kind {order.kind.name}: through I++ DME there "
            "are touch points (plan.measure: surface) and positions of a reflector"
        )

    def unasked(self, position: Point) -> ProbeSample:
        """Return where the machine stands (m) as a point that nobody ordered."""
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
        moves = around_ball(
            order.position, step.ball_diameter, step.n_points, tip, s.approach_m, height
        )
        for move in moves:
            if given_up():
                return
            match move:
                case Go(x, y, z):
                    client.go(x, y, z)
                case Touch(nominal, direction):
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
