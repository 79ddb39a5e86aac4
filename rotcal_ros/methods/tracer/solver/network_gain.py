"""Gauss-Newton steps of one network for many gradients at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.methods.tracer.solver.layout import UnknownsLayout
from rotcal_ros.methods.tracer.solver.network import Network
from rotcal_ros.methods.tracer.solver.schur import SchurComplement


@dataclass(frozen=True, eq=False)
class NetworkGain:
    """The variant "joint": the kept covariance, and the way back to the eliminated side."""

    kept: Floats
    reduced: SchurComplement
    stations_kept: bool
    layout: UnknownsLayout

    @classmethod
    def of(cls, network: Network) -> NetworkGain:
        """Return the gain of a network."""
        covariance = network.reduced.covariance()
        return cls(covariance, network.reduced, network.stations_kept, network.layout)

    def step(self, station: Floats, target: Floats) -> tuple[Floats, Floats]:
        """Return the Gauss-Newton steps, to be subtracted, for gradients (t, p, 4), (t, n, 3)."""
        a, b = self.layout.collect(station), target.reshape(len(target), -1)
        kept, other = (a, b) if self.stations_kept else (b, a)
        blocks = len(self.reduced.inverse)
        x = (kept - other @ self.reduced.transfer.T) @ self.kept
        own = np.einsum("qab,tqb->tqa", self.reduced.inverse, other.reshape(len(x), blocks, -1))
        y = own.reshape(other.shape) - x @ self.reduced.transfer
        a, b = (x, y) if self.stations_kept else (y, x)
        return a[:, self.layout.index], b.reshape(target.shape)
