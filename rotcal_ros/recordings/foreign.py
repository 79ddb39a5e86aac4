"""Streams of somebody else's cell: bare numbers and points, without status, step or attempt.

``std_msgs/Float64`` carries a length or an angle; its stamp is the log time.
``geometry_msgs/PointStamped`` carries where the probe is; which step it stands at follows from
the plan and from where the table is.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import dist, pi
from typing import Final

from rotcal_ros.capture import CaptureSettings
from rotcal_ros.observations import ProbeSample, TableSample
from rotcal_ros.planning.plan import Plan, Point
from rotcal_ros.units import ARCSEC, DEGREE, NANOSECOND

FLOAT: Final = "std_msgs/msg/Float64"
POINT: Final = "geometry_msgs/msg/PointStamped"


@dataclass(frozen=True, slots=True)
class Position:
    """Where the probe is (m, machine frame), received without a step."""

    stamp_ns: int
    position: Point


class Speedometer:
    """Turns bare angles (rad) into table feedback; the velocity is that since the one before."""

    def __init__(self) -> None:
        self._before: tuple[int, float] | None = None

    def sample(self, stamp_ns: int, angle: float) -> TableSample:
        """Return the feedback; the first one is at rest."""
        velocity = 0.0
        if self._before is not None and stamp_ns > self._before[0]:
            seconds = (stamp_ns - self._before[0]) * NANOSECOND
            velocity = (angle - self._before[1]) / seconds
        self._before = (stamp_ns, angle)
        return TableSample(stamp_ns, angle, velocity)


class StepFinder:
    """Finds the step of the plan that table and probe stand at, in the order of the plan.

    A step is reached when the table rests within ``position_tolerance_arcsec`` of its angle, whole
    turns apart or not, and the probe within ``probe_tolerance_m`` of its target. Steps that were
    left out are passed over; none is found twice.
    """

    def __init__(self, plan: Plan, settings: CaptureSettings) -> None:
        self._plan = plan
        self._angle_tolerance = settings.position_tolerance_arcsec * ARCSEC
        self._speed_limit = settings.velocity_tolerance_deg_s * DEGREE
        self._point_tolerance = settings.probe_tolerance_m
        self._next = 0
        self._found = 0
        self._angle: float | None = None
        self._position: Point | None = None

    def table(self, sample: TableSample) -> ProbeSample | None:
        """Take where the table is; return the answer of a step that it has reached."""
        self._angle = sample.angle if abs(sample.velocity) <= self._speed_limit else None
        return self._answer(sample.stamp_ns)

    def probe(self, sample: Position) -> ProbeSample | None:
        """Take where the probe is; return the answer of a step that it has reached."""
        self._position = sample.position
        return self._answer(sample.stamp_ns)

    def _answer(self, stamp_ns: int) -> ProbeSample | None:
        if self._angle is None or self._position is None:
            return None
        for step in self._plan.steps[self._next :]:
            away = (self._angle - step.table_angle + pi) % (2 * pi) - pi
            near = abs(away) <= self._angle_tolerance
            if near and dist(self._position, step.position) <= self._point_tolerance:
                self._next, self._found = step.index + 1, self._found + 1
                return ProbeSample(
                    stamp_ns=stamp_ns,
                    sequence=self._found - 1,
                    step=step.index,
                    attempt=0,
                    kind=step.kind,
                    target=step.target,
                    station=step.station,
                    point=0,
                    position=self._position,
                    position_std=(0.0, 0.0, 0.0),
                    tip_radius=0.0,
                )
        return None
