"""Joint self-calibration: stations, distances and targets adjusted together.

Laser tracer paper, section 2 (Eq. 1-4). Two data:

prior
    the machine's coordinates are observations, weighted by ``target_std``;
free
    they are start values only. Lengths do not feel a rigid motion of the whole network: six
    directions stay open. And a table carries the tracer round a plane circle, which leaves a
    *seventh*: with the circle's centre as origin and z along the axis, let the targets move by
    (x, y, -(x^2 + y^2 - R^2) / z) and the stations by (-X, -Y, 0), times any small number: no
    length changes to first order. (Complete bipartite frameworks flex when one side lies on a
    conic: Bolker and Roth, Pacific J. Math. 90 (1980) 27.) It scales the circle, so the angle does
    not feel it either. The seven are fixed while solving: no shift and turn of the stations, and
    their rms distance from their centroid stays what the machine's coordinates give. Then the
    network is moved rigidly to the inner constraints on the targets: no mean shift and turn
    against the machine's coordinates.

The paper solves Eq. 4 by a dense SVD with a threshold, which hides the seven among other small
singular values; here they are known in closed form, and the rank is counted beside them.
Every length touches one station and one target; one side is eliminated: with a prior the one
with more unknowns, in a free network always the targets.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.errors import DataError, ObservabilityError
from rotcal_ros.geometry.rotations import cross_matrix, fit_rotation
from rotcal_ros.methods.tracer.adjustment import Adjustment, StationCovariance, ranges
from rotcal_ros.methods.tracer.grid import Grid
from rotcal_ros.methods.tracer.observability import CURE, name_direction
from rotcal_ros.methods.tracer.schur import Reduced, eliminate
from rotcal_ros.methods.tracer.station import adjust_stations

CONVERGED: Final = 1e-14
"""Squared length of the last step in standard deviations."""
STAGNANT: Final = 1e-6
"""Squared length below which a step that no longer shrinks is rounding."""
MAX_ITERATIONS: Final = 50
RIGID_MOTIONS: Final = 6
RANK_TOLERANCE: Final = 1e-13
CHECKED: Final = 0.01
"""Redundancy from which a coordinate is held to be checked by the lengths."""


@dataclass(frozen=True, eq=False)
class Network:
    """One linearisation: ``state`` (m, 4), ``targets`` (n, 3), errors, gradient and normal matrix.

    ``f`` (m, n) is computed - observed, ``rows`` (m, n, 4) the design's station part (its target
    part is minus the first three columns). ``stations_kept``: the targets were eliminated.
    """

    state: Floats
    targets: Floats
    f: Floats
    rows: Floats
    chi2: float
    station_gradient: Floats
    target_gradient: Floats
    reduced: Reduced
    stations_kept: bool

    def step(self) -> tuple[Floats, Floats]:
        """Return the Gauss-Newton step of stations (m, 4) and targets (n, 3)."""
        a, b = -self.station_gradient.ravel(), -self.target_gradient.ravel()
        if self.stations_kept:
            x, y = self.reduced.solve(a, b)
        else:
            y, x = self.reduced.solve(b, a)
        return x.reshape(self.state.shape), y.reshape(self.targets.shape)


def adjust_network(grid: Grid, start: Floats) -> Adjustment:
    """Return the network that fits the lengths of ``grid`` best, from stations ``start`` (m, 4).

    Raises ObservabilityError when more stays open than is known in advance, DataError when the
    network does not settle.
    """
    begin = adjust_stations(grid, start)
    network = relax(grid, begin.state, grid.targets)
    rank = _rank(network, grid)
    state, targets = network.state, network.targets
    if grid.free:
        state, targets = align(state, targets, grid.targets)
    spread = _posterior(network)
    unknowns = network.state.size + network.targets.size
    n_lengths = int(grid.used.sum())
    return Adjustment(
        stations=state[:, :3],
        distances=state[:, 3],
        targets=targets,
        residual=-network.f,
        std=grid.length_std,
        redundancy=grid.used - grid.weights * _leverage(network, spread),
        chi2=network.chi2,
        dof=n_lengths - rank if grid.free else n_lengths - network.state.size,
        unknowns=unknowns,
        rank=rank,
        target_test=_target_test(network, grid, spread.targets),
    )


def relax(grid: Grid, state: Floats, targets: Floats) -> Network:
    """Return the least-squares network near ``state`` (m, 4) and ``targets`` (n, 3).

    Gauss-Newton; a step that would raise chi-squared is halved.
    """
    network, before = linearise(grid, state, targets), np.inf
    for _ in range(MAX_ITERATIONS):
        by_station, by_target = network.step()
        squared = -float(
            (network.station_gradient * by_station).sum()
            + (network.target_gradient * by_target).sum()
        )
        trial = linearise(grid, network.state + by_station, network.targets + by_target)
        for _ in range(30):
            if trial.chi2 <= network.chi2 + 1e-9 * max(network.chi2, 1.0):
                break
            by_station, by_target = 0.5 * by_station, 0.5 * by_target
            trial = linearise(grid, network.state + by_station, network.targets + by_target)
        network = trial
        if squared < CONVERGED or (squared < STAGNANT and squared > 0.25 * before):
            return network
        before = squared
    raise DataError(
        f"stations and targets do not settle together in {MAX_ITERATIONS} iterations: the lengths "
        "do not fit the targets; check the order of the targets, or use the datum 'prior'"
    )


def linearise(grid: Grid, state: Floats, targets: Floats) -> Network:
    """Return the network at ``state`` (m, 4), ``targets`` (n, 3): errors, gradient, normals."""
    m, n = grid.used.shape
    weights = grid.weights
    distance, unit = ranges(state[:, :3], targets)
    f = distance - state[:, 3:] - grid.length
    rows = np.concatenate([unit, np.full((m, n, 1), -1.0)], axis=2)
    weighted = rows * weights[:, :, None]
    by_target = np.ascontiguousarray(unit.swapaxes(0, 1))
    weighted_by_target = by_target * weights.T[:, :, None]
    stations = rows.swapaxes(1, 2) @ weighted
    blocks = by_target.swapaxes(1, 2) @ weighted_by_target
    station_gradient = np.einsum("jia,ji->ja", weighted, f)
    target_gradient = -np.einsum("jia,ji->ia", weighted[:, :, :3], f)
    chi2 = float((weights * f**2).sum())
    if not grid.free:
        correction = (targets - grid.targets) / grid.target_std
        chi2 += float((correction**2).sum())
        target_gradient = target_gradient + correction / grid.target_std
        blocks[:, [0, 1, 2], [0, 1, 2]] += grid.target_std**-2
    cross = -(weighted.swapaxes(1, 2)[:, :, :, None] * unit[:, None]).reshape(4 * m, 3 * n)
    stations_kept = grid.free or 4 * m <= 3 * n
    if stations_kept:
        constraints = _constraints(state[:, :3]) if grid.free else None
        reduced = eliminate(stations, blocks, cross, constraints)
    else:
        reduced = eliminate(blocks, stations, np.ascontiguousarray(cross.T))
    return Network(
        state, targets, f, rows, chi2, station_gradient, target_gradient, reduced, stations_kept
    )


def network_covariance(grid: Grid, fit: Adjustment) -> StationCovariance:
    """Return the covariance of the stations, split into noise of the lengths and of the prior."""
    network = linearise(grid, fit.state, fit.targets)
    reduced = network.reduced
    kept = reduced.covariance()
    if network.stations_kept:
        stations, mixed = kept, -kept @ reduced.transfer
    else:
        mixed = -(kept @ reduced.transfer).T
        stations = reduced.other_times(kept, np.eye(fit.state.size))
    if grid.free:
        stations = _move_datum(network, mixed, kept)
    prior = np.zeros_like(stations)
    if not grid.free:
        felt = mixed / grid.target_std.ravel()
        prior = felt @ felt.T
    positions = np.flatnonzero(np.arange(fit.state.size) % 4 < 3)
    places = np.ix_(positions, positions)
    return StationCovariance((stations - prior)[places], prior[places], float(fit.dof))


def _move_datum(network: Network, mixed: Floats, kept: Floats) -> Floats:
    """Return the covariance ``kept`` of the stations with the inner constraints on the targets.

    S-transformation: from every error its rigid part, as the targets feel it, is taken away.
    """
    centre = network.targets.mean(axis=0)
    on_stations = _with_distances(_rigid(network.state[:, :3] - centre))
    rigid_part = np.asarray(np.linalg.pinv(_rigid(network.targets - centre)), dtype=np.float64)
    own = rigid_part @ network.reduced.other_times(kept, rigid_part.T)
    shift = mixed @ rigid_part.T @ on_stations.T
    return np.asarray(kept - shift - shift.T + on_stations @ own @ on_stations.T)


class _Posterior(NamedTuple):
    """Covariance of stations (m, 4, 4), of targets (n, 3, 3), and between them (m, 4, n, 3)."""

    stations: Floats
    targets: Floats
    mixed: Floats


def _posterior(network: Network) -> _Posterior:
    reduced, kept = network.reduced, network.reduced.covariance()
    other = reduced.other_blocks(kept)
    mixed = -(kept @ reduced.transfer)
    m, n = network.f.shape
    if network.stations_kept:
        blocks = kept.reshape(m, 4, m, 4)[np.arange(m), :, np.arange(m)]
        return _Posterior(blocks, other, mixed.reshape(m, 4, n, 3))
    blocks = kept.reshape(n, 3, n, 3)[np.arange(n), :, np.arange(n)]
    return _Posterior(other, blocks, mixed.reshape(n, 3, m, 4).transpose(2, 3, 0, 1))


def _leverage(network: Network, spread: _Posterior) -> Floats:
    """Return (m, n) the variance of each computed length, m^2."""
    rows, unit = network.rows, network.rows[:, :, :3]
    at_station = np.einsum("jia,jia->ji", rows @ spread.stations, rows)
    at_target = np.einsum("ijb,jib->ji", unit.swapaxes(0, 1) @ spread.targets, unit)
    # the design's target part is -unit, so the mixed term comes with a minus
    between = np.einsum("jai,jia->ji", np.einsum("jaib,jib->jai", spread.mixed, unit), rows)
    return np.asarray(at_station + at_target - 2.0 * between, dtype=np.float64)


def _target_test(network: Network, grid: Grid, spread: Floats) -> Floats:
    """Return (n,) the largest normalised correction of each target's machine coordinates.

    In the directions that the lengths check at all (redundancy above CHECKED), each correction is
    compared with its own standard deviation, like a residual.
    """
    if grid.free:
        return np.zeros(len(grid.targets))
    std = grid.target_std
    correction = (network.targets - grid.targets) / std
    redundancy, axes = np.linalg.eigh(np.eye(3) - spread / (std[:, :, None] * std[:, None, :]))
    along = np.abs(np.einsum("ic,ice->ie", correction, axes))
    value = along / np.sqrt(np.maximum(redundancy, CHECKED))
    return np.asarray(np.where(redundancy > CHECKED, value, 0.0).max(axis=1), dtype=np.float64)


def _rank(network: Network, grid: Grid) -> int:
    """Return the rank of the design; raise ObservabilityError if more is open than it may be."""
    reduced = network.reduced
    values, vectors = np.linalg.eigh(reduced.regular())
    missing = int((values < RANK_TOLERANCE * values[-1]).sum())
    if missing:
        index = int(np.argmax(np.abs(reduced.scale * vectors[:, 0])))
        size, ids, name = (
            (4, grid.position_ids, "station")
            if network.stations_kept
            else (3, grid.target_ids, "target")
        )
        k = index // size
        direction = (reduced.scale * vectors[:, 0])[size * k : size * k + 3]
        raise ObservabilityError(
            f"the lengths leave {missing} more directions open than expected; the weakest "
            f"is {name} {ids[k]} along {name_direction(direction)}: {CURE}, or use the datum "
            "'prior'"
        )
    return int(network.state.size + network.targets.size - reduced.constraints.shape[1])


def align(state: Floats, targets: Floats, machine: Floats) -> tuple[Floats, Floats]:
    """Move the whole network rigidly so that its targets lie best on the ``machine``'s."""
    centre, aim = targets.mean(axis=0), machine.mean(axis=0)
    rotation = fit_rotation(targets - centre, machine - aim)
    stations = (state[:, :3] - centre) @ rotation.T + aim
    return np.column_stack([stations, state[:, 3]]), (targets - centre) @ rotation.T + aim


def _rigid(points: Floats) -> Floats:
    """Return what three shifts and three turns about the origin do to ``points``: (3 k, 6)."""
    motions = np.empty((len(points), 3, RIGID_MOTIONS))
    motions[:, :, :3] = np.eye(3)
    motions[:, :, 3:] = -cross_matrix(points)
    return motions.reshape(-1, RIGID_MOTIONS)


def _constraints(stations: Floats) -> Floats:
    """Return what the ``stations`` (m, 3) must not do in a free network: (4 m, 7).

    Six rigid motions, and growing away from their centroid, which is the station part of the
    seventh up to a shift.
    """
    spread = stations - stations.mean(axis=0)
    return _with_distances(np.column_stack([_rigid(spread), spread.ravel()]))


def _with_distances(motions: Floats) -> Floats:
    """Insert the distances d, which these motions do not change: (3 m, c) to (4 m, c)."""
    m, c = len(motions) // 3, motions.shape[1]
    full = np.zeros((m, 4, c))
    full[:, :3] = motions.reshape(m, 3, c)
    return full.reshape(4 * m, c)
