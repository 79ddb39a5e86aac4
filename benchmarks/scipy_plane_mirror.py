"""The joint problem written out plainly for scipy: points, planes, poses and nests unknown."""

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from rotcal_ros.foundation.observations import PointKind


def joint_least_squares(problem):
    """Deviations from the first position, their covariance, and the cost; slow and accurate."""
    residual, start, n = joint_residual(problem)
    best = least_squares(residual, start, jac="3-point", x_scale="jac",
                         xtol=1e-15, ftol=1e-15, gtol=1e-15)  # fmt: skip
    covariance = np.linalg.inv(best.jac.T @ best.jac)[:n, :n]
    contrast = np.eye(n)
    contrast[:, 0] -= 1.0
    return deviations_of(problem, best.x[:n]), contrast @ covariance @ contrast.T, best.cost


def deviations_of(problem, psi):
    """Deviations from the first position of the angles psi (N,)."""
    turn = psi - psi[0] - (problem.angles - problem.angles[0])
    return (turn + np.pi) % (2 * np.pi) - np.pi


def joint_residual(problem):
    """Whitened residual function, start values, number of positions.

    Unknowns: psi (N), distance (N), eps (N), beta, axis tilts (2), poses (6 each), nests, and the
    places of all reflectors in the first frame. Start values come from two exact observations.
    """
    n = len(problem.angles)
    station, xyz = problem.station, problem.xyz
    whiten = np.linalg.inv(np.linalg.cholesky(problem.noise.covariance(xyz)))
    direct, mirrored, nest = rows_of(problem)
    names, nest_index = np.unique(problem.nest[nest], return_inverse=True)
    start, frame, n_stations = start_values(problem)

    def residual(x):
        psi, d, eps, rest = x[:n], x[n : 2 * n], x[2 * n : 3 * n], x[3 * n :]
        beta, tilt, rest = rest[0], rest[1:3], rest[3:]
        change = np.vstack([np.zeros(6), rest[: 6 * (n_stations - 1)].reshape(-1, 6)])
        rest = rest[6 * (n_stations - 1) :]
        nests, points = (
            rest[: 3 * len(names)].reshape(-1, 3),
            rest[3 * len(names) :].reshape(-1, 3),
        )
        lean = beta + eps
        own = np.stack(
            [np.cos(lean) * np.cos(psi), np.cos(lean) * np.sin(psi), np.sin(lean)], axis=1
        )
        n_i = own @ (frame @ Rotation.from_rotvec([-tilt[1], tilt[0], 0.0]).as_matrix()).T
        at = problem.position[direct]
        computed = np.empty_like(xyz)
        computed[direct] = points
        high = np.einsum("ij,ij->i", points, n_i[at]) - d[at]
        computed[mirrored] = points - 2.0 * high[:, None] * n_i[at]
        computed[nest] = nests[nest_index]
        back = Rotation.from_rotvec(change[station, :3]).inv()
        computed = back.apply(computed - change[station, 3:])
        white = np.einsum("nij,nj->ni", whiten, xyz - computed)
        return np.concatenate([white.ravel(), eps / problem.tilt_std])

    return residual, start, n


def rows_of(problem):
    """Rows of the direct points, of their images, and of the nests."""
    kinds = PointKind.DIRECT, PointKind.MIRRORED, PointKind.NEST
    return tuple(np.flatnonzero(problem.kind == kind) for kind in kinds)


def start_values(problem):
    """Start values of all unknowns, frame (3, 3) of the table's axis, number of stations."""
    n = len(problem.angles)
    direct, mirrored, nest = rows_of(problem)  # an image is measured right after its direct point
    names, nest_index = np.unique(problem.nest[nest], return_inverse=True)
    poses = station_poses(problem, nest)
    turns = Rotation.from_rotvec(poses[problem.station, :3])
    placed = turns.apply(problem.xyz) + poses[problem.station, 3:]
    normals = placed[direct] - placed[mirrored]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    frame = axis_frame(normals, problem.angles[problem.position[direct]])
    height = np.einsum("ij,ij->i", normals, 0.5 * (placed[direct] + placed[mirrored]))
    distance = np.array([height[problem.position[direct] == i].mean() for i in range(n)])
    places = np.array([placed[nest][nest_index == k].mean(0) for k in range(len(names))])
    start = np.concatenate([
        problem.angles - problem.angles[0], distance, np.zeros(n),
        [np.arcsin((normals @ frame[:, 2]).mean()), 0.0, 0.0], poses[1:].ravel(), places.ravel(),
        placed[direct].ravel(),
    ])  # fmt: skip
    return start, frame, len(poses)


def station_poses(problem, nest):
    """Rotation vector and shift (S, 6) that bring each station's nests to those of the first."""
    station, xyz = problem.station, problem.xyz
    poses = [np.zeros(6)]
    first = {problem.nest[r]: xyz[r] for r in nest if station[r] == 0}
    for s in range(1, station.max() + 1):
        rows = [r for r in nest if station[r] == s]
        here = np.array([xyz[r] for r in rows])
        there = np.array([first[problem.nest[r]] for r in rows])
        turn, _ = Rotation.align_vectors(there - there.mean(0), here - here.mean(0))
        poses.append(np.concatenate([turn.as_rotvec(), there.mean(0) - turn.apply(here.mean(0))]))
    return np.array(poses)


def axis_frame(normals, angles):
    """Frame (3, 3) with the table's axis as z, x towards the first of the mirror's normals."""
    _, _, vt = np.linalg.svd(normals - normals.mean(0))
    axis = vt[2]
    turned = np.cross(normals[0], normals) @ axis
    if turned @ np.sin(angles - angles[0]) < 0:
        axis = -axis
    e2 = np.cross(axis, normals[0])
    e2 /= np.linalg.norm(e2)
    return np.column_stack([np.cross(e2, axis), e2, axis])
