"""Registration: fixed nests bring all tracker stations into the frame of the first.

All stations and nests are adjusted together (the paper maps each station to the first one; with
all nests seen by both that is the same transform, and here the noise of the first station's nests
is counted once). Pose changes are (rotation about the tracker, shift) in the common frame, six per
station, the first station fixed: p = 6 (S - 1) columns.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import GeometryError
from rotcal_ros.geometry.rotations import align, cross_matrix, require_spread, rotation_from_vector
from rotcal_ros.methods.plane_mirror.solver.layout import Nests
from rotcal_ros.methods.plane_mirror.solver.problem import PlaneMirrorProblem

_MAX_STEPS: Final = 30
_TOLERANCE: Final = 1e-14


@dataclass(frozen=True)
class Poses:
    """Tracker stations in the frame of the first: X = ``rotation`` x + ``translation`` (metres).

    ``rotation`` is (..., S, 3, 3), ``translation`` (..., S, 3), the place of the tracker.
    """

    rotation: Floats
    translation: Floats

    def turned(self, points: Floats, station: Ints) -> Floats:
        """Return vectors (..., m, 3) seen from ``station`` (m,) along the common axes."""
        rotation = self.rotation[..., station, :, :]
        vectors: Floats = np.einsum("...mij,...mj->...mi", rotation, points)
        return vectors

    def placed(self, points: Floats, station: Ints) -> Floats:
        """Return points (..., m, 3) seen from ``station`` (m,) in the common frame."""
        return self.turned(points, station) + self.translation[..., station, :]

    def moved(self, change: Floats) -> Poses:
        """Return poses after a change (..., p) of all stations but the first."""
        steps = change.reshape(*change.shape[:-1], -1, 6)
        shape = np.broadcast_shapes(steps.shape[:-2], self.rotation.shape[:-3])
        rotation = np.broadcast_to(self.rotation, (*shape, *self.rotation.shape[-3:])).copy()
        translation = np.broadcast_to(
            self.translation, (*shape, *self.translation.shape[-2:])
        ).copy()
        rotation[..., 1:, :, :] = rotation_from_vector(steps[..., :3]) @ rotation[..., 1:, :, :]
        translation[..., 1:, :] += steps[..., 3:]
        return Poses(rotation, translation)


def station_columns(station: Ints) -> tuple[Ints, Ints]:
    """Return the entries (k,) that do not stand at the first station, and their columns (k, 6)."""
    movable = np.flatnonzero(station > 0)
    columns = 6 * (station[movable] - 1)[:, None] + np.arange(6)
    return movable, columns


def nest_equations(
    points: Floats, nests: Nests, weight: Floats, poses: Poses
) -> tuple[Floats, Floats, Floats]:
    """Return the normal matrix (..., p, p), its right side (..., p) and the residuals (..., Q, 3).

    The nests themselves are eliminated: each stands at the weighted mean of its observations.
    ``weight`` (Q, 3, 3) are inverse covariances along the axes of each station. Residual =
    observed - computed in the common frame, metres.
    """
    arm = poses.turned(points[..., nests.row, :], nests.station)
    rotation = poses.rotation[..., nests.station, :, :]
    turned_weight = rotation @ weight @ np.swapaxes(rotation, -1, -2)
    place = arm + poses.translation[..., nests.station, :]
    total = np.add.reduceat(turned_weight, nests.start, axis=-3)
    pulled = np.add.reduceat(
        np.einsum("...qij,...qj->...qi", turned_weight, place), nests.start, axis=-2
    )
    nest = np.linalg.solve(total, pulled[..., None])[..., 0]
    residual = place - nest[..., nests.point, :]
    jacobian = pose_jacobian(arm, nests.station, poses.rotation.shape[-3])
    weighted = turned_weight @ jacobian
    per_nest = np.add.reduceat(weighted, nests.start, axis=-3)
    flat = (*jacobian.shape[:-3], -1, jacobian.shape[-1])
    transposed = np.swapaxes(weighted.reshape(flat), -1, -2)
    eliminated = np.linalg.solve(total, per_nest).reshape(flat)
    normal = transposed @ jacobian.reshape(flat)
    normal = normal - np.swapaxes(per_nest.reshape(flat), -1, -2) @ eliminated
    right = -transposed @ residual.reshape(*flat[:-1], 1)
    return normal, right[..., 0], residual


def adjust_stations(
    points: Floats, nests: Nests, weight: Floats, start: Poses, steps: int = _MAX_STEPS
) -> Poses:
    """Adjust all stations to the nests by Gauss-Newton; ``points`` (..., n, 3) with any trials."""
    poses = start
    for _ in range(steps):
        normal, right, _ = nest_equations(points, nests, weight, poses)
        change = np.asarray(np.linalg.solve(normal, right[..., None])[..., 0], dtype=np.float64)
        poses = poses.moved(change)
        if np.abs(change).max(initial=0.0) < _TOLERANCE:
            break
    return poses


def place_stations(problem: PlaneMirrorProblem, nests: Nests) -> Poses:
    """Place station after station from nests whose places are known already.

    Raises GeometryError naming the station that shares fewer than three nests with the others,
    or only nests in a line.
    """
    n_stations = int(problem.station.max()) + 1
    rotation = np.tile(np.eye(3), (n_stations, 1, 1))
    translation = np.zeros((n_stations, 3))
    known = np.full((nests.n_points, 3), np.nan)
    waiting = list(range(1, n_stations))
    _learn(known, problem, nests, 0, np.eye(3), np.zeros(3))
    while waiting:
        shared = [_shared(known, nests, station) for station in waiting]
        station = waiting.pop(int(np.argmax([len(rows) for rows in shared])))
        rows = max(shared, key=len)
        target = known[nests.point[rows]]
        _require_nests(problem, nests, station, rows, target)
        source = problem.xyz[nests.row[rows]]
        rotation[station], translation[station] = align(source, target)
        _learn(known, problem, nests, station, rotation[station], translation[station])
    return Poses(rotation, translation)


def _shared(known: Floats, nests: Nests, station: int) -> Ints:
    """Entries of the nests that a station sees and whose place is known, one per nest."""
    seen = (nests.station == station) & np.isfinite(known[nests.point, 0])
    _, first = np.unique(nests.point[seen], return_index=True)
    return np.flatnonzero(seen)[first]


def _learn(
    known: Floats,
    problem: PlaneMirrorProblem,
    nests: Nests,
    station: int,
    rotation: Floats,
    translation: Floats,
) -> None:
    for entry in np.flatnonzero(nests.station == station):
        if np.isnan(known[nests.point[entry], 0]):
            known[nests.point[entry]] = rotation @ problem.xyz[nests.row[entry]] + translation


def _require_nests(
    problem: PlaneMirrorProblem, nests: Nests, station: int, rows: Ints, target: Floats
) -> None:
    names = ", ".join(str(name) for name in nests.name[nests.point[rows]])
    where = f"{problem.source}: tracker station {problem.station_name(station)}"
    if len(rows) < 3:
        raise GeometryError(
            f"{where} shares {len(rows)} nests ({names or 'none'}) with the stations placed "
            "before it, registration needs 3; measure more nests from there, or choose stitching"
        )
    require_spread(target, f"{where}: the nests {names} that it shares with the others")


def pose_jacobian(arm: Floats, station: Ints, n_stations: int) -> Floats:
    """Change (..., Q, 3, p) of the placed points per pose change."""
    jacobian = np.zeros((*arm.shape, 6 * (n_stations - 1)))
    movable, columns = station_columns(station)
    block = np.concatenate(
        [
            -cross_matrix(arm[..., movable, :]),
            np.broadcast_to(np.eye(3), (*arm[..., movable, :].shape, 3)),
        ],
        axis=-1,
    )
    for axis in range(3):
        jacobian[..., movable[:, None], axis, columns] = block[..., axis, :]
    return jacobian
