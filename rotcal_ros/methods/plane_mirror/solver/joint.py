"""All tracker stations in one least squares: one table axis, one cone of normals, nests included.

Model, in the frame of the first station: the mirror at position i is the plane n_i.X = d_i with

    n_i = cos(beta + eps_i) (cos psi_i e1 + sin psi_i e2) + sin(beta + eps_i) a.

Unknown are the axis a, the cone's beta, the poses of the stations and the nests (shared), and
psi_i, eps_i, d_i per position; eps_i, the tilt of the table, is held at zero to within
``tilt_std``. The planes that :mod:`~rotcal_ros.methods.plane_mirror.solver.normals` fits to each
group, with their information, say all that the points say. Each group touches one position and one
station, so the 3 x 3 blocks of the positions and of the nests are eliminated and 6 (S - 1) + 3
equations remain, however many positions there are. All arrays may have leading axes (trials).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.geometry.rotations import rotation_from_vector
from rotcal_ros.methods.plane_mirror.solver.normals import Normals, axis_frame, azimuths, fit_cone
from rotcal_ros.methods.plane_mirror.solver.problem import MirrorPairs, Nests
from rotcal_ros.methods.plane_mirror.solver.registration import (
    Poses,
    nest_equations,
    station_columns,
)

_MAX_STEPS: Final = 30  # the start is near: what has not settled then never will
_TOLERANCE: Final = 1e-13  # change (rad, m) that is rounding
_SHARED: Final = 3  # tilt of the axis about two directions, and beta


@dataclass(frozen=True)
class Mirror:
    """The unknowns of the joint solution.

    ``frame`` (..., 3, 3) has the columns e1, e2, a; ``beta`` (...), ``psi``, ``eps`` (..., N) in
    rad, ``distance`` d (..., N) in metres.
    """

    poses: Poses
    frame: Floats
    beta: Floats
    psi: Floats
    eps: Floats
    distance: Floats


@dataclass(frozen=True)
class Together:
    """What is adjusted together, the same in every step: groups, nests, and how they weigh.

    ``nest_weight`` (Q, 3, 3) are inverse covariances (1/m^2), ``tilt_std`` (rad) is the table's.
    """

    pairs: MirrorPairs
    nests: Nests
    nest_weight: Floats
    tilt_std: float


@dataclass(frozen=True)
class Equations:
    """Normal equations with the nests eliminated.

    ``local`` (..., N, 3, 3) of the unknowns of each position, ``shared`` (..., c, c) of the common
    ones, ``coupling`` (..., N, 3, c) between them; their right sides, and the ``chi_square`` (...)
    where they are linearised.
    """

    local: Floats
    coupling: Floats
    shared: Floats
    local_right: Floats
    shared_right: Floats
    chi_square: Floats


def start_mirror(normals: Normals, pairs: MirrorPairs, poses: Poses, angles: Floats) -> Mirror:
    """Return approximate unknowns from registered normals.

    Of a position that several stations see, the first one's normal serves.
    """
    placed = poses.turned(normals.normal, pairs.station)
    axis, height = fit_cone(placed, angles[pairs.position])
    frame = np.stack([*axis_frame(placed[..., 0, :], axis), axis], axis=-1)
    tracker = poses.translation[..., pairs.station, :]
    distance = normals.offset + np.einsum("...gi,...gi->...g", placed, tracker)
    _, first = np.unique(pairs.position, return_index=True)
    psi = azimuths(placed, axis)[..., first]
    return Mirror(poses, frame, np.arcsin(height), psi, np.zeros_like(psi), distance[..., first])


def adjust_joint(
    points: Floats, normals: Normals, together: Together, start: Mirror, steps: int = _MAX_STEPS
) -> Mirror:
    """Return the unknowns that fit best, by Gauss-Newton."""
    mirror = _for_trials(start, normals.offset.shape[:-1])
    for _ in range(steps):
        equations = joint_equations(points, normals, together, mirror)
        change, shared = _solved(equations)
        mirror = _moved(mirror, change, shared)
        if max(np.abs(change).max(), np.abs(shared).max()) < _TOLERANCE:
            break
    return mirror


def joint_equations(
    points: Floats, normals: Normals, together: Together, mirror: Mirror
) -> Equations:
    """Linearise at ``mirror``; positions are in ascending order, all of them observed."""
    pairs, nests, tilt_std = together.pairs, together.nests, together.tilt_std
    local, shared, discrepancy, weight = group_terms(normals, pairs, mirror)
    order = np.argsort(pairs.position, kind="stable")
    start = np.searchsorted(pairs.position[order], np.arange(mirror.psi.shape[-1]))

    def per_position(values: Floats, axis: int) -> Floats:
        return np.add.reduceat(np.take(values, order, axis=axis), start, axis=axis)

    local_weight = np.swapaxes(local, -1, -2) @ weight
    pull = weight @ discrepancy[..., None]
    block = per_position(local_weight @ local, -3)
    block[..., 1, 1] += tilt_std**-2  # eps is observed to be zero, with this uncertainty
    local_right = per_position((local_weight @ discrepancy[..., None])[..., 0], -2)
    local_right[..., 1] -= mirror.eps * tilt_std**-2
    flat = (*shared.shape[:-3], -1, shared.shape[-1])  # all rows of all groups below each other
    transposed = np.swapaxes(shared.reshape(flat), -1, -2)
    matrix = transposed @ (weight @ shared).reshape(flat)
    right = (transposed @ pull.reshape(*flat[:-1], 1))[..., 0]
    chi_square = np.einsum("...gi,...gi->...", discrepancy, pull[..., 0])
    chi_square = chi_square + (mirror.eps**2).sum(axis=-1) * tilt_std**-2
    p = flat[-1] - _SHARED
    if p:
        weights, poses = together.nest_weight, mirror.poses
        nest_normal, nest_right, residual = nest_equations(points, nests, weights, poses)
        matrix[..., :p, :p] += nest_normal
        right[..., :p] += nest_right
        chi_square = chi_square + _nest_chi_square(residual, nests, weights, poses)
    return Equations(
        block, per_position(local_weight @ shared, -3), matrix, local_right, right, chi_square
    )


def _solved(equations: Equations) -> tuple[Floats, Floats]:
    """Return the changes of the positions (..., N, 3) and of the shared unknowns (..., c).

    The positions are eliminated first (Schur complement), as no two of them touch.
    """
    solved = np.linalg.solve(equations.local, equations.coupling)
    free = np.linalg.solve(equations.local, equations.local_right[..., None])
    flat = (*solved.shape[:-3], -1, solved.shape[-1])
    transposed = np.swapaxes(equations.coupling.reshape(flat), -1, -2)
    matrix = equations.shared - transposed @ solved.reshape(flat)
    right = equations.shared_right[..., None] - transposed @ free.reshape(*flat[:-1], 1)
    shared = np.linalg.solve(matrix, right)
    local = free - solved @ shared[..., None, :, :]
    return local[..., 0], shared[..., 0]


def angle_covariance(equations: Equations) -> Floats:
    """Return the covariance (N, N) in rad^2 of psi: of each alone, and by the shared unknowns."""
    inverse = np.linalg.inv(equations.local)
    solved = inverse @ equations.coupling
    flat = (-1, solved.shape[-1])
    matrix = equations.shared - equations.coupling.reshape(flat).T @ solved.reshape(flat)
    lean = solved[:, 0, :]
    return np.diag(inverse[:, 0, 0]) + lean @ np.linalg.solve(matrix, lean.T)


def _nest_chi_square(residual: Floats, nests: Nests, weight: Floats, poses: Poses) -> Floats:
    """Return the weighted sum of squares (...) of nest residuals (..., Q, 3)."""
    rotation = poses.rotation[..., nests.station, :, :]
    own = np.einsum("...qji,...qj->...qi", rotation, residual)  # along the axes of the stations
    chi_square: Floats = np.einsum("...qi,qij,...qj->...", own, weight, own)
    return chi_square


def group_terms(
    normals: Normals, pairs: MirrorPairs, mirror: Mirror
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return what each group of pairs says of the unknowns, at the model of ``mirror``.

    These are the derivatives (..., G, 3, 3) by (psi, eps, d) and (..., G, 3, c) by the shared
    unknowns, the discrepancies (..., G, 3), observed - computed, and their weights (..., G, 3, 3).
    The three rows are the plane's normal along t and along b, and its offset from the tracker.
    """
    elevation = (mirror.beta[..., None] + mirror.eps)[..., pairs.position]
    psi = mirror.psi[..., pairs.position]
    n, t, b = _model_normals(mirror.frame, elevation, psi)
    tracker = mirror.poses.translation[..., pairs.station, :]
    observed = mirror.poses.turned(normals.normal, pairs.station)
    t_arm, b_arm = _dot(t, tracker), _dot(b, tracker)
    expected = mirror.distance[..., pairs.position] - _dot(n, tracker)
    discrepancy = np.stack(
        [_dot(t, observed), _dot(b, observed), normals.offset - expected], axis=-1
    )
    local = np.zeros((*psi.shape, 3, 3))
    local[..., 0, 0] = np.cos(elevation)
    local[..., 1, 1] = local[..., 2, 2] = 1.0
    local[..., 2, 0], local[..., 2, 1] = -local[..., 0, 0] * t_arm, -b_arm

    p = 6 * (mirror.poses.rotation.shape[-3] - 1)
    shared = np.zeros((*psi.shape, 3, p + _SHARED))
    sine = np.sin(elevation)
    shared[..., 0, p], shared[..., 0, p + 1] = -sine * np.sin(psi), sine * np.cos(psi)
    shared[..., 1, p], shared[..., 1, p + 1] = -np.cos(psi), -np.sin(psi)
    shared[..., 1, p + 2] = 1.0  # beta
    # A normal that turns about the origin changes the plane's offset from a tracker away from it.
    shared[..., 2, p:] = -(
        t_arm[..., None] * shared[..., 0, p:] + b_arm[..., None] * shared[..., 1, p:]
    )
    # A station that turns or shifts sees the same plane moved the other way.
    movable, columns = station_columns(pairs.station)
    shared[..., movable[:, None], 0, columns[:, :3]] = -b[..., movable, :]
    shared[..., movable[:, None], 1, columns[:, :3]] = t[..., movable, :]
    shared[..., movable[:, None], 2, columns[:, 3:]] = -n[..., movable, :]
    return local, shared, discrepancy, plane_weight(normals, pairs, mirror.poses, t, b)


