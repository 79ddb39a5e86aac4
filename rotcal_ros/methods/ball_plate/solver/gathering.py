"""Disturbances that gather in one place: at a table position, a ball, a CMM position.

What lasts for a while shows as a run of rows at one position of the table or of the CMM: in every
order of measurement one of the two rests while the other moves.

The engine in :mod:`rotcal_ros.adjust` judges; here are the groups of a plate's centres and what
the model says of them. Residual cofactors of all groups and the map to the six deviations follow
from the layout alone and are remembered. What gathers is asked only where a group shows anything:
to ask of all takes many times as long.

Shapes: n rows, e of them in a group, q subsets of it, o outputs, M table positions in use.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final

import numpy as np

from rotcal_ros.adjust import gathering as engine
from rotcal_ros.adjust.distributions import chi2_isf
from rotcal_ros.adjust.gathering import Count, Gathering, GatheringLimits, Words
from rotcal_ros.adjust.groups import Group, GroupTest
from rotcal_ros.adjust.judgement import Belief, judge
from rotcal_ros.adjust.reliability import Hidden, hidden
from rotcal_ros.adjust.sensitivity import Sensitivity
from rotcal_ros.adjust.subsets import distinct, runs
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.protection import POWER
from rotcal_ros.methods.ball_plate.solver import general_least_squares, model
from rotcal_ros.methods.ball_plate.solver.estimate import drift_columns
from rotcal_ros.methods.ball_plate.solver.model import Solution
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, RowLayout, places_of

SIGNIFICANCE: Final = 0.01
"""Probability below which chance may cost good centres of one place."""
LIMITS: Final = GatheringLimits(rejected_share=3e-4, significance=0.002, suspected=0.003)
"""Single outliers are rare: two of eight are no chance. One of 100 sound plates reaches
``suspected``, for in some of so many groups subsets are searched; motion has its own test."""
BELIEF: Final = Belief(disturbed=0.8)
"""Disturbances are held to be likely: what can be neither proved nor excluded widens U."""
WORDS: Final = Words("centres", "dirt, a touched plate or warm air", "there", "there")
LEAST_OF_GROUP: Final = 4
"""Centres of which it is asked what gathers among them."""
MOST_UNKNOWNS: Final = 1200
"""Unknowns up to which groups are judged: the work grows with their third power."""
RUNS: Final = (2, 3, 4, 5, 6, 8, 12)
"""How many neighbours are tried together, along a ball's turn or in time."""
SHOWS: Final = 14.0
"""Chi-squared of a common shift from which on a group is judged: less cannot be probable."""
SUSPICIOUS: Final = 0.01
"""Probability of a group's residuals below which it is judged."""
MANY: Final = 8
"""Groups of a kind from which on their typical scatter is known."""
SHARED: Final = 1.25
"""Ratio of the typical group's squares to chance from which on all groups of a kind scatter."""
LARGEST: Final = 1e-3
"""Displacement, m, that the screening finds anyway."""


@dataclass(frozen=True, eq=False)
class GatheringView:
    """All groups of a layout without residuals, and what the model says of their rows.

    ``shifts``, of each: the covariances (q, 3, 3) of the common shifts of its gathered subsets.
    ``response`` (6 N, n, 3): errors of the deviations per unit of a row; zero at table positions
    without a centre.
    """

    groups: tuple[Group, ...]
    shifts: tuple[Floats, ...]
    response: Floats


@dataclass(frozen=True, eq=False)
class Taken:
    """All rows ``whole`` that were to be fitted, as people count them, and which are ``gone``.

    ``gone`` (k,): numbers of the rows that were rejected.
    """

    whole: BallPlateProblem
    gone: Ints

    def counted(self, problem: BallPlateProblem) -> dict[str, tuple[Ints, Ints]]:
        """Return by kind the numbers (n,) that people call the groups of the rows of ``problem``.

        And how many rows of the group of each number were rejected.
        """
        at = places_of(problem.rows, self.whole.rows)
        gone = np.isin(self.whole.rows, self.gone)
        return {
            kind: (column[at], np.bincount(column[gone], minlength=column.max() + 1))
            for kind, column in _columns(self.whole).items()
        }


