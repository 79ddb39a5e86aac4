"""The simulated rotary table: its motion, its feedback, and its true deviations.

Another program may move the table instead: the cell then follows the angle that it reports.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints, Stamps
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.observations import Approach, TableSample, Turn
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICROMETRE, NANOSECOND
from rotcal_ros.geometry.rotations import rotation_from_vector
from rotcal_ros.methods.simulation.motion import Motion, MotionLimits
from rotcal_ros.methods.simulation.noise import IndexedNoise, NoiseSource
from rotcal_ros.methods.simulation.settings import (
    AngularHarmonics,
    LinearHarmonics,
    SimulationSettings,
    TableSettings,
)


def harmonics(series: LinearHarmonics | AngularHarmonics, angles: Floats) -> Floats:
    """Return the sum of amplitude_k cos(k angle + phase_k) at ``angles`` (n,), in m or rad."""
    if isinstance(series, LinearHarmonics):
        parts = _parts(series.amplitudes_um, MICROMETRE, series.phases_deg)
    else:
        parts = _parts(series.amplitudes_arcsec, ARCSEC, series.phases_deg)
    orders, amplitudes, phases = parts
    return np.asarray(np.cos(np.multiply.outer(angles, orders) + phases) @ amplitudes)


@lru_cache(maxsize=64)
def _parts(
    amplitudes: tuple[float, ...], unit: float, phases_deg: tuple[float, ...]
) -> tuple[Ints, Floats, Floats]:
    """Return orders, amplitudes in m or rad, and phases in rad of a series, each (k,)."""
    phases = np.zeros(len(amplitudes))
    given = np.array(phases_deg[: len(amplitudes)]) * DEGREE
    phases[: len(given)] = given
    return np.arange(1, len(amplitudes) + 1), np.array(amplitudes) * unit, phases


def deviations(settings: TableSettings, angles: Floats) -> dict[str, Floats]:
    """Return the six deviations, actual - commanded (m, rad), at ``angles`` (n,).

    They refer to the fixed axes at the foot of the table axis: EAC, EBC are rotations about the
    fixed x and y. Valid for an approach with increasing angle.
    """
    return {name: harmonics(getattr(settings, name.lower()), angles) for name in COMPONENTS}


def rotations(rx: Floats, ry: Floats, rz: Floats) -> Floats:
    """Return the matrices Rz Ry Rx (n, 3, 3) for rotations (n,) about the fixed axes, rad."""
    cx, cy, cz = np.cos(rx), np.cos(ry), np.cos(rz)
    sx, sy, sz = np.sin(rx), np.sin(ry), np.sin(rz)
    rows = np.empty((3, 3, len(rx)))
    rows[0] = cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx
    rows[1] = sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx
    rows[2] = -sy, cy * sx, cy * cx
    return np.asarray(rows.transpose(2, 0, 1))


def table_poses(
    settings: TableSettings, angles: Floats, extra_angle: Floats | float = 0.0
) -> tuple[Floats, Floats]:
    """Return rotation (n, 3, 3) and translation (n, 3) from the table to the machine frame.

    A point q of the table stands at A (E Rz(angle + ECC) q + d) + o: E, the turn about (EAC, EBC,
    0), and d hold the deviations at ``angles`` (n,), A and o the tilt and the offset of the axis.
    ``extra_angle`` (rad) adds to the angular deviation (backlash, repeatability).
    """
    error = deviations(settings, angles)
    zero = np.zeros_like(angles)
    turn = rotations(zero, zero, angles + (error["ECC"] + extra_angle))
    lean = rotation_from_vector(np.column_stack([error["EAC"], error["EBC"], zero]))
    tilt = np.array(settings.axis_tilt_arcsec) * ARCSEC
    axis = rotations(tilt[:1], tilt[1:], np.zeros(1))[0]
    shift = np.column_stack([error["EXC"], error["EYC"], error["EZC"]])
    return axis @ lean @ turn, shift @ axis.T + np.array(settings.axis_offset_m)


def correction(settings: TableSettings, angles: Floats, approach: Approach) -> Floats:
    """Return what the control adds to the commanded ``angles`` (n,), rad."""
    rows = settings.compensation
    if not rows.angles_deg:
        return np.zeros_like(angles)
    # Solving a bag loads the simulated instrument, and needs no controller.
    from rotcal_ros.compensation import plain_csv

    table = plain_csv.CsvTable(
        angle_deg=np.array(rows.angles_deg),
        forward_arcsec=np.array(rows.forward_arcsec),
        reverse_arcsec=np.array(rows.reverse_arcsec),
    )
    return table.correction(angles, approach)


def true_deviations(settings: TableSettings, angles: Floats) -> Mapping[str, Floats]:
    """Return the true deviations at commanded ``angles`` (n,) as a result states them.

    With increasing angle, and with what the control corrects. ECC is relative to the first angle.
    """
    corrected = correction(settings, angles, Approach.POSITIVE)
    true = deviations(settings, angles + corrected)
    true["ECC"] = true["ECC"] + corrected
    true["ECC"] = true["ECC"] - true["ECC"][0]
    return true


class SimulatedTable:
    """A rotary table with trapezoidal speed, a lag that decays, and a direction of approach."""

    def __init__(self, settings: TableSettings, seed: int, start_ns: int) -> None:
        self.settings = settings
        self._limits = MotionLimits(
            speed=settings.speed_deg_s * DEGREE,
            acceleration=settings.acceleration_deg_s2 * DEGREE,
            lag=settings.settling_arcsec * ARCSEC,
            settling_time=settings.settling_time_s,
        )
        self._motion = Motion(start_ns, [settings.initial_angle_deg * DEGREE], self._limits)
        self._approach = Approach.POSITIVE
        self._arrivals, self._arrives, self._turning = 0, True, 0.0
        self._arrival_noise = IndexedNoise(seed, NoiseSource.ARRIVAL)
        self._motion_noise = IndexedNoise(seed, NoiseSource.ARRIVAL_MOTION)
        self._feedback_noise = IndexedNoise(seed, NoiseSource.FEEDBACK)
        self.rest_ns = start_ns

    def order(self, now_ns: int, angle: float, approach: Approach) -> None:
        """Go to ``angle`` (rad), reached from the side ``approach``."""
        here = float(self._motion.state(np.array([now_ns]))[0][0])
        resting, there = now_ns >= self._motion.end_ns, self._motion.place == angle
        if resting and there and approach in (self._approach, Approach.UNKNOWN):
            self.rest_ns = max(self.rest_ns, now_ns)
            return
        start = self._motion.place if resting else here
        places = [start, angle]
        overshoot = self.settings.overshoot_deg * DEGREE
        if approach == Approach.POSITIVE and angle <= start:
            places = [start, angle - overshoot, angle]
        elif approach == Approach.NEGATIVE and angle >= start:
            places = [start, angle + overshoot, angle]
        self._motion = Motion(now_ns, places, self._limits)
        self._approach = Approach.POSITIVE if places[-1] >= places[-2] else Approach.NEGATIVE
        self._arrivals, self._arrives, self._turning = self._arrivals + 1, True, 0.0
        self.rest_ns = self._motion.end_ns

    def turn(self, now_ns: int, turn: Turn) -> None:
        """Go to where a turn begins, then turn on to its end at its speed.

        No angle that it passes is an arrival: nothing scatters.
        """
        here = float(self._motion.state(np.array([now_ns]))[0][0])
        places = [here, turn.begin, turn.end]
        own = replace(self._limits, speed=min(abs(turn.speed), self._limits.speed))
        self._motion = Motion(now_ns, places, self._limits, own)
        self._approach = Approach.POSITIVE if turn.speed > 0.0 else Approach.NEGATIVE
        self._arrives, self._turning = False, own.speed
        self.rest_ns = self._motion.end_ns

    def stop(self, now_ns: int) -> None:
        """Stand still at once, wherever it is."""
        here = float(self._motion.state(np.array([now_ns]))[0][0])
        self._motion = Motion(now_ns, [here], self._limits)
        self._approach = Approach.UNKNOWN  # it came from neither side
        self._turning = 0.0
        self.rest_ns = now_ns

    def angles(self, stamps: Stamps) -> Floats:
        """Return the angle that the table believes to stand at, (n,) rad."""
        return self._state(stamps)[0]

    def _state(self, stamps: Stamps) -> tuple[Floats, Floats]:
        """Return angle and velocity at ``stamps`` (n,), with the ripple of a table that turns."""
        angles, velocities = self._motion.state(stamps)
        if not (self._turning and self.settings.ripple_arcsec):
            return angles, velocities
        turns = 2.0 * np.pi * self.settings.ripple_hz
        phase = turns * NANOSECOND * (stamps - self._motion.end_ns)
        size = self.settings.ripple_arcsec * ARCSEC * velocities / self._turning
        return angles + size * np.sin(phase), velocities + turns * size * np.cos(phase)

    def poses(self, stamps: Stamps) -> tuple[Floats, Floats]:
        """Return the actual poses at ``stamps``; see :func:`table_poses`."""
        extra = self.settings.repeatability_arcsec * ARCSEC
        extra *= self._arrives * float(self._arrival_noise.normal(self._arrivals, 1)[0])
        if self._approach == Approach.NEGATIVE:
            extra += self.settings.backlash_arcsec * ARCSEC
        angles = self.angles(stamps)
        angles = angles + correction(self.settings, angles, self._approach)
        rotation, shift = table_poses(self.settings, angles, extra)
        shift_um, tilt_as = self.settings.repeatability_um, self.settings.repeatability_tilt_arcsec
        if not self._arrives or not (shift_um or tilt_as):
            return rotation, shift
        drawn = self._motion_noise.normal(5 * self._arrivals, 5)  # of this arrival
        tilt = tilt_as * ARCSEC * drawn[3:, None]
        scatter = rotations(tilt[0], tilt[1], np.zeros(1))
        return scatter @ rotation, shift + shift_um * MICROMETRE * drawn[:3]

    def feedback(self, first: int, stamps: Stamps) -> tuple[TableSample, ...]:
        """Return the feedback number ``first`` and following at ``stamps``."""
        late_ns = round(self.settings.feedback_lag_s / NANOSECOND)
        angles, velocities = self._state(stamps - late_ns)
        noise = self.settings.feedback_noise_arcsec * ARCSEC
        angles = angles + noise * self._feedback_noise.normal(first, len(stamps))
        rows = zip(stamps.tolist(), angles.tolist(), velocities.tolist(), strict=True)
        return tuple(TableSample(*row) for row in rows)


def true_runs(settings: SimulationSettings, targets: Floats, runs: int) -> tuple[Floats, Floats]:
    """Return the true deviations (m, runs) rad at ``targets`` (m,), forward and reverse.

    Deviations, control, backlash and the spread from one arrival to the next are those of the
    settings; the spread is drawn with the settings' seed.
    """
    table = settings.table
    random = np.random.default_rng(settings.seed)
    both = []
    for approach, backlash in ((Approach.POSITIVE, 0.0), (Approach.NEGATIVE, 1.0)):
        corrected = correction(table, targets, approach)
        fixed = corrected + deviations(table, targets + corrected)["ECC"]
        fixed = fixed + backlash * table.backlash_arcsec * ARCSEC
        spread = table.repeatability_arcsec * ARCSEC * random.normal(size=(len(targets), runs))
        both.append(fixed[:, None] + spread)
    return both[0], both[1]


HISTORY: Final = 1000
"""Angles that are remembered; readings are never made further back than a fraction of these."""
AT_REST_RAD: Final = 1e-10
"""A smaller change of the angle is no motion."""


class ExternalTable:
    """Replaces a SimulatedTable; orders and feedback are left to the other program."""

    def __init__(self, settings: TableSettings, start_ns: int) -> None:
        self.settings = settings
        self._stamps = deque([start_ns], HISTORY)
        self._angles = deque([settings.initial_angle_deg * DEGREE], HISTORY)
        self.rest_ns = start_ns

    def follow(self, stamp_ns: int, angle: float) -> None:
        """Note the actual ``angle`` (rad) at ``stamp_ns``, later than the one before."""
        if abs(angle - self._angles[-1]) > AT_REST_RAD:
            self.rest_ns = stamp_ns
        self._stamps.append(stamp_ns)
        self._angles.append(angle)

    def order(self, now_ns: int, angle: float, approach: Approach) -> None:
        """Do nothing: the other program has heard the order too."""

    def turn(self, now_ns: int, turn: Turn) -> None:
        """Do nothing: the other program has heard the order too."""

    def stop(self, now_ns: int) -> None:
        """Do nothing: the other program has heard of the stop too."""

    def angles(self, stamps: Stamps) -> Floats:
        """Return the actual angles at ``stamps`` (n,), rad; the last one stays."""
        begin = self._stamps[0]
        times = np.array(self._stamps, dtype=np.int64) - begin
        return np.asarray(np.interp(stamps - begin, times, np.array(self._angles)))

    def poses(self, stamps: Stamps) -> tuple[Floats, Floats]:
        """Return the actual poses at ``stamps``; the settings' deviations come on top."""
        return table_poses(self.settings, self.angles(stamps))

    def feedback(self, first: int, stamps: Stamps) -> tuple[TableSample, ...]:
        """Return nothing."""
        return ()
