"""Screening a problem and laying it out, once for one solution or for thousands of trials.

What depends only on the layout and on the noise is prepared once, in the type that belongs to the
way; the estimates then take points (..., n, 3) with any leading axes. An estimate frees points of
the drift, brings the stations together, makes readings of angles, and joins these to deviations.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.results import Rejection
from rotcal_ros.methods.plane_mirror.solver import joint, screening
from rotcal_ros.methods.plane_mirror.solver.drift import NestDrift, displaced_nests, find_drift
from rotcal_ros.methods.plane_mirror.solver.normals import (
    Normals,
    angle_deviation,
    fit_normals,
    pair_weights,
)
from rotcal_ros.methods.plane_mirror.solver.problem import (
    MirrorPairs,
    Nests,
    PlaneMirrorProblem,
    Reflectors,
    find_nests,
    find_pairs,
    find_reflectors,
)
from rotcal_ros.methods.plane_mirror.solver.readings import (
    direct_readings,
    fit_circle,
    joining_map,
    registered_readings,
    require_circles,
    require_cone,
    require_overlap,
    stitch,
)
from rotcal_ros.methods.plane_mirror.solver.registration import (
    Poses,
    adjust_stations,
    register,
)
from rotcal_ros.methods.plane_mirror.solver_settings import DIRECT, JOINT, STITCHING

_DRIFT_STEP: Final = 1e-6
"""Turn (rad), shift and range (m) that the response to a drift is found with."""
_TRIAL_STEPS: Final = 2  # Gauss-Newton from the nominal solution: noise squared, then rounding


@dataclass(frozen=True, eq=False)
class Prepared(ABC):
    """A screened problem with all that does not change from trial to trial.

    ``problem`` has its points without the ``drift`` of the tracker. ``angles`` (N,) are those of
    the ``positions`` (N,) that were measured; those of pairs and reflectors count in them.
    ``poses`` are the nominal stations, or all at the origin where the way needs none. ``joining``
    (N, readings) makes deviations of readings.
    """

    problem: PlaneMirrorProblem
    drift: NestDrift
    positions: Ints
    angles: Floats
    nests: Nests
    poses: Poses
    joining: Floats

    @property
    def nest_weight(self) -> Floats:
        """Inverse covariances (Q, 3, 3) of the nests, along the axes of each station."""
        return self.problem.noise.weight(self.problem.xyz[self.nests.row])

    def estimate(self, points: Floats) -> Floats:
        """Return deviations (..., N) in rad, from the first position, of points (..., n, 3).

        The drift of each trial is estimated from its own points.
        """
        return self.deviations(self.drift.corrected(points))

    @abstractmethod
    def deviations(self, points: Floats) -> Floats:
        """Return the deviations (..., N) of points (..., n, 3) that have no drift."""

    def drift_response(self) -> Floats:
        """Return the derivative (N, size) of the deviations by the changes that the drift made.

        By central differences of the estimate itself, so that it is the same for every way; a
        step moves points by micrometres, where the estimate is linear to 1e-6.
        """
        if not self.drift.size:
            return np.zeros((len(self.angles), 0))
        steps = _DRIFT_STEP * np.eye(self.drift.size)
        moved = self.drift.displacement(self.problem.xyz, np.concatenate([steps, -steps]))
        ahead, behind = np.split(self.deviations(self.problem.xyz - moved), 2)
        return np.asarray((ahead - behind).T / (2.0 * _DRIFT_STEP), dtype=np.float64)

    def stations_of(self, points: Floats) -> Poses:
        """Return the adjusted stations for points (..., n, 3)."""
        if self.poses.rotation.shape[-3] == 1:
            return self.poses
        return adjust_stations(points, self.nests, self.nest_weight, self.poses, _TRIAL_STEPS)


@dataclass(frozen=True, eq=False)
class PreparedPoints(Prepared):
    """The way "direct": reflectors that the table carries."""

    reflectors: Reflectors

    def deviations(self, points: Floats) -> Floats:
        """Return the deviations about the circles of the reflectors."""
        own = points[..., self.reflectors.row, :]
        placed = self.stations_of(points).placed(own, self.reflectors.station)
        readings = direct_readings(placed, self.reflectors, self.angles)
        return np.asarray(readings @ self.joining.T, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class PreparedNormals(Prepared):
    """The ways "stitching" and "registration": a mirror, seen in pairs of points."""

    pairs: MirrorPairs
    pair_weight: Floats

    def normals(self, points: Floats) -> Normals:
        """Return the mirror's planes that points (..., n, 3) show."""
        return fit_normals(points, self.pairs, self.pair_weight)

    def deviations(self, points: Floats) -> Floats:
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

    def deviations(self, points: Floats) -> Floats:
        """Return the deviations by the least squares of everything at once."""
        mirror = joint.adjust_joint(
            points, self.normals(points), self.adjusted_together, self.mirror, _TRIAL_STEPS
        )
        return angle_deviation(mirror.psi, self.angles)


PreparedWay = PreparedPoints | PreparedNormals
"""A prepared problem of any way; that of "joint" is one of normals."""


@dataclass(frozen=True)
class ScreenedPoints:
    """A prepared problem with what the screening left out and what the user must know.

    ``lost``: rows of the mirrored points that contradict others.
    """

    prepared: PreparedWay
    rejected: tuple[Rejection, ...]
    warnings: tuple[str, ...]
    lost: tuple[int, ...] = ()


