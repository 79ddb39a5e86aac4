"""Screening a problem and laying it out for its way.

Blunders on the shop floor that leave no doubt are refused with DataError. What can be left out
safely is left out, and the result says which rows and why.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import dist, hypot
from typing import Final

import numpy as np

from rotcal_ros.adjust.distributions import chi2_isf
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.results import Rejection
from rotcal_ros.foundation.units import DEGREE, MILLIMETRE
from rotcal_ros.geometry.rotations import wrap_angle
from rotcal_ros.methods.plane_mirror.settings import DIRECT, JOINT, STITCHING
from rotcal_ros.methods.plane_mirror.solver import joint
from rotcal_ros.methods.plane_mirror.solver.drift import NestDrift, displaced_nests, find_drift
from rotcal_ros.methods.plane_mirror.solver.normals import (
    Normals,
    fit_normals,
    incidence,
    pair_weights,
)
from rotcal_ros.methods.plane_mirror.solver.problem import (
    MirrorPairs,
    Nests,
    PlaneMirrorProblem,
    find_nests,
    find_pairs,
    find_reflectors,
)
from rotcal_ros.methods.plane_mirror.solver.readings import (
    fit_circle,
    joining_map,
    require_circles,
    require_cone,
    require_overlap,
)
from rotcal_ros.methods.plane_mirror.solver.registration import Poses, register
from rotcal_ros.methods.plane_mirror.solver.ways import (
    PreparedJoint,
    PreparedNormals,
    PreparedPoints,
    PreparedWay,
)

MIN_SEPARATION: Final = 1e-3
"""Two reflectors, or a reflector and its image, are never closer than this (m)."""
MAX_MISFIT: Final = 2.0 * DEGREE
"""Normals of one station are closer to the command than this, leaning by up to 8 degrees."""
GROSS: Final = 25.0
"""A chi square this many times its limit is a blunder, not noise stated too small."""


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
    check_pairs(problem, pairs)
    if left_out:
        pairs = pairs.keep(~np.isin(pairs.direct, list(left_out)))
    weight = pair_weights(problem.xyz, pairs, problem.noise)
    pairs, rejected = drop_steep(problem, pairs, fit_normals(problem.xyz, pairs, weight))
    # Again: the weight rests on the approximate plane of a group, from the pairs that are left.
    weight = pair_weights(problem.xyz, pairs, problem.noise)
    inconsistent = [Rejection(row, why) for row, why in sorted(left_out.items())]
    if singly:
        pairs, weight, alone = drop_inconsistent(problem, pairs, weight)
        inconsistent += alone
    normals = fit_normals(problem.xyz, pairs, weight)
    check_normals(problem, pairs, normals)
    used, position = np.unique(pairs.position, return_inverse=True)
    warnings = _absent(problem, used)
    pairs = replace(pairs, position=position.astype(np.int64))
    angles, stitched = problem.angles[used], problem.way == STITCHING
    poses, nests, moved = _stations(problem, drift)
    if stitched:
        require_overlap(problem, pairs)
        require_cone(problem, pairs, angles)
    else:
        _require_three(problem, angles)
    sets = pairs.sets(angles, by_station=stitched)
    # A normal from k pairs weighs k times one from a single pair.
    variance = 1.0 / np.bincount(pairs.group)
    joining = joining_map(pairs.position, sets.number, variance, len(angles))
    prepared = PreparedNormals(
        problem=problem,
        drift=drift,
        positions=used,
        angles=angles,
        nests=nests,
        poses=poses,
        sets=sets,
        joining=joining,
        pairs=pairs,
        pair_weight=weight,
    )
    if problem.way == JOINT:
        prepared = _with_mirror(prepared)
    lost = tuple(r.index for r in inconsistent if problem.kind[r.index] == PointKind.MIRRORED)
    return ScreenedPoints(prepared, (*rejected, *inconsistent), (*warnings, *moved), lost)


def _prepare_direct(problem: PlaneMirrorProblem, drift: NestDrift) -> ScreenedPoints:
    reflectors = find_reflectors(problem)
    require_circles(problem, reflectors)
    poses, nests, moved = _stations(problem, drift)
    used, position = np.unique(reflectors.position, return_inverse=True)
    warnings = _absent(problem, used)
    reflectors = replace(reflectors, position=position.astype(np.int64))
    angles = problem.angles[used]
    sets = reflectors.sets(angles)
    placed = poses.placed(problem.xyz[reflectors.row], reflectors.station)
    variance = np.zeros(len(placed))  # of an angle: a place is as exact on a large circle
    for at, commanded in sets:
        variance[at] = 1.0 / fit_circle(placed[at], commanded)[2] ** 2
    joining = joining_map(reflectors.position, sets.number, variance, len(angles))
    prepared = PreparedPoints(
        problem=problem,
        drift=drift,
        positions=used,
        angles=angles,
        nests=nests,
        poses=poses,
        sets=sets,
        joining=joining,
        reflectors=reflectors,
    )
    return ScreenedPoints(prepared, (), (*moved, *warnings))


def _stations(problem: PlaneMirrorProblem, drift: NestDrift) -> tuple[Poses, Nests, list[str]]:
    """Return the registered stations, the nests of that, and what moved in words.

    One station needs no nests, and stitching leaves each as it stands.
    """
    count = int(problem.station.max()) + 1
    if count == 1 or problem.way == STITCHING:
        return Poses.untied(count), Nests.none(), displaced_nests(problem, drift)
    poses, nests, moved = register(problem, find_nests(problem), drift.size)
    return poses, nests, [m.text for m in moved]


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


def check_pairs(problem: PlaneMirrorProblem, pairs: MirrorPairs) -> None:
    """Refuse a reflector measured twice directly, and direct and mirrored points exchanged."""
    for direct, mirrored in zip(pairs.direct.tolist(), pairs.mirrored.tolist(), strict=True):
        if why := not_an_image(problem.xyz[direct].tolist(), problem.xyz[mirrored].tolist()):
            raise DataError(
                f"{problem.source}: {problem.row_name(direct)}: {why} (points are given in the "
                "tracker's own frame, not in a common one); correct the row, or leave it out"
            )


def not_an_image(direct: Sequence[float], mirrored: Sequence[float]) -> str | None:
    """Say why a point cannot be the image of the reflector at ``direct``; None: it may be.

    The plane half way between M and M' separates the tracker from the image, so the direct point
    is always the nearer one.
    """
    apart = dist(direct, mirrored)
    if apart < MIN_SEPARATION:
        return (
            f"the mirrored point is {apart / MILLIMETRE:.3f} mm from the direct one: the same "
            "point was measured twice; measure the image through the mirror"
        )
    near, far = hypot(*direct), hypot(*mirrored)
    if near >= far:
        return (
            f"the mirrored point is {far:.4f} m away, the direct one {near:.4f} m, but an image "
            "is always the farther one: direct and mirrored exchanged"
        )
    return None


def drop_steep(
    problem: PlaneMirrorProblem, pairs: MirrorPairs, normals: Normals
) -> tuple[MirrorPairs, list[Rejection]]:
    """Leave out pairs whose beam strikes the mirror beyond the incidence limit."""
    angle = incidence(problem.xyz, pairs, normals.normal)
    steep = angle > problem.incidence_limit
    why = "angle of incidence {:.1f} deg is beyond the limit of {:g} deg"
    limit = problem.incidence_limit / DEGREE
    rejected = [
        Rejection(int(row), why.format(angle[pair] / DEGREE, limit))
        for pair in np.flatnonzero(steep)
        for row in (pairs.direct[pair], pairs.mirrored[pair])
    ]
    if steep.all():
        raise DataError(
            f"{problem.source}: every beam strikes the mirror beyond {limit:g} deg (least "
            f"{angle.min() / DEGREE:.1f} deg); turn the mirror towards the tracker"
        )
    return pairs.keep(~steep) if steep.any() else pairs, rejected


def drop_inconsistent(
    problem: PlaneMirrorProblem, pairs: MirrorPairs, weight: Floats
) -> tuple[MirrorPairs, Floats, list[Rejection]]:
    """Leave out the pair that contradicts the others of its group; returns pairs and weights.

    All pairs of a group show the same plane. Of three or more, the one that does not fit is found
    and left out. Two that disagree cannot say which is wrong: they are refused when no noise
    explains it, and left to the test of all residuals when more noise than stated would.
    """
    rejected: list[Rejection] = []
    undecided: set[tuple[int, int]] = set()
    while True:
        normals = fit_normals(problem.xyz, pairs, weight)
        # Of k pairs there are 3 k conditions for the three unknowns of a plane.
        squares = np.einsum("pi,pij,pj->p", normals.misclosure, weight, normals.misclosure)
        total = np.add.reduceat(squares, pairs.start)
        count = np.bincount(pairs.group)
        limit = chi2_isf(problem.significance / pairs.n_groups, np.maximum(3 * count - 3, 1))
        places = list(zip(pairs.position.tolist(), pairs.station.tolist(), strict=True))
        known = np.array([place in undecided for place in places])
        bad = np.flatnonzero((count > 1) & (total > limit) & ~known)
        if not len(bad):
            return pairs, weight, rejected
        group = int(bad[np.argmax(total[bad] / limit[bad])])
        pair = _culprit(problem, pairs, weight, group)
        if pair is None:
            if total[group] > GROSS * limit[group]:
                raise DataError(_undecided(problem, pairs, group))
            undecided.add(places[group])
            continue
        nest = problem.nest[pairs.direct[pair]]
        why = f"reflector {nest} shows another mirror plane than the others of its position"
        rejected += [Rejection(int(rows[pair]), why) for rows in (pairs.direct, pairs.mirrored)]
        wanted = np.arange(len(pairs.direct)) != pair
        pairs, weight = pairs.keep(wanted), weight[wanted]


def check_normals(problem: PlaneMirrorProblem, pairs: MirrorPairs, normals: Normals) -> None:
    """Refuse a normal that stands degrees away from where the table was sent."""
    for at, commanded in pairs.sets(problem.angles, by_station=True):
        station = int(pairs.station[at[0]])
        n = normals.normal[at]
        seen = np.arccos(np.clip(n @ n.T, -1.0, 1.0))
        turn = commanded[:, None] - commanded[None, :]
        wrong = np.abs(seen - np.abs(wrap_angle(turn))) > MAX_MISFIT
        if not wrong.any():
            continue
        worst = int(np.argmax(wrong.sum(axis=1)))
        other = int(np.argmax(wrong[worst]))
        clear = len(at) > 2 and wrong.sum(axis=1)[worst] > wrong.sum(axis=1)[other]
        names = problem.position_name(int(pairs.position[at[worst]]))
        against = problem.position_name(int(pairs.position[at[other]]))
        raise DataError(
            f"{problem.source}: from tracker station {problem.station_name(station)} the "
            f"mirror at {names} stands {seen[worst, other] / DEGREE:.2f} deg from its normal at "
            f"{against}{'' if clear else ', one of them wrong'}: reflector on the wrong nest, "
            "wrong position number, or wrong commanded angle"
        )


def _culprit(
    problem: PlaneMirrorProblem, pairs: MirrorPairs, weight: Floats, group: int
) -> int | None:
    """Return the pair of a group without which the others agree; None when that is undecided."""
    members = np.flatnonzero(pairs.group == group)
    left = []
    for pair in members:
        wanted = (pairs.group == group) & (np.arange(len(pairs.group)) != pair)
        rest = pairs.keep(wanted)
        e = fit_normals(problem.xyz, rest, weight[wanted]).misclosure
        left.append(float(np.einsum("pi,pij,pj->", e, weight[wanted], e)))
    dof = 3 * len(members) - 6  # of one pair less
    if dof == 0 or min(left) > chi2_isf(problem.significance / pairs.n_groups, dof):
        return None
    return int(members[int(np.argmin(left))])


def _undecided(problem: PlaneMirrorProblem, pairs: MirrorPairs, group: int) -> str:
    names = ", ".join(str(problem.nest[row]) for row in pairs.direct[pairs.group == group])
    return (
        f"{problem.source}: {problem.position_name(int(pairs.position[group]))}, tracker "
        f"station {problem.station_name(int(pairs.station[group]))}: reflectors {names} "
        "show different mirror planes and neither can be shown to be right: reflector on the "
        "wrong nest, nest or mirror moved in between; measure this position again"
    )