def plane_weight(
    normals: Normals, pairs: MirrorPairs, poses: Poses, t: Floats, b: Floats
) -> Floats:
    """Return the inverse covariance (..., G, 3, 3) of each plane: n along t, along b, offset.

    t and b (..., G, 3) are unit vectors in the common frame.
    """
    basis = plane_basis(poses, pairs.station, t, b)
    return np.swapaxes(basis, -1, -2) @ normals.information @ basis


def plane_basis(poses: Poses, station: Ints, t: Floats, b: Floats) -> Floats:
    """Return changes (..., G, 4, 3) of (n, h) in the frame of each group's station.

    They are n along t, n along b, and h; t and b (..., G, 3) are given in the common frame.
    """
    rotation = poses.rotation[..., station, :, :]
    across = np.swapaxes(rotation, -1, -2) @ np.stack([t, b], axis=-1)
    basis = np.zeros((*across.shape[:-2], 4, 3))
    basis[..., :3, :2], basis[..., 3, 2] = across, 1.0
    return basis


def _model_normals(frame: Floats, elevation: Floats, psi: Floats) -> tuple[Floats, Floats, Floats]:
    """Return normals n with t and b (..., G, 3) across them, along the common axes."""
    ce, se, cp, sp = np.cos(elevation), np.sin(elevation), np.cos(psi), np.sin(psi)
    own = (
        np.stack([ce * cp, ce * sp, se], axis=-1),
        np.stack([-sp, cp, np.zeros_like(sp)], axis=-1),
        np.stack([-se * cp, -se * sp, ce], axis=-1),
    )
    n, t, b = (vectors @ np.swapaxes(frame, -1, -2) for vectors in own)
    return n, t, b


