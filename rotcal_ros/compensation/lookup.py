"""Looking the correction up, for software that compensates by itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline, PPoly

from rotcal_ros.arrays import Floats
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.curves.interpolation import TURN, refuse_outside
from rotcal_ros.errors import ConfigurationError
from rotcal_ros.observations import Approach


class Correction:
    """The correction as a function of angle and direction; it is added to the command.

    A smooth curve through every row of the table: the periodic cubic spline, any angle is
    allowed, for a full circle; for an arc the cubic spline inside it, and DataError outside.

    >>> Correction(table)(angle, Approach.NEGATIVE)        # radians in, radians out
    """

    def __init__(self, table: CompensationTable) -> None:
        self.table = table
        self._spline = {
            Approach.POSITIVE: _spline(table, table.correction_forward),
            Approach.NEGATIVE: _spline(table, table.correction_reverse),
        }

    def __call__(self, angle: ArrayLike, approach: Approach) -> Floats:
        """Return the correction (rad), of the shape of ``angle`` (rad)."""
        if approach not in self._spline:
            raise ConfigurationError(
                f"direction {approach!r}: a correction needs to know from which side the table "
                "comes, POSITIVE (angle increasing) or NEGATIVE"
            )
        return np.asarray(self._spline[approach](self._inside(angle)), dtype=np.float64)

    def std(self, angle: ArrayLike) -> Floats:
        """Return the standard uncertainty (rad, k = 1), linear between the rows."""
        knots = _closed(self.table, self.table.angles, self.table.period)
        column = _closed(self.table, self.table.std, 0.0)
        return np.asarray(np.interp(self._inside(angle), knots, column), dtype=np.float64)

    def _inside(self, angle: ArrayLike) -> Floats:
        at = np.asarray(angle, dtype=np.float64)
        first = self.table.angles[0]
        if self.table.closed:
            return np.asarray(first + np.mod(at - first, TURN), dtype=np.float64)
        refuse_outside(self.table.angles, np.atleast_1d(at))
        return at


def _spline(table: CompensationTable, column: Floats) -> PPoly:
    knots = _closed(table, table.angles, table.period)
    values = _closed(table, column, 0.0)
    if table.closed and len(column) > 2:
        return CubicSpline(knots, values, bc_type="periodic")
    if table.closed:
        slope = np.diff(values) / np.diff(knots)
        return PPoly(np.vstack([slope, values[:-1]]), knots)
    return CubicSpline(knots, values, bc_type="not-a-knot")


def _closed(table: CompensationTable, column: Floats, step: float) -> Floats:
    return np.append(column, column[0] + step) if table.closed else column
