"""The laser tracer on the table and the machine that carries its reflector, as one instrument."""

from __future__ import annotations

from math import dist

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Stamps
from rotcal_ros.foundation.observations import Command, PointKind, ProbeSample, TracerSample
from rotcal_ros.foundation.units import DEGREE, MICROMETRE, NANOSECOND
from rotcal_ros.methods.tracer.simulated_tracer import SimulatedTracer
from rotcal_ros.methods.tracer.simulation_settings import LengthsSimulationSettings
from rotcal_ros.simulation.air import SimulatedAir, SimulatedTemperature
from rotcal_ros.simulation.cell import Ticks
from rotcal_ros.simulation.instrument import SimulatedInstrument, Table
from rotcal_ros.simulation.motion import Motion, MotionLimits
from rotcal_ros.simulation.noise import IndexedNoise, NoiseSource


class TracerAndReflector(SimulatedInstrument):
    """A reflector on a probe that moves on straight lines, and the tracer that measures to it.

    The tracer rides on the table. The machine reports where it believes the probe to be: the
    ordered position and a following error. The reflector is elsewhere: by a systematic error, the
    same at each visit of a target, and by a random one of this arrival.
    """

    streams_lengths = True

    def __init__(
        self,
        settings: LengthsSimulationSettings,
        mount_m: tuple[float, float, float],
        table: Table,
        temperature: SimulatedTemperature,
        start_ns: int,
    ) -> None:
        super().__init__(start_ns)
        tracer, probe, seed = settings.tracer, settings.probe, settings.seed
        self._table, self._temperature = table, temperature
        self._air = SimulatedAir(settings.air, temperature, seed, start_ns)
        self._mount = np.array(mount_m)
        self._zero_m = 0.0
        self._tracer = SimulatedTracer(tracer, settings.faults, seed, start_ns)
        self._ticks = Ticks(start_ns, tracer.rate_hz)
        self.settings = probe
        self._limits = MotionLimits(
            speed=probe.speed_m_s,
            acceleration=probe.acceleration_m_s2,
            lag=probe.settling_um * MICROMETRE,
            settling_time=probe.settling_time_s,
        )
        self._target_noise = IndexedNoise(seed, NoiseSource.TARGET)
        self._repeat_noise = IndexedNoise(seed, NoiseSource.PROBE_REPEAT)
        self._following_noise = IndexedNoise(seed, NoiseSource.FOLLOWING)
        self._arrivals = 0
        self._ordered = probe.initial_position_m
        self._from = self._actual_to = self._reported = np.array(self._ordered)
        self._motion = Motion(start_ns, [0.0], self._limits)
        self.target = -1

    def order(self, now_ns: int, command: Command) -> None:
        """Go to the position of ``command`` and report it when there."""
        self.pending = command
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
        command = self.pending
        if command is None:
            return ()
        ready = self.rest_ns
        if command.kind != PointKind.REFLECTOR:
            ready = max(ready, table_rest_ns)
        stamp = max(ready + round(self.settings.report_delay_s / NANOSECOND), after_ns + 1)
        if stamp > now_ns:
            return ()
        self.pending = None
        std = float(np.hypot(self.settings.systematic_um, self.settings.repeatability_um))
        return (self.point(stamp, command, self._reported, std * MICROMETRE),)

    def distances(self, stamps: Stamps) -> Floats:
        """Return the true distances (n,) from the tracer to the reflector, m."""
        rotation, translation = self._table.poses(stamps)
        station = rotation @ self._mount + translation
        distances: Floats = np.linalg.norm(self.positions(stamps) - station, axis=1)
        return distances

    def lengths(self, now_ns: int) -> tuple[TracerSample, ...]:
        """Return the readings since the call before."""
        first, stamps = self._ticks.until(now_ns)
        if not len(stamps):
            return ()
        distances = self.distances(stamps)
        drifts = self._temperature.length_change(stamps, distances) + self._zero_m
        if self._air.settings.vacuum_lengths:
            drifts += (self._air.index(stamps) - 1.0) * distances
        angles_deg = self._table.angles(stamps) / DEGREE
        broken = self._tracer.blocked(angles_deg, self.target)
        return self._tracer.readings(first, stamps, distances, drifts, broken.astype(float))

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


def _triple(noise: IndexedNoise, number: int) -> Floats:
    return noise.normal(3 * number, 3)
