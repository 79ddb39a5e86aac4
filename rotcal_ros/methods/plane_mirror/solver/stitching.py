"""Stitching: every tracker station gives angles from its own normals, tied by shared positions.

Every reading is deviation(position) + zero(set) + error. A set is what shares a zero: a tracker
station in stitching, a reflector in the direct way, everything in registration. Neighbouring sets
are tied by the positions they share. With one shared position from set to set, the least
squares of :func:`joining_map` are the paper's running sum (equations 7 to 16); with more, all
ties are used.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import DataError, GeometryError
from rotcal_ros.methods.plane_mirror.solver import cone
from rotcal_ros.methods.plane_mirror.solver.layout import MirrorPairs
from rotcal_ros.methods.plane_mirror.solver.problem import PlaneMirrorProblem

MIN_ARC: Final = 5e-3
"""Smallest singular value of an arc of directions, about its height: four degrees end to end."""


def joining_map(position: Ints, zero: Ints, variance: Floats, n: int) -> Floats:
    """Return the matrix (n, m) from readings (m,) to deviations from the first position.

    ``position``, ``zero`` (m,) say where each reading belongs, ``variance`` (m,) its weight.
    Positions that nothing ties to the first count from the first of their own :func:`islands`.
    """
    m = len(position)
    design = np.zeros((m, n + zero.max() + 1))
    design[np.arange(m), position] = 1.0
    design[np.arange(m), n + zero] = 1.0
    root = 1.0 / np.sqrt(variance / variance.mean())
    label, _ = islands(position, zero, n)
    counted = np.setdiff1d(np.arange(n), np.unique(label, return_index=True)[1])
    unknown = np.append(counted, np.arange(n, design.shape[1]))
    solution = np.linalg.pinv(design[:, unknown] * root[:, None]) * root
    joined = np.zeros((n, m))
    joined[counted] = solution[: len(counted)]
    return joined


def islands(position: Ints, zero: Ints, n: int) -> tuple[Ints, Ints]:
    """Return the island number of each position (n,) and of each set; one island is good."""
    sets = int(zero.max()) + 1
    links = coo_array((np.ones(len(position)), (position, n + zero)), shape=(n + sets, n + sets))
    _, label = connected_components(links, directed=False)
    return label[:n].astype(np.int64), label[n:].astype(np.int64)


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


def stitch(normals: Floats, pairs: MirrorPairs, angles: Floats) -> Floats:
    """Return one reading (..., G) per group: deviation in rad from its station's first group.

    ``normals`` (..., G, 3) each in the frame of its station, ``angles`` (N,) commanded.
    """
    axes, _ = station_cones(normals, pairs, angles)
    readings = np.zeros(normals.shape[:-1])
    for _, at, commanded in pairs.stations(angles):
        if len(at) > 1:
            azimuths = cone.azimuths(normals[..., at, :], axes[..., at[0], :])
            readings[..., at] = cone.deviation(azimuths, commanded)
    return readings


def stitch_response(normals: Floats, pairs: MirrorPairs, angles: Floats) -> Floats:
    """Return the derivative (G, 2 G) of :func:`stitch` by (tau, eta) of all normals (G, 3).

    tau, eta: movement of a normal along t and b of :func:`~.normals.tangent_frame`, in rad.
    """
    n = len(normals)
    response = np.zeros((n, 2 * n))
    height_response = np.zeros(n)
    shares = _shares(pairs, angles)
    s = float(station_cones(normals, pairs, angles)[1])
    tan_beta, cos_beta = s / np.sqrt(1.0 - s**2), np.sqrt(1.0 - s**2)
    for few in (False, True):  # stations of two lean on the height that the others give
        for station, at, azimuth in pairs.stations(angles):
            if len(at) < 2 or (len(at) == 2) is not few:
                continue
            turn = cone.azimuth_response(azimuth, tan_beta)
            response[at, at] += 1.0 / cos_beta
            if few:
                tilt, by_height = cone.two_axis_response(azimuth)
                response[at, n:] += np.outer(turn @ by_height, height_response)
            else:
                tilt, by_eta = np.split(cone.axis_response(azimuth), [2])
                height_response[at] += shares[station] * by_eta[0]
            response[np.ix_(at, n + at)] += turn @ tilt
    return response


def station_cones(normals: Floats, pairs: MirrorPairs, angles: Floats) -> tuple[Floats, Floats]:
    """Return the table axis (..., G, 3) as each group's station sees it, and the height (...).

    The height s = sin(elevation of the normals) is the mean over the stations that can tell:
    those with three or more normals, which have their own plane. Two normals have none: their
    axis follows from the height that the other stations find.
    """
    axes, height = np.zeros_like(normals), np.zeros(normals.shape[:-2])
    shares = _shares(pairs, angles)
    stations = list(pairs.stations(angles))
    for station, at, commanded in stations:
        if len(at) >= 3:
            axis, s = cone.fit_cone(normals[..., at, :], commanded)
            axes[..., at, :] = axis[..., None, :]
            height += shares[station] * s
    for _, at, commanded in stations:
        if len(at) == 2:
            axis = cone.axis_of_two(normals[..., at, :], height, commanded)
            axes[..., at, :] = axis[..., None, :]
        elif len(at) == 1:  # no angle comes from it, any axis across it will do
            aside = np.argmax(np.abs(normals[..., at, :]), axis=-1)
            axes[..., at, :] = np.eye(3)[(aside + 1) % 3]
    return axes, height


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
        design = cone.circle_columns(azimuth)[:, : len(azimuth)]
        if np.linalg.svd(design, compute_uv=False)[-1] < MIN_ARC:
            raise GeometryError(
                f"{problem.source}: the {len(azimuth)} positions seen from tracker station "
                f"{problem.station_name(int(station))} span too small an arc for a plane of its "
                "own; measure more positions from there, or choose registration or joint"
            )


def _shares(pairs: MirrorPairs, angles: Floats) -> dict[int, float]:
    """Weight of each station with three or more normals in the common cone height."""
    weights = {}
    for station, at, azimuth in pairs.stations(angles):
        if len(at) >= 3:
            response = cone.axis_response(azimuth)
            weights[station] = 1.0 / float(response[2] @ response[2])
    total = sum(weights.values())
    return {station: weight / total for station, weight in weights.items()}
