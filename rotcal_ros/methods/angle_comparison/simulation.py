"""The simulated reference, and what reads the angle between it and the table."""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.observations import Command
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.geometry.rotations import wrap_angle
from rotcal_ros.methods.angle_comparison.settings import SIGNS, ComparisonSimulationSettings
from rotcal_ros.methods.simulation.air import SimulatedTemperature
from rotcal_ros.methods.simulation.instrument import AngleReader, Table
from rotcal_ros.methods.simulation.noise import IndexedNoise, NoiseSource
from rotcal_ros.methods.simulation.table import harmonics

PER_TURN: Final = 1296000
"""Marks that can be distinguished: one for each second of arc."""


class SimulatedComparison(AngleReader):
    """Reads how much farther the table has turned than the reference shows."""

    frame = "reference"

    def __init__(
        self,
        settings: ComparisonSimulationSettings,
        table: Table,
        _temperature: SimulatedTemperature,
        start_ns: int,
    ) -> None:
        seed = settings.noise_seed
        super().__init__(settings.reader, seed, NoiseSource.REFERENCE_READING, start_ns)
        self._reference, self._table = settings.reference, table
        self._marks = IndexedNoise(settings.seed, NoiseSource.REFERENCE_MARK)
        aligned = IndexedNoise(seed, NoiseSource.REFERENCE_SETTING)
        count, scatter = len(self._reference.shifts_deg), self._reference.setting_arcsec * ARCSEC
        self._zero = scatter * aligned.normal(0, count)

    def reference_error(self, shown: float) -> float:
        """Return the true error (rad) of the reference at the angle ``shown``, rad."""
        own = self._marks.normal(round(shown / (2.0 * np.pi) * PER_TURN) % PER_TURN, 1)
        smooth = harmonics(self._reference.errors, np.array([shown]))
        return float(smooth[0] + self._reference.mark_arcsec * ARCSEC * own[0])

    def true_reading(self, stamp_ns: int, order: Command) -> Floats:
        """Return the true reading and 0, rad; the reference stands where the table is ordered."""
        setting = order.station % len(self._zero)
        shown = order.table_angle - self._reference.shifts_deg[setting] * DEGREE
        pose = self._table.poses(np.array([stamp_ns]))[0][0]
        ahead = wrap_angle(np.arctan2(pose[1, 0], pose[0, 0]) - order.table_angle)
        sign = SIGNS[self._reference.readings_count]
        return np.array([sign * (ahead - self.reference_error(shown) + self._zero[setting]), 0.0])
