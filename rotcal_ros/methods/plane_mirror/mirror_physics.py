"""Mirror, tracker and reflectors about a rotary table: where they stand, and what is seen of them.

Plain physics: the world frame (of the machine) has the table axis as +z and its origin where the
axis meets the table. The tracker stands level at one station after the other, turned as it likes;
its frame has its origin at the head. The mirror has a size, leans, and is not quite flat. Angles
are radians, lengths metres.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.geometry.rotations import rotation_from_vector
from rotcal_ros.methods.plane_mirror.solver.problem import PlaneMirrorProblem, TrackerNoise

SPREAD: Final = 0.3
"""The reflectors of a position spread over this share of the mirror's shorter edge."""

Pose = tuple[Floats, Floats]
"""Middle of the glass (3,), and the columns u, v, n of the mirror's frame (3, 3)."""


@dataclass(frozen=True)
class FlatMirror:
    """A mirror on the table, given in the table's frame at angle 0.

    ``centre`` (m) is the middle of the glass, ``azimuth`` and ``lean`` (rad) the direction of
    its normal, ``width`` and ``height`` (m) its edges. The glass departs from a plane by
    ``sag`` and ``twist`` (m): height sag (u^2 + v^2) + twist u v, with u, v
    from -1 to 1 edge to edge.
    """

    centre: tuple[float, float, float] = (0.05, 0.0, 0.15)
    azimuth: float = 0.0
    lean: float = 1.4 * DEGREE
    width: float = 0.10
    height: float = 0.10
    sag: float = 0.0
    twist: float = 0.0

    def frame(self) -> Floats:
        """Return the columns u (sideways), v (upwards), n (out of the glass) at angle 0."""
        ca, sa = np.cos(self.azimuth), np.sin(self.azimuth)
        cl, sl = np.cos(self.lean), np.sin(self.lean)
        n = np.array([cl * ca, cl * sa, sl])
        u = np.array([-sa, ca, 0.0])
        return np.column_stack([u, np.cross(n, u), n])

    def pose(self, rotation: Floats, shift: Floats | float = 0.0) -> Pose:
        """Return where the table holds the mirror at its own ``rotation`` and ``shift``."""
        return rotation @ np.array(self.centre) + shift, rotation @ self.frame()

    def image(self, pose: Pose, station: TrackerStation, place: Floats, where: str) -> Floats:
        """Return the image (3,) of the reflector at ``place``, seen from ``station``; world frame.

        It lies behind the plane that touches the glass, which is at ``pose``, at the spot which
        the beam strikes. Raises PlanError, with ``where`` in its text, when the beam misses it.
        """
        (centre, frame), tracker = pose, np.array(station.place)
        touch, normal = centre, frame[:, 2]
        for _ in range(5):  # the spot moves by nanometres once the plane touches the glass
            image = place - 2.0 * ((place - touch) @ normal) * normal
            beam = image - tracker
            spot = tracker + beam * (((touch - tracker) @ normal) / (beam @ normal))
            u, v = (spot - centre) @ frame[:, :2] * 2.0 / np.array([self.width, self.height])
            if abs(u) > 1.0 or abs(v) > 1.0 or beam @ normal >= 0.0:
                raise PlanError(
                    f"{where}: the beam misses the mirror (at {u:.2f}, {v:.2f} of its half "
                    "edges); move the tracker or the reflector, or take a larger mirror"
                )
            height = self.sag * (u**2 + v**2) + self.twist * u * v
            slope_u = (2.0 * self.sag * u + self.twist * v) * 2.0 / self.width
            slope_v = (2.0 * self.sag * v + self.twist * u) * 2.0 / self.height
            normal = frame @ np.array([-slope_u, -slope_v, 1.0])
            normal = normal / np.linalg.norm(normal)
            foot = centre + frame[:, :2] @ ((spot - centre) @ frame[:, :2])
            touch = foot + height * frame[:, 2]
        return image


