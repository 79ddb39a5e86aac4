"""Mirror, tracker and reflectors about a rotary table: where they stand, and what is seen of them.

Plain physics: the world frame (of the machine) has the table axis as +z and its origin where the
axis meets the table. The tracker stands level at one station after the other, turned as it likes;
its frame has its origin at the head. The mirror has a size, leans, and is not quite flat. Angles
are radians, lengths metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.geometry.rotations import rotation_from_vector

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

    def to_local(self, points: Floats) -> Floats:
        """Return world points (..., 3) in the frame of the tracker."""
        turn = rotation_from_vector([0.0, 0.0, self.heading])
        return np.asarray((points - np.array(self.place)) @ turn)


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
    return np.asarray(centre + reach * reflected + SPREAD * edge * offsets)


def on_circle(radius: float, azimuth: float, height: float) -> tuple[float, float, float]:
    """Return the place (m) at ``radius`` from the axis."""
    return float(radius * np.cos(azimuth)), float(radius * np.sin(azimuth)), height
