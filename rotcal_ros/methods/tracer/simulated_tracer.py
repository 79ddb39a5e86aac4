"""The simulated laser tracer: noise, spikes, drop-outs and a beam that is blocked at times.

The zero changes whenever the beam was broken, and by a fringe when the counter slips.
"""

from __future__ import annotations

from math import nan
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats, Stamps
from rotcal_ros.foundation.observations import LengthStatus, TracerSample
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.methods.tracer.simulation_settings import (
    FaultSettings,
    SimulatedReadingsSettings,
)
from rotcal_ros.simulation.noise import IndexedNoise, NoiseSource

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
