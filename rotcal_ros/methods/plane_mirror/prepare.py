"""Screening a problem and laying it out, once for one solution or for thousands of trials."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rotcal_ros.arrays import Floats, Ints
from rotcal_ros.errors import DataError
from rotcal_ros.methods.plane_mirror import screening
from rotcal_ros.methods.plane_mirror.direct import fit_circle, require_circles
from rotcal_ros.methods.plane_mirror.estimate import (
    PreparedJoint,
    PreparedNormals,
    PreparedPoints,
    PreparedWay,
)
from rotcal_ros.methods.plane_mirror.joint import adjust_joint, start_mirror
from rotcal_ros.methods.plane_mirror.layout import Nests, find_nests, find_pairs, find_reflectors
from rotcal_ros.methods.plane_mirror.nest_tests import register
from rotcal_ros.methods.plane_mirror.normals import fit_normals, pair_weights
from rotcal_ros.methods.plane_mirror.problem import PlaneMirrorProblem
from rotcal_ros.methods.plane_mirror.registration import Poses
from rotcal_ros.methods.plane_mirror.stitching import joining_map, require_cone, require_overlap
from rotcal_ros.results import Rejection


@dataclass(frozen=True)
class Screened:
    """A prepared problem with what the screening left out and what the user must know."""

    prepared: PreparedWay
    rejected: tuple[Rejection, ...]
    warnings: tuple[str, ...]


def prepare(problem: PlaneMirrorProblem) -> Screened:
    """Screen and lay out a problem; raises DataError or GeometryError when it has no solution."""
    return _prepare_direct(problem) if problem.way == "direct" else _prepare_mirror(problem)


def _prepare_mirror(problem: PlaneMirrorProblem) -> Screened:
    pairs = find_pairs(problem)
    screening.check_pairs(problem, pairs)
    weight = pair_weights(problem.xyz, pairs, problem.noise)
    pairs, rejected = screening.drop_steep(problem, pairs, fit_normals(problem.xyz, pairs, weight))
    weight = pair_weights(problem.xyz, pairs, problem.noise)
    pairs, weight, inconsistent = screening.drop_inconsistent(problem, pairs, weight)
    normals = fit_normals(problem.xyz, pairs, weight)
    screening.check_normals(problem, pairs, normals)
    used, position = np.unique(pairs.position, return_inverse=True)
    warnings = _absent(problem, used)
    pairs = replace(pairs, position=position.astype(np.int64))
    angles = problem.angles[used]
    if problem.way == "stitching":
        poses, nests = _no_stations(), _no_nests()
        require_overlap(problem, pairs)
        require_cone(problem, pairs, angles)
        _, zero = np.unique(pairs.station, return_inverse=True)
    else:
        poses, nests, moved = _stations(problem)
        warnings += moved
        zero = np.zeros_like(pairs.station)
        _require_three(problem, angles)
    joining = joining_map(pairs.position, zero, 1.0 / np.bincount(pairs.group), len(angles))
    prepared = PreparedNormals(
        problem=problem,
        angles=angles,
        nests=nests,
        poses=poses,
        joining=joining,
        pairs=pairs,
        pair_weight=weight,
    )
    if problem.way == "joint":
        prepared = _with_mirror(prepared)
    return Screened(prepared, (*rejected, *inconsistent), tuple(warnings))


def _prepare_direct(problem: PlaneMirrorProblem) -> Screened:
    reflectors = find_reflectors(problem)
    require_circles(problem, reflectors)
    poses, nests, warnings = _stations(problem)
    used, position = np.unique(reflectors.position, return_inverse=True)
    warnings += _absent(problem, used)
    reflectors = replace(reflectors, position=position.astype(np.int64))
    angles = problem.angles[used]
    placed = poses.placed(problem.xyz[reflectors.row], reflectors.station)
    variance = np.zeros(len(placed))
    for at, commanded in reflectors.circles(angles):
        variance[at] = 1.0 / fit_circle(placed[at], commanded)[2] ** 2
    joining = joining_map(reflectors.position, reflectors.reflector, variance, len(angles))
    prepared = PreparedPoints(
        problem=problem,
        angles=angles,
        nests=nests,
        poses=poses,
        joining=joining,
        reflectors=reflectors,
    )
    return Screened(prepared, (), tuple(warnings))


def _stations(problem: PlaneMirrorProblem) -> tuple[Poses, Nests, list[str]]:
    if problem.station.max() == 0:
        return _no_stations(), _no_nests(), []
    return register(problem, find_nests(problem))


def _no_stations() -> Poses:
    return Poses(np.eye(3)[None], np.zeros((1, 3)))


def _no_nests() -> Nests:
    none = np.zeros(0, dtype=np.int64)
    return Nests(none, none, none, none, none)


def _with_mirror(prepared: PreparedNormals) -> PreparedJoint:
    xyz = prepared.problem.xyz
    normals = prepared.normals(xyz)
    start = start_mirror(normals, prepared.pairs, prepared.poses, prepared.angles)
    mirror = adjust_joint(xyz, normals, prepared.adjusted_together, start)
    return PreparedJoint(**{**vars(prepared), "poses": mirror.poses}, mirror=mirror)


def _absent(problem: PlaneMirrorProblem, used: Ints) -> list[str]:
    absent = np.setdiff1d(np.arange(len(problem.angles)), used)
    names = ", ".join(problem.position_name(int(i)) for i in absent)
    return [f"no usable points at {names}: left out of the result"] if len(absent) else []


def _require_three(problem: PlaneMirrorProblem, angles: Floats) -> None:
    if len(angles) < 3:
        raise DataError(
            f"{problem.source}: {len(angles)} table positions have a mirror normal, the plane of "
            "rotation needs at least 3"
        )
