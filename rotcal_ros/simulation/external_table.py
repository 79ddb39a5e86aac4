"""A table that another program moves: the cell follows the actual angle that it reports."""

from __future__ import annotations

from collections import deque
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Stamps
from rotcal_ros.foundation.observations import Approach, TableSample
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.simulation.settings import TableSettings
from rotcal_ros.simulation.table import table_poses

HISTORY: Final = 1000
"""Angles that are remembered; readings are never made further back than a fraction of these."""
AT_REST_RAD: Final = 1e-10
"""A smaller change of the angle is no motion."""


class ExternalTable:
    """Stands in for a SimulatedTable; orders and feedback are the other program's matter."""

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

    def stop(self, now_ns: int) -> None:
        """Do nothing: the other program has heard of the stop too."""

    def angles(self, stamps: Stamps) -> Floats:
        """Return the actual angles at ``stamps`` (n,), rad; the last one known goes on."""
        begin = self._stamps[0]
        known = np.array(self._stamps, dtype=np.int64) - begin
        found: Floats = np.interp(stamps - begin, known, np.array(self._angles))
        return found

    def poses(self, stamps: Stamps) -> tuple[Floats, Floats]:
        """Return the actual poses at ``stamps``; the settings' deviations come on top."""
        return table_poses(self.settings, self.angles(stamps))

    def feedback(self, first: int, stamps: Stamps) -> tuple[TableSample, ...]:
        """Return nothing."""
        return ()
