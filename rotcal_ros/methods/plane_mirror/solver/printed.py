"""The paper's own ways, as printed: stitching, registration, and circles of reflectors.

Muralikrishnan et al., "A Method to Calibrate Angular Positioning Errors Using a Laser Tracker and
a Plane Mirror". The paper's errors are commanded - measured; here the sign is turned. A way knows
nothing of noise, drift or outliers: what is to be said of its values, the engine says
(:mod:`.solve`).

* Sec. 2.2: a reflector M is seen through the mirror at M', the normal n is along M - M'. Several
  reflectors of a position: the mean of M - M'.
* Stitching, Eq. 6 to 16: of each station the plane through the ends of its normals; projected on
  it, the normals give angles from the first (Eq. 6), and the error at the last position of a
  station is the zero of the next. With more shared positions than one the zeros fit all of them.
* Registration, Eq. 17 to 19: nests bring each station into the frame of the first, then all
  normals have one plane and one set of angles.
* Direct: reflectors on the table instead of a mirror; plane and circle (Kasa) through the places
  of each, angles about its centre, and the mean over reflectors.

Slip: the paper's last station has two normals and thus no plane. All normals make the same angle
with the axis, so the height that the other stations find gives its axis, too
(:func:`axis_of_two`).

"..." are leading axes: many sets of points at once. Angles are rad, lengths m.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.geometry.rotations import align, wrap_angle
from rotcal_ros.methods.plane_mirror.settings import STITCHING
from rotcal_ros.methods.plane_mirror.solver.problem import MirrorPairs, Nests, PointLayout, Sets

STEP: Final = 1e-6
"""By which points are moved (m) to see what that does; the ways are linear to 1e-6 there."""


@dataclass(frozen=True)
class Poses:
    """Tracker stations in the frame of the first: X = ``rotation`` x + ``place`` (m).

    ``rotation`` is (..., S, 3, 3), ``place`` (..., S, 3).
    """

    rotation: Floats
    place: Floats

    @classmethod
    def untied(cls, count: int) -> Poses:
        """Return stations that all stand in the origin, none of them turned."""
        return cls(np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)))

    def turned(self, vectors: Floats, station: Ints) -> Floats:
        """Return vectors (..., m, 3) seen from ``station`` (m,) along the common axes."""
        return np.asarray(
            np.einsum("...mij,...mj->...mi", self.rotation[..., station, :, :], vectors)
        )

    def placed(self, points: Floats, station: Ints) -> Floats:
        """Return points (..., m, 3) seen from ``station`` (m,) in the common frame."""
        return self.turned(points, station) + self.place[..., station, :]


def deviation_curve(layout: PointLayout, way: str, points: Floats) -> Floats:
    """Return the deviations (..., N) from the first position, by a printed way, of all points."""
    sets = layout.sets(by_station=way == STITCHING)
    poses = Poses.untied(len(layout.stations))
    if way != STITCHING and len(layout.stations) > 1:
        poses = placed_stations(points, layout.nests, len(layout.stations))
    if layout.pairs is None:
        own = layout.reflectors
        places = poses.placed(np.take(points, own.row, axis=-2), own.station)
        readings, position = circle_readings(places, sets), own.position
    else:
        normals = mean_normals(points, layout.pairs)
        normals = poses.turned(normals, layout.pairs.station)
        readings, position = cone_readings(normals, sets), layout.pairs.position
    joining = joining_map(position, sets.number, len(layout.angles))
    return np.asarray(readings @ joining.T)


def curve_derivative(layout: PointLayout, way: str, rows: Ints) -> Floats:
    """Return the derivative (N, k, 3) of `deviation_curve` by the points of ``rows`` (k,)."""
    points, count = layout.problem.xyz, 3 * len(rows)
    found = np.zeros((len(layout.angles), count))
    for some in np.array_split(np.arange(count), count * points.size // 4_000_000 + 1):
        moved = np.repeat(points[None], 2 * len(some), axis=0)
        each = np.arange(len(some))
        moved[each, rows[some // 3], some % 3] += STEP
        moved[len(some) + each, rows[some // 3], some % 3] -= STEP
        ahead, behind = np.split(deviation_curve(layout, way, moved), 2)
        found[:, some] = (ahead - behind).T / (2.0 * STEP)
    return found.reshape(len(found), -1, 3)


def mean_normals(points: Floats, pairs: MirrorPairs) -> Floats:
    """Return the normals (..., G, 3) of the groups, along the mean of M - M' (Sec. 2.2)."""
    apart = points[..., pairs.direct, :] - points[..., pairs.mirrored, :]
    normals = np.add.reduceat(apart, pairs.start, axis=-2)
    return np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True))


