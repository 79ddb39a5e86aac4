"""Finding what went wrong on the shop floor before it becomes a number.

Blunders that leave no doubt are refused with DataError. What can be left out safely is left out,
and the result says which rows and why.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.adjust.distributions import chi2_isf
from rotcal_ros.foundation.arrays import Bools, Floats
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.results import Rejection
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.geometry.rotations import wrap_angle
from rotcal_ros.methods.plane_mirror.solver.normals import Normals, fit_normals, incidence
from rotcal_ros.methods.plane_mirror.solver.problem import MirrorPairs, PlaneMirrorProblem

MIN_SEPARATION: Final = 1e-3
"""Two reflectors, or a reflector and its image, are never closer than this (m)."""
MAX_MISFIT: Final = 2.0 * DEGREE
"""Normals of one station are closer to the command than this, leaning by up to 8 degrees."""
GROSS: Final = 25.0
"""A chi square this many times its limit is a blunder, not noise stated too small."""
MAX_DEVIATION: Final = 1.0 * DEGREE
"""No rotary table is this wrong; a commanded angle or a nest is."""


def check_pairs(problem: PlaneMirrorProblem, pairs: MirrorPairs) -> None:
    """Refuse a reflector measured twice directly, and direct and mirrored points exchanged.

    The plane half way between M and M' separates the tracker from the image, so the direct point
    is always the nearer one.
    """
    direct, mirrored = problem.xyz[pairs.direct], problem.xyz[pairs.mirrored]
    apart = np.linalg.norm(direct - mirrored, axis=1)
    near, far = np.linalg.norm(direct, axis=1), np.linalg.norm(mirrored, axis=1)
    for pair, row in enumerate(pairs.direct):
        where = f"{problem.source}: {problem.row_name(int(row))}"
        if apart[pair] < MIN_SEPARATION:
            raise DataError(
                f"{where} and its mirrored point are {apart[pair] * 1e3:.3f} mm apart: the same "
                "point was measured twice; measure the image through the mirror"
            )
        if near[pair] >= far[pair]:
            raise DataError(
                f"{where} is {near[pair]:.3f} m from the tracker and its mirrored point "
                f"{far[pair]:.3f} m, but the image is always the farther one: exchange direct and "
                "mirrored (and give the points in the tracker's own frame, not in a common one)"
            )


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
    for station, at, commanded in pairs.stations(problem.angles):
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


def check_size(problem: PlaneMirrorProblem, angles: Floats, deviations: Floats) -> None:
    """Refuse deviations that no table has, naming the worst position; ``angles`` (N,) rad."""
    worst = int(np.argmax(np.abs(deviations)))
    if not np.all(np.isfinite(deviations)) or abs(deviations[worst]) > MAX_DEVIATION:
        raise DataError(
            f"{problem.source}: the table position commanded to {angles[worst] / DEGREE:g} deg "
            f"comes out {deviations[worst] / DEGREE:.2f} deg off; no table is that wrong: "
            "reflector on the wrong nest, wrong position number, or wrong commanded angle"
        )


def repeats(
    angles: Floats,
    deviations: Floats,
    covariance: Floats,
    significance: float,
    upward: Bools | None = None,
) -> tuple[list[dict[str, float | int]], list[str]]:
    """Compare positions commanded to the same angle from the same side, whole turns apart or not.

    Returns one entry per repeat (positions, difference, its std; rad) and a warning for each that
    differs by more than its uncertainty explains. 0 and 360 degrees are the closure.
    """
    entries: list[dict[str, float | int]] = []
    warnings: list[str] = []
    for later in range(len(angles)):
        # What is left of whole turns, on either side of zero.
        turn = (angles[later] - angles[:later] + 1e-7) % (2.0 * np.pi)
        same_side = upward is None or upward[:later] == upward[later]
        for earlier in np.flatnonzero((turn < 2e-7) & same_side)[:1]:
            difference = float(deviations[later] - deviations[earlier])
            spread = covariance[later, later] + covariance[earlier, earlier]
            variance = max(float(spread - 2.0 * covariance[later, earlier]), 1e-300)
            entries.append(
                {
                    "first": int(earlier),
                    "second": int(later),
                    "difference_rad": difference,
                    "std_rad": variance**0.5,
                }
            )
            if difference**2 / variance > chi2_isf(significance, 1):
                warnings.append(
                    f"positions commanded to {angles[earlier] / DEGREE:g} and "
                    f"{angles[later] / DEGREE:g} deg differ by {difference / DEGREE * 3600:.2f} "
                    f"arcsec, expected within {2 * variance**0.5 / DEGREE * 3600:.2f}: the table "
                    "does not repeat, or mirror or tracker moved"
                )
    return entries, warnings


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
        "show different mirror planes and nothing tells which is right: reflector on the "
        "wrong nest, nest or mirror moved in between; measure this position again"
    )
