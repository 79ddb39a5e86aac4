"""The simulated laser tracer on the table, and the machine that carries its reflector.

The tracer has noise, spikes, drop-outs and a beam that is blocked at times. Its zero changes
whenever the beam was broken, and by a fringe when the counter slips.
"""

from __future__ import annotations

from math import dist, nan
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats, Stamps
from rotcal_ros.foundation.observations import (
    Command,
    LengthStatus,
    PointKind,
    ProbeSample,
    TracerSample,
)
from rotcal_ros.foundation.units import DEGREE, MICROMETRE, NANOSECOND
from rotcal_ros.methods.simulation.air import SimulatedAir, SimulatedTemperature
from rotcal_ros.methods.simulation.cell import Ticks
from rotcal_ros.methods.simulation.instrument import SimulatedInstrument, Table
from rotcal_ros.methods.simulation.motion import Motion, MotionLimits
from rotcal_ros.methods.simulation.noise import IndexedNoise, NoiseSource
from rotcal_ros.methods.tracer.settings import (
    FaultSettings,
    LengthsSimulationSettings,
    SimulatedReadingsSettings,
)

_FRINGE_UM: Final = 0.3164
"""Half a wavelength of a HeNe laser."""


class SimulatedTracer:
    """Turns true distances into readings; they are asked for in their order.

    Reading k depends on k, and its zero on how often the beam was broken before.
    """

    def __init__(
        self,
        settings: SimulatedReadingsSettings,
        faults: FaultSettings,
        seed: int,
        start_ns: int = 0,
    ) -> None:
        self.settings, self._faults = settings, faults
        shift_um = settings.zero_shift_um * np.random.default_rng([seed, start_ns]).normal()
        self._dead_distance_m = settings.dead_distance_m + shift_um * MICROMETRE
        self._noise = IndexedNoise(seed, NoiseSource.TRACER)
        self._spike = IndexedNoise(seed, NoiseSource.SPIKE)
        self._spike_sign = IndexedNoise(seed, NoiseSource.SPIKE_SIGN)
        self._dropout = IndexedNoise(seed, NoiseSource.DROPOUT)
        self._non_finite = IndexedNoise(seed, NoiseSource.NON_FINITE)
        self._break = IndexedNoise(seed, NoiseSource.BREAK)
        self._break_shift = IndexedNoise(seed, NoiseSource.BREAK_SHIFT)
        self._slip = IndexedNoise(seed, NoiseSource.SLIP)
        self._breaks, self._slips, self._dark = 0, 0, False

    def blocked(self, table_angles_deg: Floats, target: int) -> Bools:
        """Return whether the beam to ``target`` is blocked at the table angles (n,)."""
        faults = self._faults
        width = (faults.blocked_to_deg - faults.blocked_from_deg) % 360.0
        meant = faults.blocked_targets == (-1,) or target in faults.blocked_targets
        if not meant or faults.blocked_from_deg == faults.blocked_to_deg:
            return np.zeros(len(table_angles_deg), dtype=bool)
        inside: Bools = (table_angles_deg - faults.blocked_from_deg) % 360.0 <= width
        return inside

    def readings(
        self, first: int, stamps: Stamps, distances: Floats, drifts: Floats, broken: Floats
    ) -> tuple[TracerSample, ...]:
        """Return the readings number ``first`` and following that are not lost.

        ``distances`` (m), ``drifts`` (m, to be added) and ``broken`` (0 or 1) have shape (n,).
        """
        count, faults = len(stamps), self._faults
        if faults.break_probability > 0:
            hit = self._break.uniform(first, count) < faults.break_probability
            broken = np.maximum(broken, hit)
        std = (self.settings.noise_um + self.settings.noise_um_per_m * distances) * MICROMETRE
        length = distances - self._dead_distance_m + drifts
        length += std * self._noise.normal(first, count)
        length += self._zero_changes(first, broken > 0)
        if faults.spike_probability > 0:
            hit = self._spike.uniform(first, count) < faults.spike_probability
            sign = np.where(self._spike_sign.uniform(first, count) < 0.5, -1.0, 1.0)
            length += hit * sign * faults.spike_um * MICROMETRE
        if faults.non_finite_probability > 0:
            length[self._non_finite.uniform(first, count) < faults.non_finite_probability] = nan
        length[broken > 0] = nan
        rows = zip(stamps.tolist(), length.tolist(), std.tolist(), broken.tolist(), strict=True)
        lost = self._lost(first, count).tolist()
        return tuple(
            TracerSample(
                stamp,
                (first + number) % (1 << 32),
                value,
                deviation,
                LengthStatus.BEAM_BROKEN if dark else LengthStatus.OK,
            )
            for number, (stamp, value, deviation, dark) in enumerate(rows)
            if not lost[number]
        )

    def _zero_changes(self, first: int, broken: Bools) -> Floats:
        """Return by how much (n,) breaks and slips so far have changed the zero, m."""
        faults, count = self._faults, len(broken)
        back = np.append(self._dark, broken[:-1]) & ~broken
        breaks = self._breaks + np.cumsum(back)
        self._breaks, self._dark = int(breaks[-1]), bool(broken[-1])
        changes = np.zeros(count)
        if faults.break_shift_um > 0 and self._breaks:
            shifts = np.append(0.0, self._break_shift.normal(0, self._breaks))
            changes += faults.break_shift_um * np.cumsum(shifts)[breaks]
        if faults.slip_probability > 0:
            hit = self._slip.uniform(first, count) < faults.slip_probability
            slips = self._slips + np.cumsum(hit)
            self._slips = int(slips[-1])
            changes += _FRINGE_UM * slips
        return changes * MICROMETRE

    def _lost(self, first: int, count: int) -> Bools:
        """Return which of the readings fall into a drop-out."""
        length = self._faults.dropout_samples
        if self._faults.dropout_probability <= 0:
            return np.zeros(count, dtype=bool)
        before = min(first, length - 1)
        starts = self._dropout.uniform(first - before, count + before)
        hits = np.concatenate([[0], np.cumsum(starts < self._faults.dropout_probability)])
        number = np.arange(before, before + count)
        lost: Bools = hits[number + 1] > hits[np.maximum(number + 1 - length, 0)]
        return lost


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
        tracer, probe, seed = settings.tracer, settings.probe, settings.noise_seed
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
        self._target_noise = IndexedNoise(settings.seed, NoiseSource.TARGET)
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
