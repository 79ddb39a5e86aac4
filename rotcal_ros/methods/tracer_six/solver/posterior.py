"""Covariances about the minimum of a network: of all unknowns, of stations, of lengths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.methods.tracer_six.solver.curves import Curves, curve_jacobian, table_curves
from rotcal_ros.methods.tracer_six.solver.network import LengthNetwork


@dataclass(frozen=True, eq=False)
class Posterior:
    """``covariance`` (T, T) of all unknowns, T = K + 6 m: the kept ones, then the poses.

    ``arrived`` (V, 3): the scatter of each station, as its lengths tell it, m; ``leverage``
    (V, n): variance of each computed length, scatter included, m^2.
    """

    network: LengthNetwork
    covariance: Floats
    arrived: Floats
    leverage: Floats

    @property
    def targets(self) -> Floats:
        """The covariance (n, 3, n, 3) of the targets, m^2."""
        n = len(self.network.state.targets)
        return self.covariance[: 3 * n, : 3 * n].reshape(n, 3, n, 3)

    @property
    def poses(self) -> Floats:
        """The covariance (6 m, 6 m) of the poses."""
        k = self.network.layout.size
        return self.covariance[k:, k:]


def posterior(network: LengthNetwork) -> Posterior:
    """Return the covariances of a network at its minimum."""
    covariance = full_covariance(network)
    arrived, own, response = scattered(network)
    spread = response @ covariance  # (3 V, T)
    return Posterior(
        network, covariance, arrived, _leverage(network, covariance, own, response, spread)
    )


def full_covariance(network: LengthNetwork) -> Floats:
    """Return the covariance (T, T) of kept unknowns and poses, under the constraints."""
    kept = network.reduced.covariance()
    k, t = len(kept), len(kept) + network.reduced.inverse.shape[0] * 6
    whole = np.empty((t, t))
    whole[:k, :k] = kept
    whole[:k, k:] = -kept @ network.reduced.transfer
    whole[k:, :k] = whole[:k, k:].T
    whole[k:, k:] = -network.reduced.transfer.T @ whole[:k, k:]
    m = len(network.reduced.inverse)
    each = np.arange(m)
    whole[k:, k:].reshape(m, 6, m, 6)[each, :, each] += network.reduced.inverse
    return whole


def pulled(network: LengthNetwork) -> Floats:
    """Return U' W J (3 V, T): what unknowns do to the weighted errors along each station."""
    v, _, k = network.across.shape
    whole = np.zeros((v, 3, k + 6 * len(network.layout.angles)))
    whole[:, :, :k] = network.across
    _at_poses(network, whole, network.normal @ network.motion)
    return whole.reshape(3 * v, -1)


def _at_poses(network: LengthNetwork, whole: Floats, blocks: Floats) -> None:
    """Put ``blocks`` (V, 3, 6) where the poses of their stations are in ``whole`` (V, 3, T)."""
    each = np.arange(len(blocks))[:, None]
    columns = network.layout.size + 6 * network.layout.position[:, None] + np.arange(6)
    whole[each, :, columns] = blocks.swapaxes(1, 2)


def scattered(network: LengthNetwork) -> tuple[Floats, Floats, Floats]:
    """Return scatter (V, 3), its own covariance (V, 3, 3), and (3 V, T) how stations move.

    The scatter of a station follows its lengths, and so every unknown that these depend on.
    """
    layout, state, here = network.layout, network.state, network.slopes
    v, n, _ = here.unit.shape
    turned = state.rotation[layout.position]
    response = np.zeros((v, 3, layout.size + 6 * len(layout.angles)))
    columns = 3 * (n + layout.place)[:, None] + np.arange(3)
    response[np.arange(v)[:, None], :, columns] = turned.swapaxes(1, 2)
    _at_poses(network, response, network.motion)
    if network.scatter is None:
        return np.zeros((v, 3)), np.zeros((v, 3, 3)), response.reshape(3 * v, -1)
    root = network.scatter
    weighted = (here.unit * network.grid.weights[:, :, None]).swapaxes(1, 2)
    alone = weighted @ here.unit
    back = root.swapaxes(1, 2)
    own = root @ np.linalg.inv(np.eye(3) + back @ alone @ root) @ back
    gain = own @ weighted  # (V, 3, n)
    arrived = -(gain @ here.error[:, :, None])[:, :, 0]
    response -= own @ alone @ response
    response[:, :, : 3 * n] += (gain[:, :, :, None] * here.unit[:, None]).reshape(v, 3, 3 * n)
    station, zero, by_pair = layout.pairs
    first = 3 * (n + len(layout.places))
    response[station, :, first + zero] += by_pair @ gain.swapaxes(1, 2).reshape(v * n, 3)
    return arrived, own, response.reshape(3 * v, -1)


def _leverage(
    network: LengthNetwork, covariance: Floats, own: Floats, response: Floats, spread: Floats
) -> Floats:
    layout, unit = network.layout, network.slopes.unit
    v, n, _ = unit.shape
    each, targets = np.arange(v), np.arange(n)
    own = own + spread.reshape(v, 3, -1) @ response.reshape(v, 3, -1).swapaxes(1, 2)
    first = 3 * (n + len(layout.places))
    at_target = covariance[: 3 * n, : 3 * n].reshape(n, 3, n, 3)[targets, :, targets]
    at_zero = covariance[first + layout.zero, first + layout.zero]
    between = spread.reshape(v, 3, -1)[:, :, : 3 * n].reshape(v, 3, n, 3).transpose(0, 2, 1, 3)
    block = own[:, None] + at_target - between - between.swapaxes(2, 3)
    total = ((unit[:, :, None] @ block)[:, :, 0] * unit).sum(axis=2) + at_zero
    station = spread.reshape(v, 3, -1)[each[:, None], :, first + layout.zero]
    target = covariance[: 3 * n].reshape(n, 3, -1)[targets, :, first + layout.zero]
    return np.asarray(total - 2.0 * (unit * (station - target)).sum(axis=2), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class CurvePosterior:
    """The table's ``curves`` and their ``covariance`` (6 m, 6 m): d of all positions, then c.

    ``jacobian`` (6 m, 6 m): what steps of the poses do to them.
    """

    curves: Curves
    covariance: Floats
    jacobian: Floats


def curve_posterior(network: LengthNetwork, covariance: Floats) -> CurvePosterior:
    """Return the curves of a network and their covariance, from that of all unknowns (T, T)."""
    state, angles = network.state, network.layout.angles
    curves = table_curves(state.rotation, state.translation, angles)
    jacobian = curve_jacobian(curves, state.rotation, angles)
    k = network.layout.size
    return CurvePosterior(curves, jacobian @ covariance[k:, k:] @ jacobian.T, jacobian)
