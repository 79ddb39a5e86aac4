"""Stitching: every tracker station gives angles from its own normals, tied by shared positions."""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.errors import DataError, GeometryError
from rotcal_ros.methods.plane_mirror import cone
from rotcal_ros.methods.plane_mirror.layout import Pairs
from rotcal_ros.methods.plane_mirror.offsets import islands
from rotcal_ros.methods.plane_mirror.problem import PlaneMirrorProblem

MIN_ARC: Final = 5e-3
"""Smallest singular value of an arc of directions, about its height: four degrees end to end."""


def require_overlap(problem: PlaneMirrorProblem, pairs: Pairs) -> None:
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


def stitch(normals: Floats, pairs: Pairs, angles: Floats) -> Floats:
    """Return one reading (..., G) per group: deviation in rad from its station's first group.

    ``normals`` (..., G, 3) each in the frame of its station, ``angles`` (N,) commanded. A station
    with three or more normals has its own plane. Two normals have none: their axis follows from
    the cone found by the other stations.
    """
    readings = np.zeros(normals.shape[:-1])
    height = np.zeros(normals.shape[:-2])
    shares = _shares(normals, pairs, angles)
    pairs_of_two = []
    for station in np.unique(pairs.station):
        at = np.flatnonzero(pairs.station == station)
        if len(at) == 2:
            pairs_of_two.append(at)
        if len(at) < 3:
            continue
        commanded = angles[pairs.position[at]]
        axis, s = cone.fit_cone(normals[..., at, :], commanded)
        height += shares[station] * s
        readings[..., at] = cone.deviation(cone.azimuths(normals[..., at, :], axis), commanded)
    for at in pairs_of_two:
        commanded = angles[pairs.position[at]]
        axis = cone.axis_of_two(normals[..., at, :], height, commanded)
        readings[..., at] = cone.deviation(cone.azimuths(normals[..., at, :], axis), commanded)
    return readings


def stitch_response(normals: Floats, pairs: Pairs, angles: Floats) -> Floats:
    """Return the derivative (G, 2 G) of :func:`stitch` by (tau, eta) of all normals (G, 3).

    tau, eta: movement of a normal along t and b of :func:`station_axes`, in rad.
    """
    n = len(normals)
    response = np.zeros((n, 2 * n))
    height_response = np.zeros(n)
    shares = _shares(normals, pairs, angles)
    s = float(cone_height(normals, pairs, angles))
    tan_beta, cos_beta = s / np.sqrt(1.0 - s**2), np.sqrt(1.0 - s**2)
    for few in (False, True):  # stations of two lean on the height that the others give
        for station in np.unique(pairs.station):
            at = np.flatnonzero(pairs.station == station)
            if len(at) < 2 or (len(at) == 2) is not few:
                continue
            azimuth = angles[pairs.position[at]]
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


def station_axes(normals: Floats, pairs: Pairs, angles: Floats) -> Floats:
    """Return the table axis (G, 3) as the station of each group sees it, for normals (G, 3)."""
    axes = np.zeros_like(normals)
    height = cone_height(normals, pairs, angles)
    for station in np.unique(pairs.station):
        at = np.flatnonzero(pairs.station == station)
        commanded = angles[pairs.position[at]]
        if len(at) >= 3:
            axes[at] = cone.fit_cone(normals[at], commanded)[0]
        elif len(at) == 2:
            axes[at] = cone.axis_of_two(normals[at], height, commanded)
        else:  # one normal: no angle comes from it, any axis across it will do
            axes[at] = np.roll(np.eye(3)[np.argmax(np.abs(normals[at[0]]))], 1)
    return axes


def cone_height(normals: Floats, pairs: Pairs, angles: Floats) -> Floats:
    """Return s = sin(elevation of the normals), the mean over the stations that can tell."""
    height = np.zeros(normals.shape[:-2])
    for station, share in _shares(normals, pairs, angles).items():
        at = np.flatnonzero(pairs.station == station)
        height += share * cone.fit_cone(normals[..., at, :], angles[pairs.position[at]])[1]
    return height


def require_cone(problem: PlaneMirrorProblem, pairs: Pairs, angles: Floats) -> None:
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
        columns = [np.cos(azimuth), np.sin(azimuth), np.ones_like(azimuth)]
        design = np.column_stack(columns[: min(len(azimuth), 3)])
        if np.linalg.svd(design, compute_uv=False)[-1] < MIN_ARC:
            raise GeometryError(
                f"{problem.source}: the {len(azimuth)} positions seen from tracker station "
                f"{problem.station_name(int(station))} span too small an arc for a plane of its "
                "own; measure more positions from there, or choose registration or joint"
            )


def _shares(normals: Floats, pairs: Pairs, angles: Floats) -> dict[int, float]:
    """Weight of each station with three or more normals in the common cone height."""
    weights = {}
    for station in np.unique(pairs.station):
        at = np.flatnonzero(pairs.station == station)
        if len(at) >= 3:
            response = cone.axis_response(angles[pairs.position[at]])
            weights[int(station)] = 1.0 / float(response[2] @ response[2])
    total = sum(weights.values())
    return {station: weight / total for station, weight in weights.items()}
