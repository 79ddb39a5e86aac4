"""How lengths of a network hang together: which share of each others check, what an error does.

A length touches one station and one target. Where stations are many, tied by nothing but targets,
all that lengths of a station have to do with others goes by way of the targets: the covariance is
never made as a whole.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from rotcal_ros.adjust.low_rank import LowRank, Slopes
from rotcal_ros.adjust.sensitivity import Sensitivity
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.methods.tracer.solver.network import Network


class LengthView(Protocol):
    """The linear view at a network, by the lengths of e places: their strips and targets (e,)."""

    def leverage(self, strip: Ints, target: Ints) -> Floats:
        """Return the covariance (e, e) of the adjusted lengths, m^2."""

    def sensitivity(self, strip: Ints, target: Ints) -> Sensitivity:
        """Return what the outputs are off by for a unit of each length over its variance."""

    def cofactor(self, strip: Ints, target: Ints, unit: Floats) -> LowRank:
        """Return the residual cofactor of lengths of one target, with 1 / std ``unit`` (e,)."""


def view_of(network: Network, outputs: Slopes) -> LengthView:
    """Return the view at ``network``; ``outputs`` (m, 3 m): slopes by the stations."""
    if network.stations_kept or network.targets.size > len(network.state):
        return _Whole(network, outputs)
    return _Apart(network, outputs)


@dataclass(frozen=True, eq=False)
class _Whole:
    """By the covariance of all unknowns."""

    network: Network
    outputs: Slopes

    @cached_property
    def covariance(self) -> Floats:
        """The covariance of stations and zeros, then of targets."""
        reduced = self.network.reduced
        kept = reduced.covariance()
        mixed = -(kept @ reduced.transfer)
        other = reduced.other_times(kept, np.eye(mixed.shape[1]))
        if self.network.stations_kept:
            return np.block([[kept, mixed], [mixed.T, other]])
        return np.block([[other, mixed.T], [mixed, kept]])

    @cached_property
    def carried(self) -> Floats:
        """The outputs' slopes times the covariance, (unknowns, m)."""
        return np.ascontiguousarray(
            self.outputs.times(self.covariance[self.network.layout.places]).T
        )

    def leverage(self, strip: Ints, target: Ints) -> Floats:
        columns, values = self._rows(strip, target)
        spread = _combined(self.covariance, columns, values)
        return _combined(spread.T, columns, values)

    def sensitivity(self, strip: Ints, target: Ints) -> Sensitivity:
        return Sensitivity.whole(_combined(self.carried, *self._rows(strip, target)).T)

    def cofactor(self, strip: Ints, target: Ints, unit: Floats) -> LowRank:
        leverage = self.leverage(strip, target) * unit * unit[:, None]
        return LowRank.whole(np.eye(len(unit)) - 0.5 * (leverage + leverage.T))

    def _rows(self, strip: Ints, target: Ints) -> tuple[Ints, Floats]:
        """Return the columns (e, 7) that the lengths touch, and their slopes (e, 7)."""
        slopes, layout = self.network.rows[strip, target], self.network.layout
        of_target = layout.size + 3 * target[:, None] + np.arange(3)
        columns = np.column_stack([layout.index[strip], of_target])
        return columns, np.column_stack([slopes, -slopes[:, :3]])


def _combined(matrix: Floats, columns: Ints, values: Floats) -> Floats:
    """Return sums of rows of ``matrix``: those of ``columns`` (e, k), times ``values`` (e, k)."""
    found = values[:, :1] * matrix[columns[:, 0]]
    for k in range(1, columns.shape[1]):
        found += values[:, k : k + 1] * matrix[columns[:, k]]
    return np.asarray(found)


@dataclass(frozen=True, eq=False)
class _Apart:
    """By what each station has to itself, and the targets that all have in common.

    With stations x eliminated, B their normal blocks, K the covariance of the targets and T the
    transfer to them, cov x = B^-1 + T' K T: a length with slopes s by its station and t by its
    target is off by s'B^-1 of its own and K (t - T s) of the targets.
    """

    network: Network
    outputs: Slopes

    @cached_property
    def common(self) -> Floats:
        """What outputs feel of what all stations feel, and of the targets: (m, c + 3 n)."""
        stations = self._transfer[:, :, :3].reshape(-1, self.outputs.along.shape[1])
        return np.hstack([self.outputs.common, -self.outputs.times(stations.T)])

    @cached_property
    def _transfer(self) -> Floats:
        """T by stations, (3 n, m, 4)."""
        return self.network.reduced.transfer.reshape(-1, len(self.network.state), 4)

    def _by_target(self, strip: Ints, target: Ints) -> Floats:
        """Return t - T s, (e, 3 n)."""
        slopes = self.network.rows[strip, target]
        if (strip == strip[0]).all():
            found = -(slopes @ self._transfer[:, strip[0]].T)
        else:
            found = -np.einsum("ea,tea->et", slopes, self._transfer[:, strip])
        columns = 3 * target[:, None] + np.arange(3)
        found[np.arange(len(strip))[:, None], columns] -= slopes[:, :3]
        return np.asarray(found)

    def _by_station(self, strip: Ints, target: Ints) -> Floats:
        """Return B^-1 s, (e, 4)."""
        slopes = self.network.rows[strip, target]
        return np.asarray((self.network.reduced.inverse[strip] @ slopes[:, :, None])[:, :, 0])

    def leverage(self, strip: Ints, target: Ints) -> Floats:
        by_target = self._by_target(strip, target)
        own = self._by_station(strip, target) @ self.network.rows[strip, target].T
        own *= strip[:, None] == strip
        return np.asarray(own + by_target @ self.network.reduced.covariance() @ by_target.T)

    def sensitivity(self, strip: Ints, target: Ints) -> Sensitivity:
        moved = self._by_station(strip, target)[:, :3]
        of_targets = self.network.reduced.covariance() @ self._by_target(strip, target).T
        columns = 3 * strip[:, None] + np.arange(3)
        shared = np.einsum("cea,ea->ce", self.outputs.along[:, columns], moved)
        at, which = np.unique(strip, return_inverse=True)
        own = np.zeros((len(at), len(strip)))
        own[which, np.arange(len(strip))] = (self.outputs.own[strip] * moved).sum(axis=1)
        return Sensitivity(np.vstack([shared, of_targets]), self.common, at, own)

    def cofactor(self, strip: Ints, target: Ints, unit: Floats) -> LowRank:
        slopes = self.network.rows[strip, target]
        own = (self._by_station(strip, target) * slopes).sum(axis=1) * unit**2
        columns = self._by_target(strip, target) * unit[:, None]
        values, axes = np.linalg.eigh(self.network.reduced.covariance())
        root = axes * np.sqrt(np.maximum(values, 0.0))
        return LowRank((1.0 - own)[:, None, None], columns @ root, -np.eye(len(root)))
