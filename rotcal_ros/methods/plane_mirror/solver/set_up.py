"""From points to what the model takes: blunders refused in words, rows laid out, a first solution.

What leaves no doubt on the shop floor is refused with DataError or GeometryError. Single readings
that are wrong, moved nests and drift are left to the engine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from math import dist, hypot
from typing import Final

import numpy as np

from rotcal_ros.adjust.distributions import chi2_isf
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import DataError, GeometryError
from rotcal_ros.foundation.language import Phrase, join_texts, noted, phrase
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.results import Rejection
from rotcal_ros.foundation.units import DEGREE, MILLIMETRE
from rotcal_ros.geometry.rotations import require_spread, wrap_angle
from rotcal_ros.methods.plane_mirror.settings import DIRECT, JOINT, STITCHING
from rotcal_ros.methods.plane_mirror.solver.printed import connected_islands, mean_normals
from rotcal_ros.methods.plane_mirror.solver.problem import (
    MirrorPairs,
    Nests,
    PlaneMirrorProblem,
    PointLayout,
    Reflectors,
    find_nests,
    find_pairs,
    find_reflectors,
    nest_rounds,
)

STEEP: Final = noted("angle of incidence {0:.1f} deg is beyond the limit of {1:g} deg")
NO_POINTS: Final = noted("no usable points at {0}: left out of the result")

MIN_SEPARATION: Final = 1e-3
"""Two reflectors, or a reflector and its image, are never closer than this (m)."""
MAX_MISFIT: Final = 2.0 * DEGREE
"""Normals of one station are closer to the command than this, leaning by up to 8 degrees."""
GROSS: Final = 25.0
"""A chi square this many times its limit is a blunder, not noise stated too small."""
MIN_APART: Final = 5e-3
"""Two nests are never closer than this (m): it is less than any reflector."""
MATCH: Final = 2e-3
"""Distances (m) that agree within this show the same two nests."""
MIN_ARC: Final = 5e-3
"""Smallest singular value of an arc of directions, about its height: four degrees end to end."""
MIN_CIRCLE: Final = 1e-3
"""Smallest singular value of the places on a circle that show its centre and radius."""


def lay_out_points(
    problem: PlaneMirrorProblem,
) -> tuple[PointLayout, tuple[Rejection, ...], tuple[Phrase, ...]]:
    """Return what belongs together, what is not used and why, and what the user must know.

    Raises DataError or GeometryError where there is no solution.
    """
    mirror = bool((problem.kind == PointKind.MIRRORED).any()) or problem.way not in (JOINT, DIRECT)
    pairs, reflectors, rejected = None, Reflectors.none(), list[Rejection]()
    if not mirror:
        reflectors = find_reflectors(problem)
        used, position = np.unique(reflectors.position, return_inverse=True)
        reflectors = replace(reflectors, position=position.astype(np.int64))
    elif problem.way == DIRECT:
        row = int(np.flatnonzero(problem.kind == PointKind.MIRRORED)[0])
        raise DataError(
            f"{problem.source}: {problem.row_name(row)} in the direct way; here the table carries "
            "the reflectors and there is no mirror: choose joint, stitching or registration"
        )
    else:
        pairs = find_pairs(problem)
        check_pairs(problem, pairs)
        pairs, rejected = drop_steep(problem, pairs)
        check_planes(problem, pairs)
        check_normals(problem, pairs)
        used, position = np.unique(pairs.position, return_inverse=True)
        pairs = replace(pairs, position=position.astype(np.int64))
    nests, tied = joining_nests(problem)
    layout = PointLayout(problem, used, problem.angles[used], pairs, reflectors, nests, tied)
    require_angles(layout, problem.way)
    absent = np.setdiff1d(np.arange(len(problem.angles)), used).tolist()
    names = join_texts([problem.position_name(i) for i in absent], ", ")
    missing = (phrase(NO_POINTS, names),) * bool(absent)
    return layout, tuple(rejected), missing


def joining_nests(problem: PlaneMirrorProblem) -> tuple[Nests, bool]:
    """Return the nests, and whether they join the stations; stitching may do without.

    Where they do not, a nest that two stations see is two nests.
    """
    nests, count = find_nests(problem), int(problem.station.max()) + 1
    check_apart(problem, nests)
    try:
        if count > 1:
            check_exchanged(problem, nests)
            require_nests(problem, nests, count)
        return nests, True
    except (DataError, GeometryError):
        if problem.way != STITCHING:
            raise
    rows, rounds = np.flatnonzero(problem.kind == PointKind.NEST), nest_rounds(problem)
    key = np.column_stack([problem.station[rows], problem.nest[rows]])
    names, point = np.unique(key, axis=0, return_inverse=True)
    return Nests.of(rows, problem.station[rows], rounds[rows], point.ravel(), names[:, 1]), False


def check_pairs(problem: PlaneMirrorProblem, pairs: MirrorPairs) -> None:
    """Refuse a reflector measured twice directly, and direct and mirrored points exchanged."""
    for direct, mirrored in zip(pairs.direct.tolist(), pairs.mirrored.tolist(), strict=True):
        if why := not_an_image(problem.xyz[direct].tolist(), problem.xyz[mirrored].tolist()):
            raise DataError(
                f"{problem.source}: {problem.row_name(direct)}: {why} (points are given in the "
                "tracker's own frame, not in a common one); correct the row, or leave it out"
            )


def not_an_image(direct: Sequence[float], mirrored: Sequence[float]) -> Phrase | None:
    """Say why a point cannot be the image of the reflector at ``direct``; None: it may be.

    The plane half way between M and M' separates the tracker from the image, so the direct point
    is always the nearer one.
    """
    apart = dist(direct, mirrored)
    if apart < MIN_SEPARATION:
        return phrase(
            "the mirrored point is {0:.3f} mm from the direct one: the same point was measured "
            "twice; measure the image through the mirror", apart / MILLIMETRE
        )  # fmt: skip
    near, far = hypot(*direct), hypot(*mirrored)
    if near >= far:
        return phrase(
            "the mirrored point is {0:.4f} m away, the direct one {1:.4f} m, but an image is "
            "always the farther one: direct and mirrored exchanged", far, near
        )  # fmt: skip
    return None


def incidence(problem: PlaneMirrorProblem, pairs: MirrorPairs) -> Floats:
    """Return the angle (P,) in rad between each mirrored beam and the normal of its group."""
    beam = problem.xyz[pairs.mirrored]
    normal = mean_normals(problem.xyz, pairs)[pairs.group]
    cosine = -np.einsum("pi,pi->p", beam, normal) / np.linalg.norm(beam, axis=-1)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def drop_steep(
    problem: PlaneMirrorProblem, pairs: MirrorPairs
) -> tuple[MirrorPairs, list[Rejection]]:
    """Leave out pairs whose beam strikes the mirror beyond the incidence limit."""
    angle, limit = incidence(problem, pairs), problem.incidence_limit / DEGREE
    steep = angle > problem.incidence_limit
    rejected = [
        Rejection(
            int(row),
            phrase(STEEP, angle[pair] / DEGREE, limit),
        )
        for pair in np.flatnonzero(steep)
        for row in (pairs.direct[pair], pairs.mirrored[pair])
    ]
    if steep.all():
        raise DataError(
            f"{problem.source}: every beam strikes the mirror beyond {limit:g} deg (least "
            f"{angle.min() / DEGREE:.1f} deg); turn the mirror towards the tracker"
        )
    return pairs.keep(~steep) if steep.any() else pairs, rejected


def check_planes(problem: PlaneMirrorProblem, pairs: MirrorPairs) -> None:
    """Refuse two reflectors of a position that show planes which no noise explains.

    Of more than two the engine finds the one that is wrong.
    """
    limit = GROSS * float(chi2_isf(problem.significance / pairs.n_groups, 3))
    for group in np.flatnonzero(np.bincount(pairs.group) == 2).tolist():
        both = pairs.group == group
        near, far = problem.xyz[pairs.direct[both]], problem.xyz[pairs.mirrored[both]]
        normal = near - far
        apart = np.linalg.norm(normal, axis=1)
        normal /= apart[:, None]
        # what the plane of one, M to M', makes of the other's image
        height = (near[1] - 0.5 * (near[0] + far[0])) @ normal[0]
        missed = far[1] - near[1] + 2.0 * height * normal[0]
        noise = np.einsum("pii->p", problem.noise.covariance(problem.xyz[pairs.mirrored[both]]))
        slope = (problem.noise.mirror_slope_std * apart.max()) ** 2
        reach = float(np.linalg.norm(near[1] - near[0])) / float(apart.min())
        if missed @ missed > limit * 4.0 * (noise.sum() + slope) * (1.0 + reach**2):
            names = ", ".join(str(problem.nest[row]) for row in pairs.direct[both])
            raise DataError(
                f"{problem.source}: {problem.position_name(int(pairs.position[group]))}, tracker "
                f"station {problem.station_name(int(pairs.station[group]))}: reflectors {names} "
                "show different mirror planes and neither can be shown to be right: reflector on "
                "the wrong nest, nest or mirror moved in between; measure this position again"
            )


def check_normals(problem: PlaneMirrorProblem, pairs: MirrorPairs) -> None:
    """Refuse a normal that stands degrees away from where the table was sent."""
    apart = problem.xyz[pairs.direct] - problem.xyz[pairs.mirrored]
    apart /= np.linalg.norm(apart, axis=1)[:, None]
    normals = np.stack([np.median(apart[pairs.group == g], axis=0) for g in range(pairs.n_groups)])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    for station in np.unique(pairs.station).tolist():
        at = np.flatnonzero(pairs.station == station)
        n, commanded = normals[at], problem.angles[pairs.position[at]]
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


def require_angles(layout: PointLayout, way: str) -> None:
    """Raise where a ``way`` does not find the plane in which the table turns."""
    problem = layout.problem
    if layout.pairs is None:
        _require_circles(layout)
    elif way == STITCHING:
        _require_chain(layout)
    elif not layout.tied:
        raise DataError(f"{problem.source}: the nests do not join the tracker stations")
    elif len(layout.angles) < 3:
        raise DataError(
            f"{problem.source}: {len(layout.angles)} table positions have a mirror normal, the "
            "plane of rotation needs at least 3"
        )


def _require_circles(layout: PointLayout) -> None:
    problem = layout.problem
    for name, (at, azimuth) in zip(layout.reflectors.name, layout.sets(), strict=True):
        places = len(np.unique(layout.position[at]))
        if places < 3:
            raise DataError(
                f"{problem.source}: reflector {name} was measured at {places} table positions, "
                "its circle needs 3"
            )
        if np.linalg.svd(circle_columns(azimuth), compute_uv=False)[-1] < MIN_CIRCLE:
            raise GeometryError(
                f"{problem.source}: the places of reflector {name} span too small an arc to fit "
                "a circle; measure around the whole circle"
            )


def circle_columns(azimuth: Floats) -> Floats:
    """Return (m, 3): how two tilts and the height of a plane move the points of a circle."""
    return np.column_stack([np.cos(azimuth), np.sin(azimuth), np.ones_like(azimuth)])


def _require_chain(layout: PointLayout) -> None:
    """Raise unless shared positions tie all stations, and each has an axis."""
    problem, pairs = layout.problem, layout.pairs
    assert pairs is not None
    every, used = np.unique(pairs.station, return_inverse=True)
    label = connected_islands(pairs.position, used, len(layout.angles))[1]
    if len(loose := np.flatnonzero(label != label[0])):
        raise DataError(
            f"{problem.source}: tracker station {problem.station_name(int(every[loose[0]]))} "
            "shares no table position with the stations before it, so stitching has no zero for "
            "it; measure one position from both, or choose registration or joint"
        )
    counts = np.bincount(pairs.station)
    if counts.max() < 3:
        raise GeometryError(
            f"{problem.source}: no tracker station sees three table positions (at most "
            f"{counts.max()}), so stitching finds no plane of rotation; choose registration "
            "or joint"
        )
    for station in np.flatnonzero(counts > 1):
        azimuth = layout.angles[pairs.position[pairs.station == station]]
        # two normals need an arc for the two tilts of the axis alone: the height is given
        design = circle_columns(azimuth)[:, : len(azimuth)]
        if np.linalg.svd(design, compute_uv=False)[-1] < MIN_ARC:
            raise GeometryError(
                f"{problem.source}: the {len(azimuth)} positions seen from tracker station "
                f"{problem.station_name(int(station))} span too small an arc for a plane of its "
                "own; measure more positions from there, or choose registration or joint"
            )


def require_nests(problem: PlaneMirrorProblem, nests: Nests, count: int) -> None:
    """Raise unless the nests that each station shares with others fix it: three, not in a line."""
    known = np.full((nests.n_points, 3), np.nan)
    for station, own, rows in nests.order_of_placing(count):
        both = own[~np.isnan(known[own, 0])] if station else own
        names = ", ".join(str(name) for name in nests.name[both])
        where = f"{problem.source}: tracker station {problem.station_name(station)}"
        if station and len(both) < 3:
            raise GeometryError(
                f"{where} shares {len(both)} nests ({names or 'none'}) with the stations placed "
                "before it, registration needs 3; measure more nests from there, or choose "
                "stitching"
            )
        places = np.array([problem.xyz[each].mean(axis=0) for each in rows]).reshape(-1, 3)
        if station:
            what = f"{where}: the nests {names} that it shares with the others"
            require_spread(places[np.isin(own, both)], what)
        known[own] = places


def check_apart(problem: PlaneMirrorProblem, nests: Nests) -> None:
    """Refuse two nests in one place: one was measured with the reflector on the other."""
    for station in np.unique(nests.station):
        at = np.flatnonzero(nests.station == station)
        points = problem.xyz[nests.row[at]]
        apart = np.linalg.norm(points[:, None] - points, axis=2)
        near = (apart < MIN_APART) & (nests.point[at][:, None] != nests.point[at])
        for i, j in np.argwhere(np.triu(near))[:1].tolist():
            a, b = nests.name[nests.point[at[i]]], nests.name[nests.point[at[j]]]
            raise DataError(
                f"{problem.source}: from tracker station {problem.station_name(int(station))} "
                f"nests {a} and {b} are {apart[i, j] * 1e3:.3f} mm apart, so one of them was "
                "measured with the reflector on the wrong nest; measure both again"
            )


def check_exchanged(problem: PlaneMirrorProblem, nests: Nests) -> None:
    """Refuse two nests whose numbers are exchanged at a station.

    Distances between nests are the same from every station, wherever it stands; where they are
    not, and are once two nests are swapped, these were exchanged.
    """
    table = np.full((int(problem.station.max()) + 1, nests.n_points, 3), np.nan)
    # backwards, so that of several readings the first one stays
    table[nests.station[::-1], nests.point[::-1]] = problem.xyz[nests.row[::-1]]
    for station in range(1, len(table)):
        for reference in range(station):
            both = np.flatnonzero(np.isfinite(table[station, :, 0] + table[reference, :, 0]))
            if len(both) < 3:
                continue
            here, there = _distances(table[station, both]), _distances(table[reference, both])
            if np.abs(here - there).max() < MATCH:
                break
            swap = _exchange(here, there)
            if swap is not None:
                a, b = nests.name[both[list(swap)]]
                raise DataError(
                    f"{problem.source}: nests {a} and {b} are exchanged at tracker station "
                    f"{problem.station_name(station)} or {problem.station_name(reference)}: all "
                    "distances agree once they are swapped; correct the nest numbers"
                )


def _exchange(here: Floats, there: Floats) -> tuple[int, int] | None:
    """Return the two nests to swap so that all distances agree; None without a single answer."""
    answers = []
    for i, j in combinations(range(len(here)), 2):
        order = np.arange(len(here))
        order[[i, j]] = j, i
        if np.abs(here[np.ix_(order, order)] - there).max() < MATCH:
            answers.append((i, j))
    return answers[0] if len(answers) == 1 else None


def _distances(points: Floats) -> Floats:
    return np.asarray(np.linalg.norm(points[:, None] - points[None, :], axis=2))
