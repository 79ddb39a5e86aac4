"""The simulated machine that carries the reflector from target to target."""

from __future__ import annotations

from math import dist

import numpy as np

from rotcal_ros.arrays import Floats, Stamps
from rotcal_ros.catalogue.tracer.simulation_settings import SimulatedProbeSettings
from rotcal_ros.observations import Command, PointKind, ProbeSample, TracerSample
from rotcal_ros.simulation.motion import Limits, Motion
from rotcal_ros.simulation.noise import IndexedNoise, Source
from rotcal_ros.units import MICROMETRE, NANOSECOND


class SimulatedProbe:
    """A probe that moves on straight lines and misses every target a little.

    The machine reports where it believes to be: the ordered position and a following error.
    The reflector is elsewhere: by a systematic error, the same at each visit of a target, and
    by a random one of this arrival.
    """

    frame = "machine"
    streams_lengths = False

    def __init__(self, settings: SimulatedProbeSettings, seed: int, start_ns: int) -> None:
        self.settings = settings
        self._limits = Limits(
            speed=settings.speed_m_s,
            acceleration=settings.acceleration_m_s2,
            lag=settings.settling_um * MICROMETRE,
            settling_time=settings.settling_time_s,
        )
        self._target_noise = IndexedNoise(seed, Source.TARGET)
        self._repeat_noise = IndexedNoise(seed, Source.PROBE_REPEAT)
        self._following_noise = IndexedNoise(seed, Source.FOLLOWING)
        self._arrivals = 0
        self._ordered = settings.initial_position_m
        self._from = self._actual_to = self._reported = np.array(settings.initial_position_m)
        self._motion = Motion(start_ns, [0.0], self._limits)
        self._pending: Command | None = None
        self._sequence = 0
        self.target = -1
        self.rest_ns = start_ns

    @property
    def pending(self) -> Command | None:
        """The order whose point has not been reported yet."""
        return self._pending

    def order(self, now_ns: int, command: Command) -> None:
        """Go to the position of ``command`` and report it when there."""
        self._pending = command
        resting = now_ns >= self._motion.end_ns
        if not (resting and command.position == self._ordered and command.target == self.target):
            here = self.positions(np.array([now_ns]))[0]
            self._depart(now_ns, here, command)
        self.rest_ns = max(now_ns, self._motion.end_ns)

    def positions(self, stamps: Stamps) -> Floats:
        """Return the actual positions (n, 3) of the reflector, m, machine frame."""
        way = self._actual_to - self._from
        length = float(np.linalg.norm(way))
        if length == 0:
            return np.tile(self._actual_to, (len(stamps), 1))
        travelled = self._motion.state(stamps)[0]
        positions: Floats = self._from + np.multiply.outer(travelled / length, way)
        return positions

    def report(self, after_ns: int, now_ns: int, table_rest_ns: int) -> tuple[ProbeSample, ...]:
        """Return the point of the pending order when it falls in ``after_ns`` < t <= ``now_ns``.

        A reflector just stands there; any other kind is measured with the table at rest.
        """
        command = self._pending
        if command is None:
            return ()
        ready = self.rest_ns
        if command.kind != PointKind.REFLECTOR:
            ready = max(ready, table_rest_ns)
        stamp = max(ready + round(self.settings.report_delay_s / NANOSECOND), after_ns + 1)
        if stamp > now_ns:
            return ()
        self._pending = None
        self._sequence += 1
        return (self._sample(stamp, command),)

    def lengths(self, _now_ns: int) -> tuple[TracerSample, ...]:
        """Return nothing: only points are measured."""
        return ()

    def unasked(self, now_ns: int) -> ProbeSample:
        """Return where the machine believes the probe to be, as a point of kind UNKNOWN."""
        x, y, z = self.positions(np.array([now_ns]))[0].tolist()
        self._sequence += 1
        return ProbeSample(
            stamp_ns=now_ns,
            sequence=self._sequence - 1,
            step=0,
            attempt=0,
            kind=PointKind.UNKNOWN,
            target=0,
            station=0,
            point=0,
            position=(x, y, z),
            position_std=(0.0, 0.0, 0.0),
            tip_radius=0.0,
        )

    def _depart(self, now_ns: int, here: Floats, command: Command) -> None:
        self._arrivals += 1
        settings, order = self.settings, np.array(command.position)
        self._reported = order + settings.following_um * MICROMETRE * _triple(
            self._following_noise, self._arrivals
        )
        missed = settings.systematic_um * _triple(self._target_noise, command.target)
        missed = missed + settings.repeatability_um * _triple(self._repeat_noise, self._arrivals)
        self._from, self._actual_to = here, self._reported + missed * MICROMETRE
        self._motion = Motion(now_ns, [0.0, dist(self._from, self._actual_to)], self._limits)
        self._ordered, self.target = command.position, command.target

    def _sample(self, stamp_ns: int, command: Command) -> ProbeSample:
        x, y, z = self._reported.tolist()
        std = float(np.hypot(self.settings.systematic_um, self.settings.repeatability_um))
        return ProbeSample(
            stamp_ns=stamp_ns,
            sequence=self._sequence - 1,
            step=command.step,
            attempt=command.attempt,
            kind=command.kind,
            target=command.target,
            station=0,
            point=0,
            position=(x, y, z),
            position_std=(std * MICROMETRE,) * 3,
            tip_radius=0.0,
        )


def _triple(noise: IndexedNoise, number: int) -> Floats:
    return noise.normal(3 * number, 3)
