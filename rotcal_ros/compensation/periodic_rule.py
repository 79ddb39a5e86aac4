"""The rule of most controls: linear between the rows of one turn, the same in every turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import DEGREE


def periodic(angle: Floats, rows_deg: Floats, values: Floats | Ints) -> Floats:
    """Interpolate ``values`` at ``rows_deg`` 0 .. 360 linearly at ``angle`` (rad) of any turn."""
    within = np.mod(np.asarray(angle) / DEGREE, 360.0)
    return np.asarray(np.interp(within, rows_deg, values), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class PeriodicTable:
    """The numbers (n,) that ``file`` holds for each direction at rows (n,) 0 .. 360 deg.

    The correction is ``unit`` (rad) times the number; ``unit`` is negative when the file holds
    actual - commanded. Raises BagError unless the rows ascend from 0 to 360 and the table closes.
    """

    file: str
    rows_deg: Floats
    forward: Floats | Ints
    reverse: Floats | Ints
    unit: float

    def __post_init__(self) -> None:
        rows = self.rows_deg
        if len(rows) < 2 or np.any(np.diff(rows) <= 0.0) or (rows[0], rows[-1]) != (0.0, 360.0):
            raise BagError(f"{self.file}: expected positions that ascend from 0 to 360 deg")
        for column in (self.forward, self.reverse):
            if len(column) != len(rows):
                raise BagError(f"{self.file}: {len(column)} values for {len(rows)} positions")
            if column[0] != column[-1]:
                raise BagError(
                    f"{self.file} does not close: it holds {column[0]} at 0 and {column[-1]} at "
                    "360 deg, expected the same"
                )

    def correction(self, angle: Floats, approach: Approach) -> Floats:
        """Return the radians that the control adds to the command at ``angle`` (rad)."""
        column = self.forward if approach is Approach.POSITIVE else self.reverse
        return periodic(angle, self.rows_deg, column) * self.unit