def gathered(
    before: Gathering,
    problem: BallPlateProblem,
    solution: Solution,
    sigma: float | None,
    redundancy: Floats,
    taken: Taken,
) -> Gathering:
    """Return ``before`` with what is known to gather in one place of a fitted problem.

    The noise in the residuals counts, axis by axis, where it is larger than ``sigma``, the stated
    one of unit weight, m (or 1), or where nothing was stated. ``redundancy`` (n,) of the rows. Of
    large problems only what was rejected of each group is counted.
    """
    if not _can_judge(problem):
        return _counted(before, problem, redundancy, taken)
    view = view_of(problem)
    whitened, unit, rest, scale = _whitened(problem, solution, sigma)
    called = taken.counted(problem)
    groups = list[Group]()
    for empty in view.groups:
        numbers, lost = called[empty.kind]
        number = numbers[empty.members[0]]
        groups.append(
            replace(
                empty,
                name=f"{empty.kind} {number}",
                residual=whitened[empty.members],
                unit=unit[empty.members],
                lost=int(lost[number]),
            )
        )
    common = _common(groups)
    asked = {
        k: group
        for k, group in enumerate(groups)
        if group.size >= LEAST_OF_GROUP and group.kind not in common
    }
    shown = [group for k, group in asked.items() if _shows(group, view.shifts[k])]
    first = judge(shown, BELIEF, rest, SUSPICIOUS, among=len(groups))
    weighed = list[Group]()
    if first.possible:  # seldom on sound plates: of all groups it costs more
        weighed = [_felt(group, view.response * scale) for group in asked.values()]
    return engine.judged(before, groups, rest, weighed, BELIEF, common)


def _can_judge(problem: BallPlateProblem) -> bool:
    """Return whether a problem is small enough to be judged place by place."""
    return model.n_unknowns(problem) <= MOST_UNKNOWNS


def _felt(group: Group, response: Floats) -> Group:
    """Return ``group`` with what outputs feel of its rows; ``response`` (o, n, 3)."""
    mine = response[:, group.members].reshape(len(response), -1)
    return replace(group, felt=lambda: Sensitivity.whole(mine))


def _counted(
    before: Gathering, problem: BallPlateProblem, redundancy: Floats, taken: Taken
) -> Gathering:
    """Count what was rejected of each group of a problem that is not judged."""
    found = []
    for kind, (numbers, lost) in taken.counted(problem).items():
        size, checks = np.bincount(numbers), np.bincount(numbers, redundancy)
        each = enumerate(zip(size.tolist(), lost.tolist(), checks.tolist(), strict=False))
        for name, (left, gone, checked) in each:
            if left:
                test = GroupTest(0.0, 0, 1.0, checked / left, gone / (left + gone))
                found.append(Count(kind, f"{kind} {name}", test, left + gone, gone))
    return replace(before, counts=tuple(found))


def left_out(gathering: Gathering) -> tuple[Gathering, dict[int, str]] | None:
    """Return what is proved to be wrong together, and why by its rows; None: nothing is."""
    case = gathering.proved(SIGNIFICANCE, BELIEF)
    if case is None:
        return None
    rows = case.group.members[case.subset]
    why = (
        f"one of {len(rows)} centres of {case.group.name} that are off together, by "
        f"{WORDS.size(case.size)} (x, y, z)"
    )
    return gathering.without(case), dict.fromkeys(rows.tolist(), why)


def suspected(gathering: Gathering) -> Ints:
    """Return the rows of the place where something may gather; none where nothing does."""
    found = gathering.judgement
    if found is None or not found.possible:
        return np.empty(0, dtype=np.int64)
    return found.groups[found.worst].members


def details(gatherings: Sequence[Gathering]) -> dict[str, Any]:
    """Return what was found in several fits for the details of a result; sizes in m."""
    each = [engine.details(gathering, WORDS.elements) for gathering in gatherings]
    return {
        "chance": min(part["chance"] for part in each),
        "groups": [row for part in each for row in part["groups"]],
        "blamed": [case for part in each for case in part["blamed"]],
    }


