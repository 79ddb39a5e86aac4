"""The simulated laser tracer: noise, spikes, drop-outs and a beam that is blocked at times."""

from __future__ import annotations

from math import nan

import numpy as np

from rotcal_ros.arrays import Bools, Floats, Stamps
from rotcal_ros.catalogue.tracer.simulation_settings import (
    FaultSettings,
    SimulatedReadingsSettings,
)
from rotcal_ros.observations import LengthStatus, TracerSample
from rotcal_ros.simulation.noise import IndexedNoise, Source
from rotcal_ros.units import MICROMETRE


class SimulatedTracer:
    """Turns true distances into readings; reading k depends on k, never on earlier calls."""

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
        self._noise = IndexedNoise(seed, Source.TRACER)
        self._spike = IndexedNoise(seed, Source.SPIKE)
        self._spike_sign = IndexedNoise(seed, Source.SPIKE_SIGN)
        self._dropout = IndexedNoise(seed, Source.DROPOUT)
        self._non_finite = IndexedNoise(seed, Source.NON_FINITE)

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
        std = (self.settings.noise_um + self.settings.noise_um_per_m * distances) * MICROMETRE
        length = distances - self._dead_distance_m + drifts
        length += std * self._noise.normal(first, count)
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