def placed_stations(points: Floats, nests: Nests, count: int) -> Poses:
    """Return ``count`` stations, each placed by the nests that it shares with those before it.

    As the paper maps each to the first (Eq. 17); a station that sees less of these nests takes
    those that the others have found. Of several readings of a nest from a station their mean.
    """
    shape = points.shape[:-2]
    poses = Poses(np.zeros((*shape, count, 3, 3)), np.zeros((*shape, count, 3)))
    poses.rotation[..., 0, :, :] = np.eye(3)
    known, seen = np.zeros((*shape, nests.n_points, 3)), np.zeros(nests.n_points, dtype=np.bool_)
    for station, own, of_own in nests.order_of_placing(count):
        mean = np.stack([points[..., rows, :].mean(axis=-2) for rows in of_own], axis=-2)
        if station:
            both = seen[own]
            turn, shift = align(mean[..., both, :], known[..., own[both], :])
            poses.rotation[..., station, :, :], poses.place[..., station, :] = turn, shift
        placed = poses.placed(mean, np.full(len(own), station))
        known[..., own[~seen[own]], :] = placed[..., ~seen[own], :]
        seen[own] = True
    return poses


def joining_map(position: Ints, zero: Ints, n: int) -> Floats:
    """Return the matrix (n, m) from readings (m,), each with the zero of its set, to deviations.

    The sum of Eq. 7 to 16 where sets share one position each. Positions that nothing ties to the
    first count from the first of their own :func:`connected_islands`.
    """
    m = len(position)
    design = np.zeros((m, n + int(zero.max()) + 1))
    design[np.arange(m), position] = 1.0
    design[np.arange(m), n + zero] = 1.0
    label = connected_islands(position, zero, n)[0]
    counted = np.setdiff1d(np.arange(n), np.unique(label, return_index=True)[1])
    unknown = np.append(counted, np.arange(n, design.shape[1]))
    joined = np.zeros((n, m))
    joined[counted] = np.linalg.pinv(design[:, unknown])[: len(counted)]
    return joined


def connected_islands(position: Ints, zero: Ints, n: int) -> tuple[Ints, Ints]:
    """Return the island of each position (n,) and of each set; one island: all are tied."""
    sets = int(zero.max()) + 1
    # a matrix, not an array: of 64-bit indices scipy 1.11 makes labels that are wrong
    links = coo_matrix((np.ones(len(position)), (position, n + zero)), shape=(n + sets, n + sets))
    _, label = connected_components(links, directed=False)
    return label[:n].astype(np.int64), label[n:].astype(np.int64)


def cone_readings(normals: Floats, sets: Sets) -> Floats:
    """Return one deviation (..., G) per normal (..., G, 3), from the first of its set."""
    axes, _ = cone_axes(normals, sets)
    readings = np.zeros(normals.shape[:-1])
    for at, commanded in sets:
        if len(at) > 1:
            seen = azimuths(normals[..., at, :], axes[..., at[0], :])
            readings[..., at] = wrap_angle(seen - (commanded - commanded[0]))
    return readings


def cone_axes(normals: Floats, sets: Sets) -> tuple[Floats, Floats]:
    """Return the axis (..., G, 3) that each normal turns about, and the height of all (...).

    The height, a.n, is the mean over the sets of three or more normals, which have a plane.
    """
    axes, heights = np.zeros_like(normals), []
    for at, commanded in sets:
        if len(at) >= 3:
            axis, height = fit_cone(normals[..., at, :], commanded)
            axes[..., at, :] = axis[..., None, :]
            heights += [height] * len(at)
    height = np.mean(heights, axis=0) if heights else np.zeros(normals.shape[:-2])
    for at, commanded in sets:
        if len(at) == 2:
            axes[..., at, :] = axis_of_two(normals[..., at, :], height, commanded)[..., None, :]
        elif len(at) == 1:  # no angle comes from it, any axis across it will do
            aside = np.argmax(np.abs(normals[..., at, :]), axis=-1)
            axes[..., at, :] = np.eye(3)[(aside + 1) % 3]
    return axes, height