@dataclass(frozen=True)
class TrackerStation:
    """Where the tracker stands in the world: ``place`` (m) and its ``heading`` about +z (rad)."""

    place: tuple[float, float, float]
    heading: float = 0.0

    def seen(self, points: Floats) -> Floats:
        """Return world points (..., 3) in the frame of the tracker."""
        turn = rotation_from_vector([0.0, 0.0, self.heading])
        local: Floats = (points - np.array(self.place)) @ turn
        return local


def incidence(station: ArrayLike, centre: Floats, frame: Floats) -> float:
    """Return the angle between the mirror's normal and the beam from ``station`` (3,)."""
    beam = np.asarray(station, dtype=np.float64) - centre
    return float(np.arccos(np.clip(beam @ frame[:, 2] / np.linalg.norm(beam), -1.0, 1.0)))


def reflector_places(
    station: ArrayLike, centre: Floats, frame: Floats, count: int, reach: float, edge: float
) -> Floats:
    """Return places (count, 3) that the tracker sees near the middle of the mirror.

    They lie ``reach`` from the glass along the reflected beam, beside each other, spread by a
    share of the ``edge`` of the mirror.
    """
    beam = centre - np.asarray(station, dtype=np.float64)
    beam = beam / np.linalg.norm(beam)
    reflected = beam - 2.0 * (beam @ frame[:, 2]) * frame[:, 2]
    side = np.linspace(-0.5, 0.5, count) if count > 1 else np.zeros(1)
    offsets = np.outer(side, frame[:, 0]) + np.outer(side**2, frame[:, 1])
    places: Floats = centre + reach * reflected + SPREAD * edge * offsets
    return places


def on_circle(radius: float, azimuth: float, height: float) -> tuple[float, float, float]:
    """Return the place (m) at ``radius`` from the axis."""
    return float(radius * np.cos(azimuth)), float(radius * np.sin(azimuth)), height


@dataclass(frozen=True)
class MirrorCell:
    """Table positions, mirror, tracker stations and nests: all that stands in the room.

    ``angles`` (N,) commanded, ``visits`` the positions measured from each station, ``nests``
    (K, 3) the fixed nests in metres. At each visit ``reflectors`` reflectors are put up so that
    the tracker sees them in the mirror, ``reach`` metres from the glass.
    """

    angles: Floats
    stations: tuple[TrackerStation, ...]
    visits: tuple[tuple[int, ...], ...]
    nests: Floats
    mirror: FlatMirror = field(default_factory=FlatMirror)
    reflectors: int = 1
    reach: float = 1.5


def paper_cell(reflectors: int = 1, **mirror: Any) -> MirrorCell:
    """Return the experiment of Muralikrishnan et al.: 17 positions, 6 stations, 6 nests.

    Stations see the positions 1-4, 4-7, 7-10, 10-13, 13-16 and 16-17 (counted from one).
    """
    visits = (*(tuple(range(s, s + 4)) for s in range(0, 15, 3)), (15, 16))
    angles = np.arange(17) * 2.0 * np.pi / 16
    return ring_cell(angles, visits, 6, reflectors, **mirror)