def _for_trials(mirror: Mirror, trials: tuple[int, ...]) -> Mirror:
    """Return the same unknowns for each of the ``trials``, the leading axes."""

    def spread(values: Floats, own: int) -> Floats:
        return np.broadcast_to(values, (*trials, *values.shape[values.ndim - own :]))

    poses = Poses(spread(mirror.poses.rotation, 3), spread(mirror.poses.translation, 2))
    return Mirror(
        poses,
        spread(mirror.frame, 2),
        spread(np.asarray(mirror.beta), 0),
        spread(mirror.psi, 1),
        spread(mirror.eps, 1),
        spread(mirror.distance, 1),
    )


def _moved(mirror: Mirror, local: Floats, shared: Floats) -> Mirror:
    """Return the unknowns after a change of those of positions and of the shared ones."""
    p = shared.shape[-1] - _SHARED
    # The axis leans by u along e1 and v along e2: a turn by (-v, u, 0) in the mirror's own frame.
    tilt = np.stack([-shared[..., p + 1], shared[..., p], np.zeros(shared.shape[:-1])], axis=-1)
    return replace(
        mirror,
        poses=mirror.poses.moved(shared[..., :p]) if p else mirror.poses,
        frame=mirror.frame @ rotation_from_vector(tilt),
        beta=mirror.beta + shared[..., p + 2],
        psi=mirror.psi + local[..., 0],
        eps=mirror.eps + local[..., 1],
        distance=mirror.distance + local[..., 2],
    )


def _dot(a: Floats, b: Floats) -> Floats:
    product: Floats = np.einsum("...i,...i->...", a, b)
    return product
