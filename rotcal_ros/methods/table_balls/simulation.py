"""The simulated machine tool: its probe touches balls that somebody has put on the table."""

from __future__ import annotations

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.observations import (
    Command,
    LengthStatus,
    PointKind,
    ProbeSample,
    TracerSample,
)
from rotcal_ros.foundation.units import MICROMETRE, MILLIMETRE
from rotcal_ros.methods.ball_plate.simulation import SimulatedTouchProbe
from rotcal_ros.methods.simulation.air import SimulatedTemperature
from rotcal_ros.methods.simulation.cell import Ticks
from rotcal_ros.methods.simulation.instrument import Table
from rotcal_ros.methods.simulation.noise import IndexedNoise, NoiseSource
from rotcal_ros.methods.table_balls.settings import BallsSimulationSettings
from rotcal_ros.planning.points import triples


def placed_balls(settings: BallsSimulationSettings) -> Floats:
    """Return the true centres (k, 3) in the table frame at angle 0, m."""
    places = np.array(triples(settings.balls.balls_m, "balls_m"))
    missed = IndexedNoise(settings.seed, NoiseSource.BALL).normal(0, places.size)
    off = settings.balls.placing_mm * MILLIMETRE * missed.reshape(places.shape)
    return np.asarray(places + off)


class TouchedBalls(SimulatedTouchProbe):
    """Touches balls on the table, or holds a ball bar to the one that is next to its order.

    The bar sends lengths all the time; the ball in the spindle is where the machine shows it but
    for the machine's error.
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
        self._scatter = IndexedNoise(settings.noise_seed, NoiseSource.TRACER)
        self._order: Command | None = None

    def order(self, now_ns: int, command: Command) -> None:
        """Go to the position of ``command``, with the bar at the ball that is next to it."""
        super().order(now_ns, command)
        self._order = command

    def reading(self, stamp_ns: int, order: Command, number: int) -> ProbeSample:
        """Return a touch point or a centre; with a bar, where the machine shows the spindle."""
        if order.kind != PointKind.REFLECTOR:
            return super().reading(stamp_ns, order, number)
        return self.point(stamp_ns, order, np.array(order.position), 0.0)

    def lengths(self, now_ns: int) -> tuple[TracerSample, ...]:
        """Return the lengths of the bar since the call before; none while balls are touched."""
        first, stamps = self._ticks.until(now_ns)
        if not len(stamps) or self._order is None or self._order.kind != PointKind.REFLECTOR:
            return ()
        rotation, translation = self._table.poses(stamps)
        balls = self._balls @ np.swapaxes(rotation, 1, 2) + translation[:, None]
        shown = self.positions(stamps)
        away = np.linalg.norm(balls - (shown - self._error(shown))[:, None], axis=2)
        std = self.settings.noise_um * MICROMETRE
        noise = std * self._scatter.normal(first, len(stamps))
        lengths = (away.min(axis=1) + self._bar_error_m + noise).tolist()
        return tuple(
            TracerSample(stamp, (first + k) % (1 << 32), length, std, LengthStatus.OK)
            for k, (stamp, length) in enumerate(zip(stamps.tolist(), lengths, strict=True))
        )
