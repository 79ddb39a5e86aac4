"""What an adjustment of lengths returns, whichever variant made it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from rotcal_ros.adjust.low_rank import LowRank
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.methods.tracer.solver.grid import Grid

if TYPE_CHECKING:
    from rotcal_ros.methods.tracer.solver.network import Network

MINIMAL_REDUNDANCY: Final = 1e-6
"""Below this share a length is checked by nothing: its test value is zero."""


@dataclass(frozen=True, eq=False)
class Adjustment:
    """Stations, distances and targets that fit the lengths of a grid, and how well they do.

    ``stations`` (m, 3), ``distances`` (p,): the range of a strip at reading zero, ``targets``
    (n, 3), metres; m stations have p strips, see :class:`~.grid.Grid`.
    ``residual`` (p, n): observed - computed (the paper's v of Eq. 3 is computed - observed), also
    of lengths that were not used. ``std`` (p, n): standard deviation of a length as this
    variant sees it; ``redundancy`` (p, n): share of a length that the others check, zero if
    unused. ``chi2`` has mean ``dof``. ``unknowns`` counts the columns of the design matrix,
    ``rank`` those that the data determine.

    Where the targets' coordinates are observations too: ``corrections`` (n, 3) in their standard
    deviations, ``target_redundancy`` (n, 3), ``coupling`` (3, 3): squared sums of the redundancy
    matrix by pairs of axes, and ``target_test`` (n,): the largest normalised correction of a
    target. Else all zero. ``circle_coupling`` (4,): the same sums of a stated circle with the
    targets' axes, and with the lengths. ``network``: the linearisation at this very place, if
    there is one.
    ``strip_station`` (p,): station of each strip; None: strips are stations.
    """

    stations: Floats
    distances: Floats
    targets: Floats
    residual: Floats
    std: Floats
    redundancy: Floats
    chi2: float
    dof: int
    unknowns: int
    rank: int
    target_test: Floats
    corrections: Floats
    target_redundancy: Floats
    coupling: Floats
    network: Network | None = None
    strip_station: Ints | None = None
    circle_coupling: Floats = field(default_factory=lambda: np.zeros(4))

    @property
    def standing(self) -> Floats:
        """Where the station of each strip is, (p, 3)."""
        return self.stations if self.strip_station is None else self.stations[self.strip_station]

    @property
    def state(self) -> Floats:
        """Stations and distances of all strips as (p, 4), the start of the next solve."""
        return np.column_stack([self.standing, self.distances])

    @property
    def test_value(self) -> Floats:
        """Normalised residuals (p, n): residual over its own standard deviation."""
        checked = self.redundancy > MINIMAL_REDUNDANCY
        spread = self.std * np.sqrt(np.where(checked, self.redundancy, 1.0))
        return np.where(checked, self.residual / spread, 0.0)


class Adjuster(Protocol):
    """An adjustment of a grid from stations and distances of its strips (p, 4)."""

    def __call__(self, grid: Grid, start: Floats, targets: Floats | None = None) -> Adjustment:
        """Adjust ``grid``; ``targets`` (n, 3) of a network that was solved nearly so before."""


@dataclass(frozen=True, eq=False)
class StationCovariance:
    """Covariance (3 m, 3 m) of the stations in m^2, by source, in blocks of stations.

    ``lengths``: noise of the lengths, ``targets``: errors of the machine's coordinates, common to
    all stations; ``sensitivity`` (3 m, n, 3): what a standard error of each coordinate does to the
    stations, m. ``circle``: by how much stations leave a stated circle; None: none is.
    ``dof_effective``: the chi-squared sum is distributed like ``dof / dof_effective`` times
    chi-squared of that many degrees of freedom.
    """

    lengths: LowRank
    targets: LowRank
    sensitivity: Floats
    dof_effective: float
    circle: LowRank | None = None

    @property
    def total(self) -> LowRank:
        """Return the covariance from all sources."""
        total = self.lengths + self.targets
        return total if self.circle is None else total + self.circle

    def enlarged(self, scale: float) -> StationCovariance:
        """Return the covariance of standard deviations ``scale`` times as large."""
        square = scale**2
        circle = None if self.circle is None else self.circle.scaled(square)
        return replace(
            self,
            lengths=self.lengths.scaled(square),
            targets=self.targets.scaled(square),
            circle=circle,
        )

    def position_blocks(self) -> Floats:
        """Return the 3 by 3 covariance of every station, shape (m, 3, 3)."""
        return self.total.diagonal_blocks()


def ranges(stations: Floats, targets: Floats) -> tuple[Floats, Floats]:
    """Return distances (m, n) and unit vectors (m, n, 3) from ``targets`` to ``stations``."""
    difference = stations[:, None, :] - targets
    distance = np.sqrt(np.einsum("jia,jia->ji", difference, difference))
    return distance, difference / distance[:, :, None]
