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

from typing import Final, NamedTuple

import numpy as np

from rotcal_ros.adjust.low_rank import LowRank
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.geometry.rotations import fit_rotation
from rotcal_ros.methods.tracer_six.lengths.adjustment import (
    Adjustment,
    StationCovariance,
    adjust_stations,
)
from rotcal_ros.methods.tracer_six.lengths.network import (
    Network,
    less_rigid,
    linearise,
    network_of,
    relax,
    rigid,
)
from rotcal_ros.methods.tracer.solver.observability import CURE, name_direction, or_prior
from rotcal_ros.methods.tracer.solver.problem import Grid

RANK_TOLERANCE: Final = 1e-13
"""Eigenvalue, as a share of the largest, of a direction that the lengths leave open."""
CHECKED: Final = 0.01
"""Redundancy from which a coordinate is held to be checked by the lengths."""


def adjust_network(grid: Grid, start: Floats, targets: Floats | None = None) -> Adjustment:
    """Return the network that fits the lengths of ``grid`` best, from the strips ``start`` (p, 4).

    ``targets`` (n, 3) go with a start that is a network already; else it is approached station by
    station.
    Raises ObservabilityError when more stays open than is known in advance, DataError when the
    network does not settle.
    """
    if targets is None and grid.apart:
        start = adjust_stations(grid, start).state
    network = _settled(grid, start, grid.targets if targets is None else targets)
    rank = _rank(network, grid)
    state, targets = network.state, network.targets
    if grid.free:
        state, targets = align(state, targets, grid.targets)
    spread = _posterior(network)
    corrections, redundancy, coupling = _felt_by_targets(network, grid, spread)
    leverage = grid.weights * _leverage(network, spread)
    unknowns = network.layout.size + network.targets.size
    walked = 0 if grid.walk is None else int(np.isfinite(grid.walk).sum())
    observed = int(grid.used.sum()) + walked + grid.contrasts
    return Adjustment(
        stations=state[grid.first_strip, :3],
        distances=state[:, 3],
        targets=targets,
        residual=-network.f,
        std=grid.length_std,
        redundancy=grid.used - leverage,
        chi2=network.chi2,
        dof=observed - (rank if grid.free else network.layout.size),
        unknowns=unknowns,
        rank=rank,
        target_test=target_test(corrections, redundancy),
        corrections=corrections,
        target_redundancy=np.diagonal(redundancy, axis1=1, axis2=2),
        coupling=coupling,
        network=None if grid.free else network,  # a free one was moved since
        strip_station=None if grid.zero is None else grid.station,
        circle_coupling=_felt_by_circle(network, grid, float((grid.used - leverage).sum())),
    )


def _settled(grid: Grid, start: Floats, targets: Floats) -> Network:
    """Return the least-squares network; where there is none, name what is open."""
    try:
        return relax(grid, start, targets)
    except ObservabilityError:
        _rank(linearise(grid, start, targets), grid)
        raise


def network_covariance(grid: Grid, fit: Adjustment) -> StationCovariance:
    """Return the covariance of the stations, split into lengths, targets' prior and circle."""
    network = network_of(grid, fit)
    if not network.stations_kept:
        return _apart_covariance(network, grid, float(fit.dof))
    kept = network.reduced.covariance()
    stations, mixed = kept, -kept @ network.reduced.transfer
    by_circle = None
    if network.circle is not None:
        pull = network.layout.with_zeros(network.circle.T)
        by_circle, of_targets = stations @ pull, mixed.T @ pull
    if grid.free:
        on_stations, rigid_part = _datum(network)
        stations = _move_datum(network, mixed, kept)
        if by_circle is not None:
            by_circle = by_circle - on_stations @ (rigid_part @ of_targets)
    prior, sensitivity = np.zeros_like(stations), np.zeros_like(mixed)
    if not grid.free:
        sensitivity = mixed / grid.target_std.ravel()
        prior = sensitivity @ sensitivity.T
    coordinates = network.layout.places
    places = np.ix_(coordinates, coordinates)
    sensitivity = sensitivity[coordinates].reshape(-1, *grid.targets.shape)
    # the covariance is a sum over independent sources: what prior and circle leave is the lengths'
    lengths, circle = stations - prior, None
    if by_circle is not None:
        shared = by_circle @ by_circle.T
        lengths, circle = lengths - shared, LowRank.whole(shared[places], 3)
    return StationCovariance(
        LowRank.whole(lengths[places], 3), LowRank.whole(prior[places], 3), sensitivity,
        float(fit.dof), circle,
    )  # fmt: skip