def unseen(problem: BallPlateProblem, noise: Floats, std: Floats) -> Hidden | None:
    """Return the worst at a table position, for its deviations, that no test sees; None: unknown.

    ``noise`` (3,) of the axes, in units of the rows' ``std``; ``std`` (6, M) of the deviations.
    """
    if not _can_judge(problem):
        return None
    view, unit = view_of(problem), 1.0 / (problem.noise_unit * noise)
    response = view.response.reshape(6, -1, *problem.centres.shape)[:, problem.table_positions]
    response = response * noise / std[:, :, None, None]
    positions = [group for group in view.groups if group.kind == "table position"]
    groups = [
        _felt(replace(group, unit=unit[group.members]), response[:, k])
        for k, group in enumerate(positions)
    ]
    return hidden(groups, np.ones(6), SIGNIFICANCE, POWER, LARGEST)


def _whitened(
    problem: BallPlateProblem, solution: Solution, sigma: float | None
) -> tuple[Floats, Floats, tuple[float, float] | None, Floats]:
    """Return whitened residuals, units (n, 3), the yardstick of the rest, and the noise (3,).

    The noise is that in the residuals where it is clearly larger than what was stated; x and y
    share one, z has its own. The yardstick, chi-squared and degrees of freedom of all residuals,
    is None where the statement holds.
    """
    own = problem.noise_unit
    residuals = solution.residuals / own
    free = _freedom(problem)
    squares = np.sum(residuals**2, axis=0)
    squares = np.array([squares[0] + squares[1], squares[2]])
    found = np.sqrt(squares / np.maximum(free, 1.0))
    found = np.maximum(found, 0.05 * found.max())  # weights beyond that have no sense
    stated = max(sigma or 0.0, float(np.sqrt(model.least_variance(problem, solution.estimate))))
    beyond = stated**2 * chi2_isf(0.01, free) / np.maximum(free, 1.0)
    known = found**2 <= beyond
    used = np.where(known, stated, found)
    scale = used[[0, 0, 1]]
    whitened = residuals / scale
    rest = None if known.all() else (float(np.sum(whitened**2)), float(free.sum()))
    return whitened, 1.0 / (own * scale), rest, scale


def _freedom(problem: BallPlateProblem) -> Floats:
    """Return the degrees of freedom of the plane and of z, (2,), for the nominal design.

    Along z: a ball and a CMM position have one unknown, the table position three (EZC, EAC, EBC),
    the axis three; nine of the 19 constraints concern these.
    """
    balls, cmm = len(problem.balls), len(problem.cmm_positions)
    turned, n = len(problem.table_positions), len(problem.centres)
    drift = problem.drift
    axial = n - balls - cmm - 3 * turned - 3 + 9 - drift
    total = model.degrees_of_freedom(problem) - 3 * drift
    return np.array([total - axial, axial], dtype=np.float64)


def _common(groups: list[Group]) -> list[str]:
    """Return the kinds of which the typical group scatters, as by the table's repeatability."""
    found = []
    for kind in dict.fromkeys(group.kind for group in groups):
        both = np.array([group.together for group in groups if group.kind == kind])
        # chi-squared over its median: 1 for a typical group of sound data
        typical = np.median(both[:, 0] / chi2_isf(0.5, np.maximum(both[:, 1], 1.0)))
        if len(both) > MANY and typical > SHARED:
            found.append(kind)
    return found


def _shows(group: Group, shifts: Floats) -> bool:
    """Whether a group or a common shift of one of its gathered subsets stands out.

    ``shifts`` (q, 3, 3): the covariances of the latter.
    """
    squares, rank = group.together
    if squares > chi2_isf(SUSPICIOUS, max(rank, 1)):
        return True
    right = group.gathered @ group.residual
    shift = np.einsum("qa,qab,qb->q", right, shifts, right)  # chi-squared of each
    return float(shift.max(initial=0.0)) > SHOWS


