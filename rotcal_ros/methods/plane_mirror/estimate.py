"""From points to deviations, for one measurement or for thousands of trials at once.

What depends only on the layout and on the noise is prepared once, in the type that belongs to the
way; the estimates then take points with any leading axes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.methods.plane_mirror import cone, joint
from rotcal_ros.methods.plane_mirror.direct import direct_readings
from rotcal_ros.methods.plane_mirror.layout import Nests, Pairs, Reflectors
from rotcal_ros.methods.plane_mirror.normals import Normals, fit_normals
from rotcal_ros.methods.plane_mirror.problem import PlaneMirrorProblem
from rotcal_ros.methods.plane_mirror.registration import Poses, adjust_stations
from rotcal_ros.methods.plane_mirror.settings import STITCHING
from rotcal_ros.methods.plane_mirror.stitching import stitch

_TRIAL_STEPS: Final = 2  # Gauss-Newton from the nominal solution: noise squared, then rounding


@dataclass(frozen=True, eq=False)
class Prepared(ABC):
    """A screened problem with all that does not change from trial to trial.

    ``angles`` (N,) are those of the positions that were measured; the positions of pairs and
    reflectors count in them. ``poses`` are the nominal stations, or all at the origin where the
    way needs none. ``joining`` (N, readings) makes deviations of readings.
    """

    problem: PlaneMirrorProblem
    angles: Floats
    nests: Nests
    poses: Poses
    joining: Floats

    @property
    def nest_weight(self) -> Floats:
        """Inverse covariances (Q, 3, 3) of the nests, along the axes of each station."""
        return self.problem.noise.weight(self.problem.xyz[self.nests.row])

    @abstractmethod
    def estimate(self, points: Floats) -> Floats:
        """Return deviations (..., N) in rad, from the first position, of points (..., n, 3)."""

    def stations_of(self, points: Floats) -> Poses:
        """Return the adjusted stations for points (..., n, 3)."""
        if self.poses.rotation.shape[-3] == 1:
            return self.poses
        return adjust_stations(points, self.nests, self.nest_weight, self.poses, _TRIAL_STEPS)


@dataclass(frozen=True, eq=False)
class PreparedPoints(Prepared):
    """The way "direct": reflectors that the table carries."""

    reflectors: Reflectors

    def estimate(self, points: Floats) -> Floats:
        """Return the deviations about the circles of the reflectors."""
        own = points[..., self.reflectors.row, :]
        placed = self.stations_of(points).placed(own, self.reflectors.station)
        readings = direct_readings(placed, self.reflectors, self.angles)
        return np.asarray(readings @ self.joining.T, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class PreparedNormals(Prepared):
    """The ways "stitching" and "registration": a mirror, seen in pairs of points."""

    pairs: Pairs
    pair_weight: Floats

    def normals(self, points: Floats) -> Normals:
        """Return the mirror's planes that points (..., n, 3) show."""
        return fit_normals(points, self.pairs, self.pair_weight)

    def estimate(self, points: Floats) -> Floats:
        """Return the deviations of the normals, each in its station or all in the first one's."""
        normal = self.normals(points).normal
        if self.problem.way == STITCHING:
            readings = stitch(normal, self.pairs, self.angles)
        else:
            placed = self.stations_of(points).turned(normal, self.pairs.station)
            readings = registered_readings(placed, self.pairs, self.angles)
        return np.asarray(readings @ self.joining.T, dtype=np.float64)

    @property
    def adjusted_together(self) -> joint.Together:
        """What the way "joint" adjusts together."""
        return joint.Together(self.pairs, self.nests, self.nest_weight, self.problem.tilt_std)


@dataclass(frozen=True, eq=False)
class PreparedJoint(PreparedNormals):
    """The way "joint", with its nominal solution ``mirror``."""

    mirror: joint.Mirror

    def estimate(self, points: Floats) -> Floats:
        """Return the deviations by the least squares of everything at once."""
        mirror = joint.adjust_joint(
            points, self.normals(points), self.adjusted_together, self.mirror, _TRIAL_STEPS
        )
        return cone.deviation(mirror.psi, self.angles)


PreparedWay = PreparedPoints | PreparedNormals
"""A prepared problem of any way; that of "joint" is one of normals."""


def registered_readings(normals: Floats, pairs: Pairs, angles: Floats) -> Floats:
    """Return one reading (..., G) per normal (..., G, 3) in the common frame."""
    commanded = angles[pairs.position]
    axis, _ = cone.fit_cone(normals, commanded)
    return cone.deviation(cone.azimuths(normals, axis), commanded)
