"""A simulated interferometer whose indexer turns back by what was commanded."""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.observations import Command
from rotcal_ros.geometry.rotations import wrap_angle
from rotcal_ros.methods.simulation.air import SimulatedTemperature
from rotcal_ros.methods.simulation.instrument import AngleReader, Table
from rotcal_tables.deviations.settings import DeviationSimulationSettings

READING: Final = 1101
"""Its stream of random numbers; those below 1000 belong to rotcal_ros."""


class SimulatedIndexer(AngleReader):
    """Reads how much farther the table has turned than was commanded."""

    frame = "indexer"

    def __init__(
        self,
        settings: DeviationSimulationSettings,
        table: Table,
        _temperature: SimulatedTemperature,
        start_ns: int,
    ) -> None:
        super().__init__(settings.reader, settings.noise_seed, READING, start_ns)
        self._table = table

    def true_reading(self, stamp_ns: int, order: Command) -> Floats:
        """Return the true deviation, and 0, rad."""
        pose = self._table.poses(np.array([stamp_ns]))[0][0]
        return np.array([wrap_angle(np.arctan2(pose[1, 0], pose[0, 0]) - order.table_angle), 0.0])