def target_corrections(grid: Grid, fit: Adjustment) -> tuple[Floats, Floats]:
    """Return the adjusted less the stated targets and their standard deviations, (n, 3), m.

    In a free network without what moves all of them alike, a shift and a turn.
    """
    network, moved = network_of(grid, fit), fit.targets - grid.targets
    reduced, kept = network.reduced, network.reduced.covariance()
    if grid.free:
        covariance = reduced.other_times(kept, np.eye(moved.size))
        return less_rigid(grid.targets, moved, covariance)
    if network.stations_kept:
        variance = np.diagonal(reduced.other_blocks(kept), axis1=1, axis2=2)
    else:
        variance = kept.diagonal().reshape(moved.shape)
    return moved, np.sqrt(variance)


def _apart_covariance(network: Network, grid: Grid, dof: float) -> StationCovariance:
    """Return the covariance of stations that were eliminated, tied only by the targets."""
    reduced, std = network.reduced, grid.target_std.ravel()
    kept = reduced.covariance()
    common = np.ascontiguousarray(reduced.transfer[:, network.layout.places].T)
    sensitivity = -(common @ (kept / std))
    own, shared = reduced.inverse[:, :3, :3], (kept / std) @ (kept / std).T
    return StationCovariance(
        lengths=LowRank(own, common, kept - shared).quick(),
        targets=LowRank(np.zeros_like(own), common, shared).quick(),
        sensitivity=sensitivity.reshape(-1, *grid.targets.shape),
        dof_effective=dof,
    )


def _datum(network: Network) -> tuple[Floats, Floats]:
    """Return what rigid motions do to the unknowns, and what targets' errors are as such."""
    centre = network.targets.mean(axis=0)
    stations = network.state[network.layout.first_strip, :3]
    on_stations = network.layout.with_zeros(rigid(stations - centre))
    return on_stations, np.asarray(np.linalg.pinv(rigid(network.targets - centre)))


def _move_datum(network: Network, mixed: Floats, kept: Floats) -> Floats:
    """Return the covariance ``kept`` of the stations with the inner constraints on the targets.

    S-transformation: from every error its rigid part, as the targets feel it, is taken away.
    """
    on_stations, rigid_part = _datum(network)
    own = rigid_part @ network.reduced.other_times(kept, rigid_part.T)
    shift = mixed @ rigid_part.T @ on_stations.T
    return np.asarray(kept - shift - shift.T + on_stations @ own @ on_stations.T)


class _Posterior(NamedTuple):
    """Covariance of strips (p, 4, 4), of targets (n, 3, 3), and between them (p, 4, n, 3).

    ``kept`` is that of the whole side that was not eliminated.
    """

    kept: Floats
    stations: Floats
    targets: Floats
    mixed: Floats


def _posterior(network: Network) -> _Posterior:
    reduced, kept = network.reduced, network.reduced.covariance()
    other = reduced.other_blocks(kept)
    mixed = -(kept @ reduced.transfer)
    m, n = network.f.shape
    index = network.layout.index
    if network.stations_kept:
        blocks = kept[index[:, :, None], index[:, None, :]]
        return _Posterior(kept, blocks, other, mixed.reshape(-1, n, 3)[index])
    blocks = kept.reshape(n, 3, n, 3)[np.arange(n), :, np.arange(n)]
    return _Posterior(kept, other, blocks, mixed.reshape(n, 3, m, 4).transpose(2, 3, 0, 1))


def _leverage(network: Network, spread: _Posterior) -> Floats:
    """Return (m, n) the variance of each computed length, m^2."""
    rows, unit = network.rows, network.rows[:, :, :3]
    at_station = np.einsum("jia,jia->ji", rows @ spread.stations, rows)
    at_target = np.einsum("ijb,jib->ji", unit.swapaxes(0, 1) @ spread.targets, unit)
    # the design's target part is -unit, so the mixed term comes with a minus
    between = np.einsum("jai,jia->ji", np.einsum("jaib,jib->jai", spread.mixed, unit), rows)
    return np.asarray(at_station + at_target - 2.0 * between, dtype=np.float64)


