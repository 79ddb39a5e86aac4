"""The simulated machine tool: its probe touches balls that somebody has put on the table."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Stamps
from rotcal_ros.foundation.observations import (
    Command,
    LengthStatus,
    PointKind,
    ProbeSample,
    TracerSample,
)
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICROMETRE, MILLIMETRE, NANOSECOND
from rotcal_ros.geometry.rotations import rotation_about_z, rotation_from_vector
from rotcal_ros.methods.ball_plate.simulation import SimulatedTouchProbe
from rotcal_ros.methods.simulation.air import SimulatedTemperature
from rotcal_ros.methods.simulation.instrument import Table, Ticks
from rotcal_ros.methods.simulation.noise import IndexedNoise, NoiseSource
from rotcal_ros.methods.table_balls.settings import BallsSimulationSettings, SimulatedBallsSettings
from rotcal_ros.planning.points import parse_points


def placed_balls(settings: BallsSimulationSettings) -> Floats:
    """Return the true centres (k, 3) in the table frame at angle 0, m."""
    places = np.array(parse_points(settings.balls.balls_m, "balls_m"))
    missed = IndexedNoise(settings.seed, NoiseSource.BALL).normal(0, places.size)
    off = settings.balls.placing_mm * MILLIMETRE * missed.reshape(places.shape)
    return np.asarray(places + off)


def tilts(settings: SimulatedBallsSettings) -> Floats:
    """Return how each tilt of the axis below turns all that stands on it (t, 3, 3)."""
    along = np.eye(3)["AB".index(settings.tilting_axis)]
    lean = rotation_from_vector(np.array(settings.tilting_lean_arcsec) * ARCSEC)
    turns = np.array(settings.tilts_deg or (0.0,)) * DEGREE
    return rotation_from_vector(turns[:, None] * (lean @ along))


class TouchedBalls(SimulatedTouchProbe):
    """Touches balls on the table, or holds a nest or a ball bar to the one next to its order.

    Where an axis tilts the table, it stands as the station of the last order says.

    The bar sends lengths all the time; the ball in the spindle is where the machine shows it but
    for the machine's error. While the table turns the nest follows a ball, as the control knows
    the axis and the angle, late by its lag; it reads until the table rests, and once after that
    for every further order.
    """

    streams_lengths = True

    def __init__(
        self,
        settings: BallsSimulationSettings,
        table: Table,
        _temperature: SimulatedTemperature,
        start_ns: int,
    ) -> None:
        balls = settings.balls
        super().__init__(
            settings, settings.touch_probe, placed_balls(settings), balls.ball_diameter_m,
            table, start_ns,
        )  # fmt: skip
        self._bar_error_m = balls.bar_error_um * MICROMETRE
        self._ticks = Ticks(start_ns, balls.bar_rate_hz)
        self._nest_ticks = Ticks(start_ns, balls.nest_rate_hz)
        self._nest_lag_ns = round(balls.nest_lag_s / NANOSECOND)
        self._axis = np.array(balls.axis_m)
        self._scatter = IndexedNoise(settings.noise_seed, NoiseSource.TRACER)
        self._order: Command | None = None
        self._has_read = False  # whether the nest has read anything since the order
        self._tilts, self._tilt = tilts(balls), np.eye(3)
        self._foot = np.array(balls.tilting_axis_m)

    def order(self, now_ns: int, command: Command) -> None:
        """Go to the position of ``command``, with the bar at the ball that is next to it."""
        super().order(now_ns, command)
        self._order = command
        if command.turn is not None:
            self.pending = None  # what it reads answers the last order, whatever becomes of it
        self._has_read = False
        self._tilt = self._tilts[command.station % len(self._tilts)]

    def reading(self, stamp_ns: int, order: Command, number: int) -> ProbeSample:
        """Return a touch point or a centre; with a bar, where the machine shows the spindle."""
        if order.kind != PointKind.REFLECTOR:
            return super().reading(stamp_ns, order, number)
        return self.point(stamp_ns, order, np.array(order.position), 0.0)

    def report(self, after_ns: int, now_ns: int, table_rest_ns: int) -> tuple[ProbeSample, ...]:
        """Return the points until now; while the table turns, what the nest reads."""
        _, stamps = self._nest_ticks.until(now_ns)
        if self._order is None or self._order.turn is None:
            return super().report(after_ns, now_ns, table_rest_ns)
        read = stamps <= self._table.rest_ns
        read[:1] |= not self._has_read
        self._has_read |= bool(read.any())
        return tuple(self._followed(self._order, stamps[read])) if read.any() else ()

    def _followed(self, order: Command, stamps: Stamps) -> Iterator[ProbeSample]:
        """Yield how far the ball of an order is off the nest that follows it, at ``stamps``."""
        turned = self._table.angles(stamps - self._nest_lag_ns) - order.table_angle
        nest = rotation_about_z(turned) @ (np.array(order.position) - self._axis) + self._axis
        balls = self._standing(stamps)
        nearest = np.linalg.norm(balls - nest[:, None], axis=2).argmin(axis=1)
        ball = balls[np.arange(len(stamps)), nearest]
        std = self.settings.noise_um * MICROMETRE
        noise = std * self._noise.normal(3 * self._touches, ball.size).reshape(ball.shape)
        self._touches += len(stamps)
        off = ball + self._error(ball) + noise - nest
        for stamp_ns, place in zip(stamps.tolist(), off, strict=True):
            yield self.point(stamp_ns, order, place, std)

    def lengths(self, now_ns: int) -> tuple[TracerSample, ...]:
        """Return the lengths of the bar since the call before; none while balls are touched."""
        first, stamps = self._ticks.until(now_ns)
        if not len(stamps) or self._order is None or self._order.kind != PointKind.REFLECTOR:
            return ()
        balls = self._standing(stamps)
        shown = self.positions(stamps)
        away = np.linalg.norm(balls - (shown - self._error(shown))[:, None], axis=2)
        std = self.settings.noise_um * MICROMETRE
        noise = std * self._scatter.normal(first, len(stamps))
        lengths = (away.min(axis=1) + self._bar_error_m + noise).tolist()
        return tuple(
            TracerSample(stamp, (first + k) % (1 << 32), length, std, LengthStatus.OK)
            for k, (stamp, length) in enumerate(zip(stamps.tolist(), lengths, strict=True))
        )

    def _standing_balls(self, stamp_ns: int) -> Floats:
        (balls,) = self._standing(np.array([stamp_ns]))
        return np.asarray(balls)

    def _standing(self, stamps: Stamps) -> Floats:
        """Return the same at each of ``stamps`` (n,): (n, k, 3)."""
        rotation, translation = self._table.poses(stamps)
        balls = self._balls @ np.swapaxes(rotation, 1, 2) + translation[:, None]
        return np.asarray(self._foot + (balls - self._foot) @ self._tilt.T)
