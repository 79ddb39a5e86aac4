"""Looking the correction up, for software that compensates by itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.curves.interpolation import curve_through, within
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.observations import Approach


class Correction:
    """The correction as a function of angle and direction; it is added to the command.

    A smooth curve through every row of the table: the periodic cubic spline, any angle is
    allowed, for a full circle; for an arc the cubic spline inside it, and DataError outside.

    >>> Correction(table)(angle, Approach.NEGATIVE)        # radians in, radians out
    """

    def __init__(self, table: CompensationTable) -> None:
        self.table = table
        self._curves = {
            Approach.POSITIVE: curve_through(table.angles, table.correction_forward, table.period),
            Approach.NEGATIVE: curve_through(table.angles, table.correction_reverse, table.period),
        }

    def __call__(self, angle: ArrayLike, approach: Approach) -> Floats:
        """Return the correction (rad), of the shape of ``angle`` (rad)."""
        if approach not in self._curves:
            raise ConfigurationError(
                f"direction {approach!r}: a correction needs to know from which side the table "
                "comes, POSITIVE (angle increasing) or NEGATIVE"
            )
        at = within(self.table.angles, angle, self.table.period)
        return np.asarray(self._curves[approach](at), dtype=np.float64)

    def std(self, angle: ArrayLike, approach: Approach = Approach.POSITIVE) -> Floats:
        """Return the standard uncertainty (rad, k = 1), linear between the rows."""
        angles, period = self.table.angles, self.table.period
        at, std = within(angles, angle, period), self.table.std_of(approach)
        return np.asarray(np.interp(at, angles, std, period=period or None))
