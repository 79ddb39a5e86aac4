"""A laser tracker around a table with a mirror, or with reflectors, and all that it measures.

Points are exact, or scatter as the tracker does; the deviations of the table are known.
"""

from dataclasses import dataclass

import numpy as np

from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.geometry.rotations import rotation_from_vector
from rotcal_ros.methods.plane_mirror.mirror_physics import (
    FlatMirror,
    TrackerStation,
    reflector_places,
)
from rotcal_ros.methods.plane_mirror.solver import PlaneMirrorProblem, TrackerNoise

REACH = 1.5
"""Metres from the glass to the reflectors before the mirror."""


@dataclass(frozen=True)
class MirrorCell:
    """Table positions, mirror, tracker stations and nests: all that stands in the room.

    ``angles`` (N,) commanded, ``visits`` the positions measured from each station, ``nests``
    (K, 3) the fixed nests in metres. At each visit ``reflectors`` reflectors are put up so that
    the tracker sees them in the mirror.
    """

    angles: np.ndarray
    stations: tuple[TrackerStation, ...]
    visits: tuple[tuple[int, ...], ...]
    nests: np.ndarray
    mirror: FlatMirror
    reflectors: int = 1


def paper_cell(reflectors=1, **mirror):
    """Return the experiment of Muralikrishnan et al.: 17 positions, 6 stations, 6 nests.

    Stations see the positions 1-4, 4-7, 7-10, 10-13, 13-16 and 16-17 (counted from one).
    """
    visits = (*(tuple(range(s, s + 4)) for s in range(0, 15, 3)), (15, 16))
    angles = np.arange(17) * 2.0 * np.pi / 16
    return ring_cell(angles, visits, 6, reflectors, **mirror)


def ring_cell(angles, visits, n_nests=6, reflectors=1, **mirror):
    """Return a cell whose stations stand 2 m from the axis, each facing the middle of its visits.

    ``mirror`` are fields of the mirror.
    """
    middle = [float(np.mean(angles[list(visit)])) for visit in visits]
    stations = tuple(
        TrackerStation((2.0 * np.cos(a), 2.0 * np.sin(a), 0.35), heading=2.3 * a + 0.4)
        for a in middle
    )
    around = np.arange(n_nests) * 2.0 * np.pi / n_nests + 0.3
    # Different heights and distances: no symmetry that would let exchanged nests go unnoticed.
    reach = 1.6 + 0.17 * (np.arange(n_nests) % 4)
    height = 0.1 + 0.45 * (np.arange(n_nests) % 3)
    nests = np.column_stack([reach * np.cos(around), reach * np.sin(around), height])
    return MirrorCell(angles, stations, visits, nests, FlatMirror(**mirror), reflectors)


def measure(cell, deviations, noise=None, rng=None, **settings):
    """Let the tracker measure the whole cell and return the problem.

    ``deviations`` (N, 6) are EXC, EYC, EZC (m), EAC, EBC, ECC (rad) of the table at each position.
    Without ``rng`` the points are exact. ``settings`` go to the problem.
    """
    mirror = cell.mirror
    edge = min(mirror.width, mirror.height)

    def see(s, i):
        stand, angle = cell.stations[s], cell.angles[i]
        put_up_for = mirror.pose(*table_pose(angle, np.zeros(6)))
        there = mirror.pose(*table_pose(angle, deviations[i]))
        places = reflector_places(stand.place, *put_up_for, cell.reflectors, REACH, edge)
        where = f"table at {angle / DEGREE:g} deg, tracker station {s}"
        for k, place in enumerate(places, start=1):
            yield PointKind.DIRECT, k, stand.to_local(place)
            yield PointKind.MIRRORED, k, stand.to_local(mirror.image(there, stand, place, where))

    return _problem(cell, see, cell.nests, noise, rng, settings)


def measure_direct(cell, deviations, reflectors, noise=None, rng=None, **settings):
    """Let the tracker measure reflectors (K, 3) on the table, given in its frame at angle 0.

    Every station measures its visits; for a full circle one station visits all positions.
    """

    def see(s, i):
        rotation, shift = table_pose(cell.angles[i], deviations[i])
        for k, reflector in enumerate(reflectors, start=1):
            yield PointKind.DIRECT, k, cell.stations[s].to_local(rotation @ reflector + shift)

    nests = cell.nests if len(cell.stations) > 1 else cell.nests[:0]
    return _problem(cell, see, nests, noise, rng, {"way": "direct", **settings})


def add_noise(points, noise, rng, trials):
    """Return points (trials, n, 3) scattered about ``points`` (n, 3) as the tracker would."""
    factor = np.linalg.cholesky(noise.covariance(points))
    scatter = rng.standard_normal((trials, *points.shape))
    return points + np.einsum("nij,tnj->tni", factor, scatter)


def table_pose(angle, deviation):
    """Return rotation and shift of the table: the commanded angle, then deviations (6,)."""
    turn = rotation_from_vector([0.0, 0.0, angle + deviation[5]])
    return rotation_from_vector([deviation[3], deviation[4], 0.0]) @ turn, deviation[:3]


def _problem(cell, see, nests, noise, rng, settings):
    """Return all points: of each station the ``nests``, then what it sees at each position."""
    noise = noise if noise is not None else TrackerNoise()
    rows, points = [], []
    for s, station in enumerate(cell.stations):
        for k, nest in enumerate(nests, start=1):
            rows.append((-1, s, PointKind.NEST, k))
            points.append(station.to_local(nest))
        for i in cell.visits[s]:
            for kind, k, point in see(s, i):
                rows.append((i, s, kind, k))
                points.append(point)
    xyz = np.array(points)
    if rng is not None:
        xyz = add_noise(xyz, noise, rng, 1)[0]
    position, station, kind, nest = np.array(rows, dtype=np.int64).T
    return PlaneMirrorProblem(cell.angles, position, station, kind, nest, xyz, noise, **settings)
