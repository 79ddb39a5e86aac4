"""The simulated levels on the simulated table."""

from __future__ import annotations

import numpy as np

from rotcal_level.settings import LevelSimulationSettings
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.observations import Command
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.methods.simulation.air import SimulatedTemperature
from rotcal_ros.methods.simulation.instrument import AngleReader, Table
from rotcal_ros.methods.simulation.noise import IndexedNoise

AZIMUTH, ZERO, READING = 1001, 1002, 1003
"""Streams of random numbers; those below 1000 belong to rotcal_ros."""


class SimulatedLevels(AngleReader):
    """Read how much higher the end is to which they point, by the true pose of the table."""

    frame = "level"

    def __init__(
        self,
        settings: LevelSimulationSettings,
        table: Table,
        _temperature: SimulatedTemperature,
        start_ns: int,
    ) -> None:
        own, seed = settings.levels, settings.noise_seed
        super().__init__(settings.reader, seed, READING, start_ns)
        count = len(own.azimuths_deg)
        self._table = table
        self.placed = own.placing_deg * DEGREE * IndexedNoise(seed, AZIMUTH).normal(0, count)
        self._azimuths = np.array(own.azimuths_deg) * DEGREE + self.placed
        self._zeros = own.zero_arcsec * ARCSEC * IndexedNoise(seed, ZERO).normal(0, count)

    def true_reading(self, stamp_ns: int, order: Command) -> Floats:
        """Return the true reading of the level ``order.target``, and 0, rad."""
        level = order.target % len(self._zeros)
        x, y, _ = self._table.poses(np.array([stamp_ns]))[0][0][2]  # how high its axes point
        azimuth = self._azimuths[level]
        slope = np.arcsin(x * np.cos(azimuth) + y * np.sin(azimuth))
        return np.array([slope + self._zeros[level], 0.0])
