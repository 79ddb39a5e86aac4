"""Whether the joint does what it was ordered, judged by its feedback alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite, isnan, nan

from rotcal_ros.foundation.observations import TableSample
from rotcal_ros.foundation.units import ARCSEC, DEGREE, TURN
from rotcal_ros.planning.approach import JointPath
from rotcal_ros.planning.settings import TableAdapterSettings
from rotcal_ros.planning.table_feedback import TableSpeed, looks_like_degrees

_LATE = 1.5
"""A way that takes this multiple of its duration is called late."""
_SPEED_S = 0.05
"""Time over which a velocity is taken from angles: long against the noise of an encoder."""
_REST_S = 0.5
"""A joint that stands still this long is no longer on its way: then its position is its answer."""
_FAR = 2 * TURN
"""rad, an angle at the start that is more likely one in degrees."""


@dataclass
class ActiveOrder:
    """An order under way: how far its joint has come. Times are monotonic, in seconds.

    ``over``: it has arrived, or was left; what the joint does after that does not concern this
    order.
    """

    way: JointPath
    begun_s: float
    moved: bool = False
    over: bool = False


class JointMonitor:
    """Follows the joint by its feedback; decides what the cell hears, and finds what is wrong.

    ``velocity`` (rad/s) is the latest, NaN where it is not known.
    """

    def __init__(self, settings: TableAdapterSettings) -> None:
        self._settings = settings
        self._tolerance = settings.tolerance_arcsec * ARCSEC
        self._heard_s = self._moved_s = 0.0
        self._moved_to = self.velocity = nan
        self._speed = TableSpeed(_SPEED_S)
        self.latest: TableSample | None = None
        self.order: ActiveOrder | None = None

    def doubt(self) -> str | None:
        """Return why nothing may move yet, in one sentence; None if it may."""
        if self.order is not None or self._settings.many_turns:
            return None
        if self.latest is None or not abs(self.latest.angle) > _FAR:
            return None
        angle = self.latest.angle
        return (
            f"the table reports {angle:.6g} rad before its first order, {angle / TURN:.1f} turns: "
            f"if these are degrees, let joint_states be in rad; if they are turns, set "
            "table_adapter.many_turns: true"
        )

    def here(self, now_s: float) -> float | None:
        """Return the present angle (rad) of the joint; None if its feedback is old or missing."""
        if self.latest is None or now_s - self._heard_s > self._settings.silence_s:
            return None
        return self.latest.angle if isfinite(self.latest.angle) else None

    def motion(self, now_s: float) -> tuple[float, float] | None:
        """Return where the joint is (rad) and its velocity (rad/s); None if unknown."""
        here = self.here(now_s)
        return None if here is None else (here, self.velocity)

    def begin(self, way: JointPath, now_s: float) -> None:
        """Note an order that was just sent."""
        self.order, self._moved_s = ActiveOrder(way, now_s), now_s

    def leave(self) -> None:
        """Let the order be over."""
        if self.order is not None:
            self.order.over = True

    def under_way(self, now_s: float) -> bool:
        """Return whether the joint may be moving as ordered: not there yet, nor stopped short."""
        order = self.order
        return order is not None and not order.over and not self._has_stopped(order, now_s)

    def receive(self, sample: TableSample, now_s: float) -> TableSample | None:
        """Return ``sample`` as the cell shall hear it, with a velocity; None: not at all.

        A joint that has an order and has not begun to move is not at rest at its goal: it may
        stand there by chance, before it comes again from the other side. Its velocity is then
        unknown (NaN), which is not taken for rest.
        """
        self.latest, self._heard_s = sample, now_s
        if not isfinite(sample.angle):
            return None
        if not abs(sample.angle - self._moved_to) <= self._tolerance:
            self._moved_to, self._moved_s = sample.angle, now_s
        by_angles = self._speed.feed(sample.stamp_ns, sample.angle)
        feedback = by_angles if isnan(sample.velocity) else sample
        self.velocity = nan if feedback is None else feedback.velocity
        begun, order = self._begun(sample.angle), self.order
        if order is not None and now_s - order.begun_s > order.way.times_s[-1] and self.arrived():
            self.leave()
        return feedback if begun else replace(sample, velocity=nan)

    def _has_stopped(self, order: ActiveOrder, now_s: float) -> bool:
        late_s = now_s - order.begun_s - _LATE * order.way.times_s[-1]
        return min(late_s, now_s - self._moved_s) > self._settings.silence_s

    def _begun(self, angle: float) -> bool:
        """Return whether the joint has begun to obey, or has nothing to do."""
        order = self.order
        if order is None:
            return True
        start = order.way.start
        has_to_move = any(abs(stop - start) > self._tolerance for stop in order.way.angles)
        order.moved = order.moved or not has_to_move or abs(angle - start) > self._tolerance
        return order.moved

    def arrived(self) -> bool:
        """Return whether the joint is where it was sent last, whole turns apart.

        One that stands there and has to come again from the other side is not there yet.
        """
        order = self.order
        return order is None or (order.moved and self._off(order.way) <= self._tolerance)

    def current_fault(self, now_s: float) -> str | None:
        """Return in one sentence what is wrong with the table, None while all is well."""
        patience = self._settings.silence_s
        if self.latest is None:
            return None
        if now_s - self._heard_s > patience:
            return f"no feedback of the table for {now_s - self._heard_s:.1f} s"
        if now_s - self._heard_s > 0.5 * patience:
            return None  # soon it is silent, or reports more
        if not isfinite(self.latest.angle):
            return "the feedback of the table is not a number"
        order = self.order
        if order is None or self.arrived():
            return None
        goal, angle = order.way.goal, self.latest.angle
        still_s = now_s - self._moved_s
        if still_s > _REST_S and looks_like_degrees(angle, goal):
            return (
                f"the table reports {angle:.6g} where {goal:.6g} rad were ordered: its feedback "
                "is in degrees, joint_states must be in rad"
            )
        if not order.moved and still_s > patience:
            return (
                f"the table has not moved for {still_s:.1f} s since it was sent to "
                f"{goal / DEGREE:.4f} deg: is {self._settings.controller} active, and did it "
                "accept the order?"
            )
        if self._has_stopped(order, now_s):
            return (
                f"the table stopped at {angle / DEGREE:.4f} deg, "
                f"{self._off(order.way) / ARCSEC:.4g} arcsec from where it was sent "
                f"({goal / DEGREE:.4f} deg)"
            )
        return None

    def _off(self, way: JointPath) -> float:
        if self.latest is None or not isfinite(self.latest.angle):
            return float("inf")
        off = self.latest.angle - way.goal
        return abs(off - TURN * round(off / TURN))