def felt_by_targets(
    grid: Grid, targets: Floats, covariance: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return corrections (n, 3), redundancy (n, 3, 3) and coupling (3, 3) of the coordinates.

    Of adjusted ``targets`` (n, 3) with their ``covariance`` (3 n, 3 n), m^2, in standard
    deviations of the machine's coordinates; zero where these are start values only. The redundancy
    matrix M of all observations is a projection; the coupling of two axes is the sum of the
    squares of its entries between them, which is half the covariance of their sums of squared
    corrections.
    """
    n, std = len(targets), grid.target_std
    if grid.free:
        return np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((3, 3))
    whole = -covariance.reshape(n, 3, n, 3) / (std[:, :, None, None] * std)
    each = np.arange(n)
    whole[each, :, each] += np.eye(3)
    coupling = np.einsum("iajb,iajb->ab", whole, whole)
    return (targets - grid.targets) / std, whole[each, :, each], coupling


def _felt_by_targets(
    network: Network, grid: Grid, spread: _Posterior
) -> tuple[Floats, Floats, Floats]:
    """Return what :func:`felt_by_targets` does, without the whole covariance of many targets."""
    n = len(grid.targets)
    if grid.free or not network.stations_kept:
        return felt_by_targets(grid, network.targets, spread.kept)
    std = grid.target_std
    area = std[:, :, None] * std[:, None, :]
    redundancy = np.eye(3) - spread.targets / area
    # M = blocks - G'G, with the blocks that the targets have alone and G by way of the stations
    alone = np.eye(3) - network.reduced.inverse / area
    through = alone - redundancy
    columns = (network.reduced.transfer / std.ravel()).reshape(-1, n, 3)
    paths = [spread.kept @ (columns[:, :, a] @ columns[:, :, a].T) for a in range(3)]
    coupling = (alone * (alone - 2.0 * through)).sum(axis=0)
    coupling += [[(first * second.T).sum() for second in paths] for first in paths]
    return (network.targets - grid.targets) / std, redundancy, np.asarray(coupling)


def _felt_by_circle(network: Network, grid: Grid, lengths: float) -> Floats:
    """Return the squared sums (4,) of the redundancy matrix between circle and others.

    With the targets' x, y and z, and with the ``lengths``, whose redundancy that is: the rest of
    what the circle's own has, for the matrix is a projection.
    """
    if network.circle is None:
        return np.zeros(4)
    kept = network.reduced.covariance()
    pull = network.layout.with_zeros(network.circle.T)
    own = np.eye(pull.shape[1]) - pull.T @ kept @ pull
    others = np.zeros(3)
    if not grid.free:
        moved = (network.reduced.transfer.T @ (kept @ pull)).reshape(*grid.targets.shape, -1)
        others = ((moved / grid.target_std[:, :, None]) ** 2).sum(axis=(0, 2))
    rest = float(np.trace(own) - (own**2).sum() - others.sum())
    # rounding may leave a little less than nothing, or more than the lengths have
    return np.append(others, min(max(rest, 0.0), lengths))


def target_test(corrections: Floats, redundancy: Floats) -> Floats:
    """Return (n,) the largest normalised correction of each target's machine coordinates.

    In the directions that the lengths check at all (redundancy above CHECKED), each correction is
    compared with its own standard deviation, like a residual.
    """
    checked, axes = np.linalg.eigh(redundancy)
    along = np.abs(np.einsum("ic,ice->ie", corrections, axes))
    value = along / np.sqrt(np.maximum(checked, CHECKED))
    return np.asarray(np.where(checked > CHECKED, value, 0.0).max(axis=1), dtype=np.float64)


def _rank(network: Network, grid: Grid) -> int:
    """Return the rank of the design; raise ObservabilityError if more is open than it may be."""
    reduced = network.reduced
    values, vectors = np.linalg.eigh(reduced.regular())
    missing = int((values < RANK_TOLERANCE * values[-1]).sum())
    if missing:
        index = int(np.argmax(np.abs(reduced.scale * vectors[:, 0])))
        name, where, direction = _weakest(network, grid, reduced.scale * vectors[:, 0], index)
        cure = f"{CURE}{or_prior(free=grid.free)}"
        raise ObservabilityError(
            f"the lengths leave {missing} more directions open than expected; the weakest "
            f"is {name} {where} along {name_direction(direction)}: {cure}"
        )
    return int(network.layout.size + network.targets.size - reduced.constraints.shape[1])


def _weakest(network: Network, grid: Grid, vector: Floats, index: int) -> tuple[str, int, Floats]:
    """Return what the unknown ``index`` of the kept side belongs to, and its direction."""
    if not network.stations_kept:
        k = index // 3
        return "target", int(grid.target_ids[k]), vector[3 * k : 3 * k + 3]
    p = int(np.flatnonzero((network.layout.index == index).any(axis=1))[0])
    direction = vector[network.layout.index[p, :3]]
    return "station", int(grid.position_ids[grid.station[p]]), direction


def align(state: Floats, targets: Floats, machine: Floats) -> tuple[Floats, Floats]:
    """Move the whole network rigidly so that its targets lie best on the ``machine``'s."""
    centre, aim = targets.mean(axis=0), machine.mean(axis=0)
    rotation = fit_rotation(targets - centre, machine - aim)
    stations = (state[:, :3] - centre) @ rotation.T + aim
    return np.column_stack([stations, state[:, 3]]), (targets - centre) @ rotation.T + aim
