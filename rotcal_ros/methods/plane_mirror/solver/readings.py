"""Readings of table angles: their values, how they feel noise, and how they join to deviations.

Every reading is

    deviation(position) + zero(set) + error,

where a set is what shares a zero (:class:`~.problem.Sets`): a tracker station in stitching, a
reflector in the direct way, everything in registration. Sets are tied by the positions they share,
and :func:`joining_map` is the least squares of that. With one shared position from set to set it
is the running sum of the paper (Muralikrishnan et al., equations 7 to 16); with more, all ties are
used.

* Stitching: each tracker station finds the table axis and the angles from its own normals.
* Registration: all normals, brought to common axes by the nests, are one set: they stand on one
  cone.
* Direct: reflectors carried by the table, angles about the centre of their circle.

For each there is the derivative of the readings by the movements of what is measured, at the
nominal angles, and the covariance of these movements. The mirror ways feel two movements of each
of G normals, tau along t (rotation) and eta along b (tilt), in that order 2 G numbers in rad; the
direct way feels tangential, radial and axial movements of M places, 3 M numbers in m. The
derivatives leave open the zero of each set, which the joining takes away.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import DataError, GeometryError
from rotcal_ros.methods.plane_mirror.solver.joint import plane_weight
from rotcal_ros.methods.plane_mirror.solver.normals import (
    Normals,
    angle_deviation,
    axis_of_two,
    axis_response,
    azimuth_response,
    azimuths,
    circle_columns,
    circle_design,
    fit_cone,
    tangent_frame,
    turning_sense,
    two_axis_response,
)
from rotcal_ros.methods.plane_mirror.solver.problem import (
    MirrorPairs,
    PlaneMirrorProblem,
    Reflectors,
    Sets,
)
from rotcal_ros.methods.plane_mirror.solver.registration import Poses, station_columns

_MIN_ARC: Final = 5e-3
"""Smallest singular value of an arc of directions, about its height: four degrees end to end."""
_MIN_CIRCLE: Final = 1e-3
"""Smallest singular value of the places on a circle that show its centre and radius."""


def reading_design(position: Ints, zero: Ints, n: int) -> Floats:
    """Return the design (m, n + sets) of readings: ones at their position and their zero."""
    m = len(position)
    design = np.zeros((m, n + zero.max() + 1))
    design[np.arange(m), position] = 1.0
    design[np.arange(m), n + zero] = 1.0
    return design


def joining_map(position: Ints, zero: Ints, variance: Floats, n: int) -> Floats:
    """Return the matrix (n, m) from readings (m,) to deviations from the first position.

    ``position``, ``zero`` (m,) say where each reading belongs; its ``variance`` (m,) may be in any
    unit. Positions that nothing ties to the first count from the first of their own
    :func:`islands`.
    """
    design = reading_design(position, zero, n)
    # In units of their mean, so that all numbers are near one.
    root = 1.0 / np.sqrt(variance / variance.mean())
    label, _ = islands(position, zero, n)
    # The first position of each island is its zero; all others are unknown.
    counted = np.setdiff1d(np.arange(n), np.unique(label, return_index=True)[1])
    unknown = np.append(counted, np.arange(n, design.shape[1]))
    solution = np.linalg.pinv(design[:, unknown] * root[:, None]) * root
    joined = np.zeros((n, len(position)))
    joined[counted] = solution[: len(counted)]
    return joined


def islands(position: Ints, zero: Ints, n: int) -> tuple[Ints, Ints]:
    """Return the island of each position (n,) and of each set; one island: all are tied."""
    sets = int(zero.max()) + 1
    links = coo_array((np.ones(len(position)), (position, n + zero)), shape=(n + sets, n + sets))
    _, label = connected_components(links, directed=False)
    return label[:n].astype(np.int64), label[n:].astype(np.int64)


def cone_readings(normals: Floats, sets: Sets) -> Floats:
    """Return one reading (..., G) per normal (..., G, 3): deviation in rad from its set's first.

    Normals of a set are given along the same axes: those of a station, or the common ones.
    """
    axes, _ = cones(normals, sets)
    readings = np.zeros(normals.shape[:-1])
    for at, commanded in sets:
        if len(at) > 1:
            seen = azimuths(normals[..., at, :], axes[..., at[0], :])
            readings[..., at] = angle_deviation(seen, commanded)
    return readings


def cone_response(sets: Sets, height: float) -> Floats:
    """Return the derivative (G, 2 G) of :func:`cone_readings` by (tau, eta) of all normals.

    tau, eta: movement of a normal along t and b of :func:`~.normals.tangent_frame`, in rad;
    ``height``: of the :func:`cones`.
    """
    n = len(sets.number)
    response, height_response, shares = np.zeros((n, 2 * n)), np.zeros(n), _shares(sets)
    cos_beta = np.sqrt(1.0 - height**2)
    for few in (False, True):  # sets of two lean on the height that the others give
        for number, (at, azimuth) in enumerate(sets):
            if len(at) < 2 or (len(at) == 2) is not few:
                continue
            turn = azimuth_response(azimuth, height / cos_beta)
            response[at, at] += 1.0 / cos_beta
            if few:
                tilt, by_height = two_axis_response(azimuth)
                response[at, n:] += np.outer(turn @ by_height, height_response)
            else:
                tilt, by_eta = np.split(axis_response(azimuth), [2])
                height_response[at] += shares[number] * by_eta[0]
            response[np.ix_(at, n + at)] += turn @ tilt
    return response


def cones(normals: Floats, sets: Sets) -> tuple[Floats, Floats]:
    """Return the table axis (..., G, 3) that each normal turns about, and the height (...).

    The height s = sin(elevation of the normals) is the mean over the sets that determine it: those
    of three or more normals, which have their own plane. Two normals have none: their axis follows
    from the height that the others find.
    """
    axes, height = np.zeros_like(normals), np.zeros(normals.shape[:-2])
    shares = _shares(sets)
    for number, (at, commanded) in enumerate(sets):
        if len(at) >= 3:
            axis, s = fit_cone(normals[..., at, :], commanded)
            axes[..., at, :] = axis[..., None, :]
            height += shares[number] * s
    for at, commanded in sets:
        if len(at) == 2:
            axis = axis_of_two(normals[..., at, :], height, commanded)
            axes[..., at, :] = axis[..., None, :]
        elif len(at) == 1:  # no angle comes from it, any axis across it will do
            aside = np.argmax(np.abs(normals[..., at, :]), axis=-1)
            axes[..., at, :] = np.eye(3)[(aside + 1) % 3]
    return axes, height


def _shares(sets: Sets) -> dict[int, float]:
    """Return the weight of each set of three or more normals in the common height of cones.

    It is the inverse variance of the height that a set finds from normals whose eta scatter
    alike; all weights together are 1.
    """
    weights = {}
    for number, (at, azimuth) in enumerate(sets):
        if len(at) >= 3:
            response = axis_response(azimuth)
            weights[number] = 1.0 / float(response[2] @ response[2])
    total = sum(weights.values())
    return {number: weight / total for number, weight in weights.items()}


def require_overlap(problem: PlaneMirrorProblem, pairs: MirrorPairs) -> None:
    """Raise DataError naming the station that no chain of shared positions ties to the first."""
    _, used = np.unique(pairs.station, return_inverse=True)
    _, label = islands(pairs.position, used, len(problem.angles))
    loose = np.flatnonzero(label != label[0])
    if len(loose):
        station = int(np.unique(pairs.station)[loose[0]])
        raise DataError(
            f"{problem.source}: tracker station {problem.station_name(station)} shares no table "
            "position with the stations before it, so stitching has no zero for it; measure one "
            "position from both, or choose registration or joint"
        )


def require_cone(problem: PlaneMirrorProblem, pairs: MirrorPairs, angles: Floats) -> None:
    """Raise GeometryError when no plane of rotation can be found, or not at one station."""
    counts = np.bincount(pairs.station)
    if counts.max() < 3:
        raise GeometryError(
            f"{problem.source}: no tracker station sees three table positions (at most "
            f"{counts.max()}), so stitching finds no plane of rotation; choose registration "
            "or joint"
        )
    for station in np.flatnonzero(counts > 1):
        azimuth = angles[pairs.position[pairs.station == station]]
        # Two normals need an arc for the two tilts of the axis alone: the height is given.
        design = circle_columns(azimuth)[:, : len(azimuth)]
        if np.linalg.svd(design, compute_uv=False)[-1] < _MIN_ARC:
            raise GeometryError(
                f"{problem.source}: the {len(azimuth)} positions seen from tracker station "
                f"{problem.station_name(int(station))} span too small an arc for a plane of its "
                "own; measure more positions from there, or choose registration or joint"
            )


def direct_readings(placed: Floats, sets: Sets) -> Floats:
    """Return one reading (..., M) per row: deviation in rad from its reflector's first row.

    ``placed`` (..., M, 3) in the common frame. Plane and circle are fitted to all rows of one
    reflector.
    """
    readings = np.zeros(placed.shape[:-1])
    for at, commanded in sets:
        axis, centre, _ = fit_circle(placed[..., at, :], commanded)
        arms = placed[..., at, :] - centre[..., None, :]
        readings[..., at] = angle_deviation(azimuths(arms, axis), commanded)
    return readings


def fit_circle(points: Floats, commanded: Floats) -> tuple[Floats, Floats, Floats]:
    """Return axis (..., 3), centre (..., 3) and radius (...) of the circle through (..., m, 3).

    Plane by singular values, circle by Kasa's algebraic fit in it, about the centre of mass and
    in units of the spread, so that no digits are lost.
    """
    middle = points.mean(axis=-2, keepdims=True)
    arms = points - middle
    scale = np.sqrt((arms**2).sum(axis=-1).mean(axis=-1))[..., None, None]
    _, _, vt = np.linalg.svd(arms, full_matrices=False)
    axis = vt[..., 2, :] * turning_sense(arms, vt[..., 2, :], commanded)[..., None]
    plane = vt[..., :2, :]
    flat = arms @ np.swapaxes(plane, -1, -2) / scale
    # x^2 + y^2 = 2 a x + 2 b y + c is linear in the centre (a, b) and in c = r^2 - a^2 - b^2.
    design = np.concatenate([2.0 * flat, np.ones((*flat.shape[:-1], 1))], axis=-1)
    squares = (flat**2).sum(axis=-1)[..., None]
    transposed = np.swapaxes(design, -1, -2)
    solution = np.linalg.solve(transposed @ design, transposed @ squares)[..., 0]
    radius = np.sqrt(solution[..., 2] + (solution[..., :2] ** 2).sum(axis=-1))
    shift = (solution[..., None, :2] * scale) @ plane
    return axis, (middle + shift)[..., 0, :], radius * scale[..., 0, 0]


def local_axes(placed: Floats, sets: Sets) -> tuple[Floats, Floats, Floats]:
    """Return axes, radii (M,), and distances (M, 2) from the circle, radial and axial, metres.

    The axes (M, 3, 3) are unit vectors; rows tangential, radial, axial.
    """
    axes = np.zeros((len(placed), 3, 3))
    radii, off_circle = np.zeros(len(placed)), np.zeros((len(placed), 2))
    for at, commanded in sets:
        axis, centre, radii[at] = fit_circle(placed[at], commanded)
        arms = placed[at] - centre
        tangent = np.cross(axis, arms)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        axes[at] = np.stack(
            [tangent, np.cross(tangent, axis), np.broadcast_to(axis, tangent.shape)], axis=1
        )
        off_circle[at, 0] = np.einsum("mi,mi->m", arms, axes[at, 1]) - radii[at]
        off_circle[at, 1] = np.einsum("mi,mi->m", arms, axes[at, 2])
    return axes, radii, off_circle


def direct_response(sets: Sets, radii: Floats) -> Floats:
    """Return the derivative (M, 2 M) of the readings by tangential and radial movements (m)."""
    azimuth, circle, rows = sets.commanded, sets.number, np.arange(len(radii))
    design = circle_design(azimuth, circle)
    # A centre that moves by (x, y) turns the arm of each place by (x sin - y cos) / r.
    centre = np.zeros_like(design)
    centre[rows, 3 * circle], centre[rows, 3 * circle + 1] = np.sin(azimuth), -np.cos(azimuth)
    radial = centre @ np.linalg.pinv(design)
    return np.hstack([np.eye(len(azimuth)), radial]) / radii[:, None]


def require_circles(problem: PlaneMirrorProblem, reflectors: Reflectors) -> None:
    """Raise unless every reflector has at least three different places on its circle."""
    circles = reflectors.sets(problem.angles)
    for name, (at, azimuth) in zip(reflectors.name, circles, strict=True):
        places = len(np.unique(reflectors.position[at]))
        if places < 3:
            raise DataError(
                f"{problem.source}: reflector {name} was measured at {places} table positions, "
                "its circle needs 3"
            )
        if np.linalg.svd(circle_columns(azimuth), compute_uv=False)[-1] < _MIN_CIRCLE:
            raise GeometryError(
                f"{problem.source}: the places of reflector {name} span too small an arc to fit "
                "a circle; measure around the whole circle"
            )


def normal_covariance(
    normals: Normals,
    pairs: MirrorPairs,
    poses: Poses,
    axes: Floats,
    pose_covariance: Floats,
    tilt_std: float,
) -> Floats:
    """Return the covariance (2 G, 2 G) in rad^2 of all tau, then all eta.

    ``axes`` (G, 3) are the table axes along the common axes of ``poses``; ``pose_covariance``
    (p, p) is zero where stations are not brought together.
    """
    n = pairs.n_groups
    t, b = tangent_frame(poses.turned(normals.normal, pairs.station), axes)
    own = np.linalg.inv(plane_weight(normals, pairs, poses, t, b))[:, :2, :2]
    total = _independent(own)
    # The table tilts once at a position, for all stations that see it.
    same = pairs.position[:, None] == pairs.position[None, :]
    total[1, :, 1, :] += tilt_std**2 * same
    by_pose = np.zeros((2, n, len(pose_covariance)))
    movable, columns = station_columns(pairs.station)
    by_pose[0, movable[:, None], columns[:, :3]] = b[movable]
    by_pose[1, movable[:, None], columns[:, :3]] = -t[movable]
    flat = by_pose.reshape(2 * n, -1)
    covariance: Floats = total.reshape(2 * n, 2 * n) + flat @ pose_covariance @ flat.T
    return covariance


def point_covariance(
    problem: PlaneMirrorProblem,
    reflectors: Reflectors,
    poses: Poses,
    axes: Floats,
    pose_covariance: Floats,
) -> Floats:
    """Return the covariance (3 M, 3 M) in m^2: all tangential, all radial, all axial movements.

    ``axes`` (M, 3, 3) are the local directions as rows.
    """
    n = len(reflectors.row)
    points = problem.xyz[reflectors.row]
    local = axes @ poses.rotation[reflectors.station]
    own = local @ problem.noise.covariance(points) @ np.swapaxes(local, 1, 2)
    total = _independent(own)
    arm = poses.turned(points, reflectors.station)
    by_pose = np.zeros((3, n, len(pose_covariance)))
    movable, columns = station_columns(reflectors.station)
    for k in range(3):
        direction = axes[movable, k]
        by_pose[k, movable[:, None], columns[:, :3]] = np.cross(arm[movable], direction)
        by_pose[k, movable[:, None], columns[:, 3:]] = direction
    flat = by_pose.reshape(3 * n, -1)
    covariance: Floats = total.reshape(3 * n, 3 * n) + flat @ pose_covariance @ flat.T
    return covariance


def _independent(own: ArrayLike) -> Floats:
    """Return the covariance (k, n, k, n) of n independent places with their ``own`` (n, k, k)."""
    n, k, _ = np.shape(own)
    total = np.zeros((k, n, k, n))
    total[:, np.arange(n), :, np.arange(n)] = own
    return total


def tilt_crosstalk(problem: PlaneMirrorProblem, height: float, n: int) -> Floats:
    """Return the covariance (n, n) in rad^2 that tilts of the table add, from the first position.

    A tilt about the horizontal direction of a normal moves it along t by sin(beta) of the tilt,
    so that tan(beta) of the tilt is taken for an angle.
    """
    lean = height**2 / (1.0 - height**2)
    contrast = from_first(n)
    covariance: Floats = lean * problem.tilt_std**2 * contrast @ contrast.T
    return covariance


def from_first(n: int) -> Floats:
    """Return the matrix (n, n) that counts values from the first one."""
    contrast = np.eye(n)
    contrast[:, 0] -= 1.0
    return contrast