def ring_cell(
    angles: Floats,
    visits: tuple[tuple[int, ...], ...],
    n_nests: int = 6,
    reflectors: int = 1,
    **mirror: Any,
) -> MirrorCell:
    """Return a cell whose stations stand 2 m from the axis, each facing the middle of its visits.

    ``mirror`` are fields of :class:`FlatMirror`.
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


def measure(
    cell: MirrorCell,
    deviations: Floats,
    noise: TrackerNoise | None = None,
    rng: np.random.Generator | None = None,
    **settings: Any,
) -> PlaneMirrorProblem:
    """Let the tracker measure the whole cell and return the problem.

    ``deviations`` (N, 6) are EXC, EYC, EZC (m), EAC, EBC, ECC (rad) of the table at each position.
    Without ``rng`` the points are exact. ``settings`` go to the problem.
    """

    def see(s: int, i: int) -> Iterator[Seen]:
        for k in range(1, cell.reflectors + 1):
            for kind in (PointKind.DIRECT, PointKind.MIRRORED):
                yield kind, k, look(cell, s, kind, k, cell.angles[i], deviations[i])

    return _problem(cell, see, cell.nests, noise, rng, settings)


def look(
    cell: MirrorCell, station: int, kind: PointKind, number: int, angle: float, deviation: Floats
) -> Floats:
    """Return where the tracker sees reflector ``number`` (from 1), in its own frame, no noise.

    The reflector was put up for the commanded table ``angle`` (rad), the table having its
    ``deviation`` (6,). Raises PlanError when the beam misses the mirror.
    """
    stand = cell.stations[station]
    mirror = cell.mirror
    there = mirror.pose(*table_pose(angle, np.zeros(6)))
    edge = min(mirror.width, mirror.height)
    place = reflector_places(stand.place, *there, cell.reflectors, cell.reach, edge)[number - 1]
    if kind is PointKind.DIRECT:
        return stand.seen(place)
    where = f"table at {angle / DEGREE:g} deg, tracker station {station}"
    return stand.seen(
        mirror.image(mirror.pose(*table_pose(angle, deviation)), stand, place, where)
    )


def measure_direct(
    cell: MirrorCell,
    deviations: Floats,
    reflectors: Floats,
    noise: TrackerNoise | None = None,
    rng: np.random.Generator | None = None,
    **settings: Any,
) -> PlaneMirrorProblem:
    """Let the tracker measure reflectors (K, 3) on the table, given in its frame at angle 0.

    Every station measures its visits; for a full circle one station visits all positions.
    """

    def see(s: int, i: int) -> Iterator[Seen]:
        rotation, shift = table_pose(cell.angles[i], deviations[i])
        for k, reflector in enumerate(reflectors, start=1):
            yield PointKind.DIRECT, k, cell.stations[s].seen(rotation @ reflector + shift)

    nests = cell.nests if len(cell.stations) > 1 else cell.nests[:0]
    return _problem(cell, see, nests, noise, rng, {"way": "direct", **settings})


def add_noise(
    points: Floats, noise: TrackerNoise, rng: np.random.Generator, trials: int
) -> Floats:
    """Return points (trials, n, 3) scattered about ``points`` (n, 3) as the tracker would."""
    factor = np.linalg.cholesky(noise.covariance(points))
    scatter = rng.standard_normal((trials, *points.shape))
    scattered: Floats = points + np.einsum("nij,tnj->tni", factor, scatter)
    return scattered


def table_pose(angle: float, deviation: Floats) -> tuple[Floats, Floats]:
    """Return rotation and shift of the table: the commanded angle, then deviations (6,)."""
    turn = rotation_from_vector([0.0, 0.0, angle + deviation[5]])
    return rotation_from_vector([deviation[3], deviation[4], 0.0]) @ turn, deviation[:3]


Seen = tuple[PointKind, int, Floats]
"""Kind and number of a point, and where the tracker sees it (3,)."""


def _problem(
    cell: MirrorCell,
    see: Callable[[int, int], Iterable[Seen]],
    nests: Floats,
    noise: TrackerNoise | None,
    rng: np.random.Generator | None,
    settings: dict[str, Any],
) -> PlaneMirrorProblem:
    """Return all points: of each station the ``nests``, then what it sees at each position."""
    noise = noise if noise is not None else TrackerNoise()
    rows, points = [], []
    for s, station in enumerate(cell.stations):
        for k, nest in enumerate(nests, start=1):
            rows.append((-1, s, PointKind.NEST, k))
            points.append(station.seen(nest))
        for i in cell.visits[s]:
            for kind, k, point in see(s, i):
                rows.append((i, s, kind, k))
                points.append(point)
    xyz = np.array(points)
    if rng is not None:
        xyz = add_noise(xyz, noise, rng, 1)[0]
    position, station, kind, nest = np.array(rows, dtype=np.int64).T
    return PlaneMirrorProblem(cell.angles, position, station, kind, nest, xyz, noise, **settings)