def view_of(problem: BallPlateProblem) -> GatheringView:
    """Return the groups of a problem; those of a layout are remembered."""
    std = problem.std
    if std is not None and problem.weighed_alike and std[0, 0] == std[0, 1]:
        std = None  # the plane and z do not meet: whitened, all is as without
    view = _of_layout(RowLayout.of(replace(problem, std=std)))
    if std is problem.std:
        return view
    return replace(view, response=view.response * problem.noise_unit[0])


@lru_cache(maxsize=4)
def _of_layout(layout: RowLayout) -> GatheringView:
    """Return the groups of a layout with their residual cofactors, by one dense elimination.

    With A the whitened design and C the covariance of the unknowns the cofactor is 1 - A C A'; the
    columns of a drift take their part of it as further unknowns.
    """
    problem = layout.problem
    view = general_least_squares.linear_view(problem)
    n = len(problem.centres)
    design, std = view.design.toarray(), view.std
    half = design @ view.covariance
    response = view.table @ design.T
    border = drift_columns(problem.run_time, problem.drift).reshape(3 * n, -1) / std[:, None]
    left = border - half @ (design.T @ border)
    inverse = np.linalg.inv(border.T @ left) if problem.drift else np.zeros((0, 0))
    response = response - (response @ border) @ inverse @ left.T

    def cofactor(rows: Ints) -> Floats:
        at = (3 * rows[:, None] + np.arange(3)).ravel()
        kept = np.eye(len(at)) - half[at] @ design[at].T - left[at] @ inverse @ left[at].T
        shape = (len(rows), 3, len(rows), 3)
        return np.asarray(0.5 * (kept + kept.T)).reshape(shape)

    groups, shifts = [], []
    for kind, column in _columns(problem).items():
        for k in np.unique(column).tolist():
            rows = np.flatnonzero(column == k)
            subsets, kept = _subsets(problem, kind, rows), cofactor(rows)
            groups.append(_without_residuals(kind, k, rows, kept, subsets))
            shifts.append(_of_shifts(subsets.astype(np.float64), kept))
    everywhere = np.zeros((6, problem.n_positions, n, 3))
    everywhere[:, problem.table_positions] = response.reshape(6, -1, n, 3)
    return GatheringView(tuple(groups), tuple(shifts), everywhere.reshape(-1, n, 3))


def _without_residuals(
    kind: str, number: int, rows: Ints, cofactor: Floats, subsets: Bools
) -> Group:
    """Return one group as the layout has it, its eigenvalues remembered."""
    e = len(rows)
    values, vectors = np.linalg.eigh(cofactor.reshape(3 * e, -1))
    return Group(
        kind=kind,
        name=f"{kind} {number}",
        members=rows,
        residual=np.zeros((e, 3)),
        cofactor=cofactor,
        felt=lambda: Sensitivity.whole(np.zeros((1, 3 * e))),
        unit=np.ones((e, 3)),
        gathered=subsets,
        eigen=(np.clip(values, 0.0, 1.0), vectors),  # a projector's, but for rounding
    )


def _of_shifts(subsets: Floats, cofactor: Floats) -> Floats:
    """Return the covariances (q, 3, 3) of the common shifts of ``subsets`` (q, e)."""
    both = np.tensordot(subsets, cofactor, 1)
    square = np.einsum("qaeb,qe->qab", both, subsets)
    return np.linalg.pinv(square, rcond=1e-6, hermitian=True) if len(square) else square


def _columns(problem: BallPlateProblem) -> dict[str, Ints]:
    """Return the group of each row (n,) by kind."""
    return {
        "table position": problem.position,
        "ball step": problem.ball_step,
        "CMM position": problem.cmm_index,
    }


def _subsets(problem: BallPlateProblem, kind: str, rows: Ints) -> Bools:
    """Return what may be wrong together: neighbours on the plate, in the turn, in time."""
    along = problem.position[rows] if kind == "ball step" else problem.ball_step[rows]
    found = runs(along.astype(np.float64), closed=True)
    if kind != "ball step":
        found = distinct(found, runs(problem.rows[rows].astype(np.float64)))
    return np.asarray(found[np.isin(found.sum(axis=1), RUNS)])
