"""What gathers in one place: pairs of points and nests as groups for the engine.

Warm air, a person in the beams, a smear on the glass spoil several readings at once: of one table
position, of one place of the tracker, of one reflector or nest, for a while. Groups are the
positions and the tracker stations (what is seen in the mirror and the nests apart, for they are
other kinds), of which the engine (:mod:`rotcal_ros.adjust`) says what gathers in them, runs in
time among it; and the reflectors and the nests, whose chi-squared and rejected share are judged
by the same rules. Pairs that are proved to be wrong together are left out; what is only probable
joins the covariance.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from rotcal_ros.adjust import gathering as engine
from rotcal_ros.adjust.distributions import chi2_isf
from rotcal_ros.adjust.gathering import SUSPECTED, Gathering
from rotcal_ros.adjust.groups import Group
from rotcal_ros.adjust.judgement import Belief
from rotcal_ros.adjust.reliability import hidden
from rotcal_ros.adjust.sensitivity import Sensitivity
from rotcal_ros.adjust.subsets import distinct, neighbourhoods, runs
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import DataError, RotcalError
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.protection import POWER, Protection
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.methods.plane_mirror.settings import DIRECT
from rotcal_ros.methods.plane_mirror.solver.linear import Elements, Linear, linear
from rotcal_ros.methods.plane_mirror.solver.prepare import ScreenedPoints, prepare
from rotcal_ros.methods.plane_mirror.solver.problem import WORDS, PlaneMirrorProblem
from rotcal_ros.methods.plane_mirror.solver.ways import (
    PreparedNormals,
    PreparedPoints,
    PreparedWay,
)

LEAST_OF_GROUP: Final = 2
"""Readings that are a group: of two that disagree, either may be wrong."""
TURNING: Final = ("position", "station")
"""Kinds of groups of which sideways shifts are asked for by themselves."""
FEW: Final = 6
"""Reflectors of which all subsets are tried; more are tried in the order of their numbers."""
BELIEF: Final = Belief(disturbed=0.8)
"""Disturbances are held to be likely: what can be neither proved nor excluded widens U."""
USUAL_SHARE: Final = 0.03
"""Share of single outliers that is nothing unusual."""
MOST_UNKNOWNS: Final = 1500
"""Unknowns, about, up to which groups are judged: the work grows with their third power."""
MINORITY: Final = 0.4
"""Share of the pairs of a normal that the others outvote, whatever noise explains."""
MOST_TIMES: Final = 6
"""Subsets that are left out one after the other; of more, the data are beyond help."""
LARGEST: Final = 1e-3
"""Error (m) of several readings that could not be overlooked."""


class Settled(NamedTuple):
    """A problem without what is proved to be wrong, what gathers in it, and its linear view.

    ``points`` is None for reflectors on the table, and where too many unknowns were not judged.
    """

    screened: ScreenedPoints
    gathering: Gathering
    points: Linear | None


def settled(problem: PlaneMirrorProblem) -> Settled:
    """Return the problem without what is proved to be wrong, and what was found to gather.

    Groups are judged before single pairs: the pair that fits its group least is often a good one
    there. Raises DataError or GeometryError as :func:`~.prepare.prepare`.
    """
    try:
        screened = prepare(problem)
    except DataError:
        together = _together(problem)
        if together is None or _largest_share(together) > MINORITY:
            raise
        return together
    alone = None if screened.lost else _judged(screened, Gathering())
    if alone is not None and _left_out(screened, alone.gathering) is None:
        return alone
    return _together(problem) or alone or _judged(screened, Gathering())


def _together(problem: PlaneMirrorProblem) -> Settled | None:
    """Return the problem as groups are judged first; None where that proves or solves nothing."""
    gathering, left = Gathering(), dict[int, str]()
    try:
        screened = prepare(problem, singly=False)
        for _ in range(MOST_TIMES):
            gathering = _judged(screened, gathering).gathering
            found = _left_out(screened, gathering)
            if found is None:
                break
            gathering, why = found
            left |= why
            screened = prepare(problem, left, singly=False)
        screened = prepare(problem, left)
    except RotcalError:
        return None
    return _judged(screened, gathering) if gathering.blamed else None


def _largest_share(together: Settled) -> float:
    """Return the largest share of the pairs of one normal that were left out."""
    prepared, lost = together.screened.prepared, np.array(together.screened.lost)
    problem, share = prepared.problem, 0.0
    for row in lost.tolist():
        own = problem.kind == PointKind.MIRRORED
        own &= problem.position == problem.position[row]
        own &= problem.station == problem.station[row]
        share = max(share, float(own[lost].sum() / own.sum()))
    return share


def _judged(screened: ScreenedPoints, before: Gathering) -> Settled:
    """Return ``before`` with what the groups of a screened problem say."""
    prepared = screened.prepared
    if 3 * len(prepared.angles) + prepared.drift.size > MOST_UNKNOWNS:
        return Settled(screened, before, None)
    points = linear(prepared, prepared.deviations(prepared.problem.xyz))
    groups = groups_of(points, prepared.problem, screened.lost)
    # Where the stated noise does not explain the residuals, groups are judged by each other.
    unexplained = points.chi_square > chi2_isf(prepared.problem.significance, max(points.dof, 1))
    rest = (points.chi_square, float(points.dof)) if unexplained else None
    weighed = [group for group in groups if group.kind in TURNING]
    found = engine.judged(before, groups, rest, weighed, BELIEF)
    return Settled(screened, found, points if isinstance(prepared, PreparedNormals) else None)


def _left_out(
    screened: ScreenedPoints, gathering: Gathering
) -> tuple[Gathering, dict[int, str]] | None:
    """Return what is proved to be wrong together, and why by row of both points of a pair.

    None where nothing is proved, where it is nests, and where a position would lose all its pairs.
    """
    prepared = screened.prepared
    if not isinstance(prepared, PreparedNormals):
        return None
    case = gathering.proved(prepared.problem.significance, BELIEF)
    if case is None:
        return None
    pairs, members = prepared.pairs, case.group.members[case.subset]
    if members.max() >= len(pairs.direct):
        return None  # nests: the solution needs them all
    kept = np.isin(np.arange(len(pairs.direct)), members, invert=True)
    if len(np.unique(pairs.group[kept])) < pairs.n_groups:
        return None
    why = (
        f"one of {len(members)} readings of {case.group.name} that are off together, by "
        f"{WORDS.size(case.size)} (along the beam, level across it, upwards)"
    )
    rows = np.concatenate([pairs.direct[members], pairs.mirrored[members]])
    return gathering.without(case), dict.fromkeys(rows.tolist(), why)


def groups_of(points: Linear, problem: PlaneMirrorProblem, lost: tuple[int, ...]) -> list[Group]:
    """Return the groups of all that was measured; outputs are the deviations (N,), rad.

    ``lost``: rows of the mirrored points that were left out before.
    """
    elements, found, seen = points.elements, list[Group](), set[bytes]()
    n = len(points.outputs)
    for kind, name, here, gone in _places(elements, problem, lost):
        if len(here) < LEAST_OF_GROUP or here.tobytes() in seen:
            continue
        seen.add(here.tobytes())
        whole = points.view.group(
            kind,
            name,
            here,
            points.design[here],
            points.residual[here],
            points.unit[here],
            _gathered(elements, here),
            gone,
        )
        if points.sensitivity is not None:
            whole = replace(
                whole, sensitivity=Sensitivity.whole(points.sensitivity[:, here].reshape(n, -1))
            )
        found.append(whole)
        if kind in TURNING:
            found.append(_sideways(whole))
    return found


def _sideways(group: Group) -> Group:
    """Return the ``group`` with the axis alone that turns the mirror: level across the beam.

    A shift along one axis stands out from chance sooner than one along any of three.
    """
    level = slice(1, 2)
    return replace(
        group,
        name=f"{group.name}, sideways",
        residual=group.residual[:, level],
        cofactor=group.cofactor[:, level, :, level],
        sensitivity=Sensitivity.whole(group.response[:, :, 1]),
        unit=group.unit[:, level],
    )


def _places(
    elements: Elements, problem: PlaneMirrorProblem, lost: tuple[int, ...]
) -> Iterator[tuple[str, str, Ints, int]]:
    """Yield kind, name, elements and how many were lost, of each group."""
    what = "on the table" if problem.way == DIRECT else "in the mirror"
    pair, rows = np.arange(len(elements.row)) < elements.pairs, np.array(lost, dtype=np.int64)

    def gone(values: Ints, number: int) -> int:
        """Return how many of the lost pairs have this number among the ``values`` of all rows."""
        return int((values[rows] == number).sum())

    for position in np.unique(problem.position[elements.row[pair]]).tolist():
        here = pair & (problem.position[elements.row] == position)
        name = problem.position_name(position)
        yield "position", name, np.flatnonzero(here), gone(problem.position, position)
    for station in np.unique(elements.station).tolist():
        here = elements.station == station
        name = f"tracker station {problem.station_name(station)}"
        lost_here = gone(problem.station, station)
        yield "station", f"{name}, {what}", np.flatnonzero(here & pair), lost_here
        yield "station", f"{name}, its nests", np.flatnonzero(here & ~pair), 0
    for number in np.unique(elements.nest[pair]).tolist():
        here = pair & (elements.nest == number)
        yield "reflector", f"reflector {number}", np.flatnonzero(here), gone(problem.nest, number)
    for number in np.unique(elements.nest[~pair]).tolist():
        yield "nest", f"nest {number}", np.flatnonzero(~pair & (elements.nest == number)), 0


def _gathered(elements: Elements, here: Ints) -> Bools:
    """Return which of the elements ``here`` lie together: in time, in direction, by their nest."""
    found = [runs(elements.moment[here])]
    station, nest = elements.station[here], elements.nest[here]
    names, which = np.unique(nest, return_inverse=True)
    if 1 < len(names) < len(here):
        found.append(_of_names(len(names))[:, which])
    elif len(here) <= FEW:
        found.append(_of_names(len(here)))
    if len(here) >= 4:
        apart = 10.0 * station[:, None]  # directions of one station have nothing to do with others
        found.append(neighbourhoods(np.concatenate([elements.beam[here], apart], axis=1)))
    part = distinct(*found)
    count = part.sum(axis=1)
    return np.asarray(part[(count > 1) & (2 * count <= len(here))])


def _of_names(count: int) -> Bools:
    """Return subsets (q, count) of so many reflectors or nests, single ones too."""
    if count > FEW:
        alone = np.eye(count, dtype=np.bool_)
        return distinct(runs(np.arange(count, dtype=np.float64), closed=True), alone)
    # All subsets but the empty one, as the bits of numbers; those of more than half are left out.
    every = (np.arange(1, 2**count)[:, None] >> np.arange(count)) % 2 == 1
    return np.asarray(every[every.sum(axis=1) <= count // 2])


def protection(gathering: Gathering, prepared: PreparedWay, std: Floats) -> tuple[Protection, ...]:
    """Return the statement about readings in one place that are wrong together.

    Of each position some stay right: what spoils all readings of a position is as if the table
    had arrived elsewhere. ``std`` (N,): standard uncertainties of the deviations, rad.
    """
    if gathering.judgement is None:
        return ()
    what = "some readings of one position or tracker station that are wrong together"
    groups = [
        replace(group, gathered=part)
        for group in gathering.judgement.groups
        if group.members.max() < len(_angle_of(prepared))
        and len(part := _minorities(group, prepared))
    ]
    worst = hidden(groups, std, SUSPECTED, POWER, LARGEST)
    if worst is None:
        why = "one reflector at a position: there is no check that it is seen in the right place"
        return (Protection("one place", "not protected", why),)
    arrived = (
        "; what spoils all readings of a position is as if the table had arrived elsewhere: see "
        "repeatability"
    )
    size = f"{worst.size / MICROMETRE:.2g} um"
    return (engine.protection(worst, what, size, beside=arrived),)


def _minorities(group: Group, prepared: PreparedWay) -> Bools:
    """Return the subsets, single ones too, that leave half of what gives each angle alone."""
    part = np.concatenate([group.gathered, np.eye(group.size, dtype=np.bool_)])
    angle = _angle_of(prepared)
    own, at = np.unique(angle[group.members], return_inverse=True)
    whole = np.bincount(angle)[own]
    each = part.astype(np.float64) @ (at[:, None] == np.arange(len(whole)))
    return np.asarray(part[(2 * each <= whole).all(axis=1)])


def _angle_of(prepared: PreparedWay) -> Ints:
    """Return the normal (P,) that each pair determines, or the position that a reflector does."""
    if isinstance(prepared, PreparedPoints):
        return prepared.reflectors.position
    return prepared.pairs.group
