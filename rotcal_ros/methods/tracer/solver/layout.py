"""Where the unknowns of stations and zeros stand in the vector that a network is solved for.

A zero per station: (X, Y, Z, d) station by station. Shared zeros, or stations on a circle: the
coordinates of all stations, then all zeros; a strip finds its coordinates and its zero by index.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.methods.tracer.solver.grid import Grid


@dataclass(frozen=True, eq=False)
class UnknownsLayout:
    """The places of the unknowns of m stations and s zeros, as p strips see them.

    ``index`` (p, 4): places of (X, Y, Z, d) of a strip among ``size`` unknowns; ``places`` (3 m,):
    those of all coordinates, station by station. ``first_strip`` (m,), ``first_of_zero`` (s,).
    ``tension`` (s, s): inverse covariance of zeros that wander, 1/m^2; None: they do not.
    ``walk`` (s,): as in the grid.
    """

    index: Ints
    size: int
    places: Ints
    shared: bool
    first_strip: Ints
    first_of_zero: Ints
    tension: Floats | None
    walk: Floats | None = None

    @classmethod
    def of(cls, grid: Grid) -> UnknownsLayout:
        """Return the layout of a grid."""
        m = grid.n_stations
        if grid.zero is None and grid.circle_std is None:
            index, each = np.arange(4 * m).reshape(m, 4), np.arange(m)
            return cls(index, 4 * m, index[:, :3].ravel(), False, each, each, None)
        of_station = 3 * grid.station[:, None] + np.arange(3)
        return cls(
            index=np.column_stack(
                [of_station, 3 * m + (grid.station if grid.zero is None else grid.zero)]
            ),
            size=3 * m + grid.n_zeros,
            places=np.arange(3 * m),
            shared=True,
            first_strip=grid.first_strip,
            first_of_zero=grid.first_of_zero,
            tension=None if grid.walk is None else _tension(grid.walk),
            walk=grid.walk,
        )

    def stretch(self, zeros: Floats) -> tuple[Floats, Floats]:
        """Return steps of ``zeros`` (..., s) in standard deviations, and their pull (..., s).

        From the differences: their squares would drown in those of the zeros.
        """
        assert self.walk is not None
        steps = np.diff(zeros, axis=-1) / self.walk[:-1]
        tight = steps / self.walk[:-1]
        pull = np.zeros_like(zeros)
        pull[..., :-1] -= tight
        pull[..., 1:] += tight
        return steps, pull

    def collect(self, of_strips: Floats) -> Floats:
        """Return gradients (..., p, 4) of the strips as one (..., size) of the unknowns."""
        flat = of_strips.reshape(*of_strips.shape[:-2], -1)
        if not self.shared:
            return flat
        total = np.zeros((self.size, *flat.shape[:-1]))
        np.add.at(total, self.index.ravel(), np.moveaxis(flat, -1, 0))
        return np.moveaxis(total, 0, -1)

    def gather(
        self, blocks: Floats, targets: Floats, cross: Floats, circle: Floats | None = None
    ) -> tuple[Floats, Floats, Floats]:
        """Return the normal matrix of the unknowns from blocks (p, 4, 4) and (4 p, 3 n).

        ``circle`` (c, 3 m): slopes of what else is observed of the stations, in its standard
        deviations.
        """
        kept = np.zeros((self.size, self.size))
        np.add.at(kept, (self.index[:, :, None], self.index[:, None, :]), blocks)
        if circle is not None:
            kept[np.ix_(self.places, self.places)] += circle.T @ circle
        if self.tension is not None:
            zeros = slice(len(self.places), None)
            kept[zeros, zeros] += self.tension
        idle = np.flatnonzero(kept.diagonal() == 0.0)  # zeros that lost all their lengths
        kept[idle, idle] = 1.0
        together = np.zeros((self.size, cross.shape[1]))
        np.add.at(together, self.index.ravel(), cross)
        return kept, targets, together

    def with_zeros(self, motions: Floats) -> Floats:
        """Insert the zeros, which these motions of the stations do not change: (3 m, c)."""
        full = np.zeros((self.size, motions.shape[1]))
        full[self.places] = motions
        return full


def _tension(walk: Floats) -> Floats:
    """Return the inverse covariance (s, s) of zeros whose steps have the deviations ``walk``."""
    pull = np.append(walk[:-1] ** -2.0, 0.0)
    tension = np.diag(pull + np.roll(pull, 1))
    tension -= np.diag(pull[:-1], 1) + np.diag(pull[:-1], -1)
    return np.asarray(tension, dtype=np.float64)