def fit_cone(normals: Floats, commanded: Floats) -> tuple[Floats, Floats]:
    """Return axis (..., 3) and height (...) of the plane through ends of normals (..., m, 3).

    The axis points so that the normals turn the same way as the ``commanded`` angles (m,).
    """
    centre = normals.mean(axis=-2)
    axis = np.linalg.svd(normals - centre[..., None, :], full_matrices=False)[2][..., -1, :]
    axis = axis * turning_sense(normals, axis, commanded)[..., None]
    return axis, np.einsum("...i,...i->...", centre, axis)


def axis_of_two(normals: Floats, height: Floats, commanded: Floats) -> Floats:
    """Return the axis (..., 3) about which two normals (..., 2, 3) have a known ``height`` s.

    With a.n1 = a.n2 = s it has the part s (n1 + n2) / (1 + n1.n2) in their plane; the rest is
    along n1 x n2, turned as the ``commanded`` angles (2,) say.
    """
    first, second = normals[..., 0, :], normals[..., 1, :]
    cosine = np.einsum("...i,...i->...", first, second)
    in_plane = (height / (1.0 + cosine))[..., None] * (first + second)
    across = np.cross(first, second)
    across = across / np.linalg.norm(across, axis=-1, keepdims=True)
    rest = np.sqrt(1.0 - np.einsum("...i,...i->...", in_plane, in_plane))
    sense = np.sign(np.sin(commanded[1] - commanded[0]))
    return np.asarray(in_plane + sense * rest[..., None] * across)


def turning_sense(vectors: Floats, axis: Floats, commanded: Floats) -> Floats:
    """Return +1 where vectors (..., m, 3) turn about the axis as the command does, else -1."""
    cross = np.cross(vectors[..., :-1, :], vectors[..., 1:, :])
    turned = np.einsum("...mi,...i->...m", cross, axis)
    votes = np.einsum("...m,m->...", turned, np.sin(np.diff(commanded)))
    return np.where(votes < 0.0, -1.0, 1.0)


def azimuths(vectors: Floats, axis: Floats) -> Floats:
    """Return the angles (..., m) in (-pi, pi] about ``axis`` (..., 3), from the first vector."""
    side = np.cross(axis, vectors[..., 0, :])
    front = np.cross(side, axis)
    return np.asarray(
        np.arctan2(
            np.einsum("...mi,...i->...m", vectors, side),
            np.einsum("...mi,...i->...m", vectors, front),
        )
    )


def circle_readings(places: Floats, sets: Sets) -> Floats:
    """Return one deviation (..., M) per place (..., M, 3), from the first of its reflector."""
    readings = np.zeros(places.shape[:-1])
    for at, commanded in sets:
        axis, centre, _ = fit_circle(places[..., at, :], commanded)
        seen = azimuths(places[..., at, :] - centre[..., None, :], axis)
        readings[..., at] = wrap_angle(seen - (commanded - commanded[0]))
    return readings


def fit_circle(points: Floats, commanded: Floats) -> tuple[Floats, Floats, Floats]:
    """Return axis (..., 3), centre (..., 3) and radius (...) of the circle through (..., m, 3).

    Plane by singular values, circle by Kasa's algebraic fit in it, about the centre of mass and
    in units of the spread, so that no digits are lost.
    """
    middle = points.mean(axis=-2, keepdims=True)
    arms = points - middle
    scale = np.sqrt((arms**2).sum(axis=-1).mean(axis=-1))[..., None, None]
    across = np.linalg.svd(arms, full_matrices=False)[2]
    axis = across[..., 2, :] * turning_sense(arms, across[..., 2, :], commanded)[..., None]
    plane = across[..., :2, :]
    flat = arms @ np.swapaxes(plane, -1, -2) / scale
    # x^2 + y^2 = 2 a x + 2 b y + c is linear in the centre (a, b) and in c = r^2 - a^2 - b^2.
    design = np.concatenate([2.0 * flat, np.ones((*flat.shape[:-1], 1))], axis=-1)
    squares = (flat**2).sum(axis=-1)[..., None]
    transposed = np.swapaxes(design, -1, -2)
    solution = np.linalg.solve(transposed @ design, transposed @ squares)[..., 0]
    radius = np.sqrt(solution[..., 2] + (solution[..., :2] ** 2).sum(axis=-1))
    shift = (solution[..., None, :2] * scale) @ plane
    return axis, (middle + shift)[..., 0, :], radius * scale[..., 0, 0]