def prepare(
    problem: PlaneMirrorProblem, left_out: Mapping[int, str] | None = None, *, singly: bool = True
) -> ScreenedPoints:
    """Screen and lay out a problem; raises DataError or GeometryError when it has no solution.

    ``left_out``: rows of both points of pairs that are not used, and why. ``singly``: pairs that
    contradict the others of their group are left out one by one.
    """
    drift = find_drift(problem)
    if drift.size:
        problem = replace(problem, xyz=drift.corrected(problem.xyz))
    if problem.way == DIRECT:
        return _prepare_direct(problem, drift)
    return _prepare_mirror(problem, drift, left_out or {}, singly)


def _prepare_mirror(
    problem: PlaneMirrorProblem, drift: NestDrift, left_out: Mapping[int, str], singly: bool
) -> ScreenedPoints:
    pairs = find_pairs(problem)
    screening.check_pairs(problem, pairs)
    if left_out:
        pairs = pairs.keep(~np.isin(pairs.direct, list(left_out)))
    weight = pair_weights(problem.xyz, pairs, problem.noise)
    pairs, rejected = screening.drop_steep(problem, pairs, fit_normals(problem.xyz, pairs, weight))
    # Again: the weight rests on the approximate plane of a group, from the pairs that are left.
    weight = pair_weights(problem.xyz, pairs, problem.noise)
    inconsistent = [Rejection(row, why) for row, why in sorted(left_out.items())]
    if singly:
        pairs, weight, alone = screening.drop_inconsistent(problem, pairs, weight)
        inconsistent += alone
    normals = fit_normals(problem.xyz, pairs, weight)
    screening.check_normals(problem, pairs, normals)
    used, position = np.unique(pairs.position, return_inverse=True)
    warnings = _absent(problem, used)
    pairs = replace(pairs, position=position.astype(np.int64))
    angles = problem.angles[used]
    if problem.way == STITCHING:
        poses, nests = _one_station()
        warnings += displaced_nests(problem, drift)
        require_overlap(problem, pairs)
        require_cone(problem, pairs, angles)
        _, zero = np.unique(pairs.station, return_inverse=True)
    else:
        poses, nests, moved = _stations(problem, drift)
        warnings += moved
        zero = np.zeros_like(pairs.station)
        _require_three(problem, angles)
    # A normal from k pairs weighs k times one from a single pair.
    joining = joining_map(pairs.position, zero, 1.0 / np.bincount(pairs.group), len(angles))
    prepared = PreparedNormals(
        problem=problem,
        drift=drift,
        positions=used,
        angles=angles,
        nests=nests,
        poses=poses,
        joining=joining,
        pairs=pairs,
        pair_weight=weight,
    )
    if problem.way == JOINT:
        prepared = _with_mirror(prepared)
    lost = tuple(r.index for r in inconsistent if problem.kind[r.index] == PointKind.MIRRORED)
    return ScreenedPoints(prepared, (*rejected, *inconsistent), tuple(warnings), lost)


def _prepare_direct(problem: PlaneMirrorProblem, drift: NestDrift) -> ScreenedPoints:
    reflectors = find_reflectors(problem)
    require_circles(problem, reflectors)
    poses, nests, warnings = _stations(problem, drift)
    used, position = np.unique(reflectors.position, return_inverse=True)
    warnings += _absent(problem, used)
    reflectors = replace(reflectors, position=position.astype(np.int64))
    angles = problem.angles[used]
    placed = poses.placed(problem.xyz[reflectors.row], reflectors.station)
    variance = np.zeros(len(placed))  # of an angle: a place is as exact on a large circle
    for at, commanded in reflectors.circles(angles):
        variance[at] = 1.0 / fit_circle(placed[at], commanded)[2] ** 2
    joining = joining_map(reflectors.position, reflectors.reflector, variance, len(angles))
    prepared = PreparedPoints(
        problem=problem,
        drift=drift,
        positions=used,
        angles=angles,
        nests=nests,
        poses=poses,
        joining=joining,
        reflectors=reflectors,
    )
    return ScreenedPoints(prepared, (), tuple(warnings))


def _stations(problem: PlaneMirrorProblem, drift: NestDrift) -> tuple[Poses, Nests, list[str]]:
    """Return the registered stations, the nests of that, and what moved in words."""
    if problem.station.max() == 0:
        return *_one_station(), displaced_nests(problem, drift)
    poses, nests, moved = register(problem, find_nests(problem), drift.size)
    return poses, nests, [m.text for m in moved]


def _one_station() -> tuple[Poses, Nests]:
    """Return what stands for stations that no nests bring together."""
    return Poses.untied(1), Nests.none()


def _with_mirror(prepared: PreparedNormals) -> PreparedJoint:
    """Return the problem with its least squares, from the registered stations."""
    xyz = prepared.problem.xyz
    normals = prepared.normals(xyz)
    start = joint.start_mirror(normals, prepared.pairs, prepared.poses, prepared.angles)
    mirror = joint.adjust_joint(xyz, normals, prepared.adjusted_together, start)
    return PreparedJoint(**{**vars(prepared), "poses": mirror.poses}, mirror=mirror)


def _absent(problem: PlaneMirrorProblem, used: Ints) -> list[str]:
    """Return in words which positions are not among the ``used`` ones."""
    absent = np.setdiff1d(np.arange(len(problem.angles)), used)
    names = ", ".join(problem.position_name(int(i)) for i in absent)
    return [f"no usable points at {names}: left out of the result"] if len(absent) else []


def _require_three(problem: PlaneMirrorProblem, angles: Floats) -> None:
    if len(angles) < 3:
        raise DataError(
            f"{problem.source}: {len(angles)} table positions have a mirror normal, the plane of "
            "rotation needs at least 3"
        )
