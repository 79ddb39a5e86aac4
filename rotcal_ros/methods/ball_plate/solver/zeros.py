"""What the curves of a plate count from, and what nothing joins between groups of positions.

A group sees each of its six curves up to a constant, which the CMM takes back at the CMM positions
that it alone uses; and EXC, EYC and EAC, EBC up to what turns with the table, which a shifted or
tilted plate takes back (the 19 invisible directions of the paper hold both, for one group).
Groups share no CMM position, so none of the constants is joined. They share the plate, but each is
solved for itself, as in the second paper, so what turns is taken off each group too.
"""

from __future__ import annotations

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COMPONENTS, ROTATIONS
from rotcal_ros.foundation.results import FreeDirection
from rotcal_ros.methods.ball_plate.solver.problem import grid_step
from rotcal_ros.methods.ball_plate.solver.solution import PlateSolution

PAIRS = (("EXC", "EYC"), ("EAC", "EBC"))


def groups_in_words(count: int) -> str:
    """Return what the groups are called in messages."""
    names = f"{count} groups of" if count > 2 else "odd and even"
    return f"the {names} table positions"


def zeros_of(solution: PlateSolution) -> tuple[str, tuple[FreeDirection, ...]]:
    """Return what the deviations count from, and the free directions between the groups.

    A stated allowance bounds these: the covariance holds it, and none is free.
    """
    if len(solution.groups) == 1:
        return "mean", ()
    problem = solution.problem
    bounded = problem.group_allowance > 0.0
    return "mean of each group", () if bounded else directions(solution)


def directions(solution: PlateSolution) -> tuple[FreeDirection, ...]:
    """Return the offsets of all groups but the first against it, and what turns with each."""
    angles = solution.problem.angles[solution.table_positions]
    name = groups_in_words(len(solution.groups))
    found = []
    for own in _members(solution)[1:]:
        found += [FreeDirection(name, {c: own}) for c in COMPONENTS]
        for x, y in PAIRS:
            cos, sin = own * np.cos(angles), own * np.sin(angles)
            found += [FreeDirection(name, {x: cos, y: sin})]
            found += [FreeDirection(name, {x: -sin, y: cos})]
    return tuple(found)


def allowed(solution: PlateSolution, component: str) -> Floats:
    """Return what a stated allowance does to a component, (M, r) independent errors.

    None within a group.

    Between any two groups constant and turning part differ by no more than the allowance, m on the
    circle of the balls, alike for all values in between.
    """
    problem = solution.problem
    count = len(solution.table_positions)
    if len(solution.groups) == 1 or not problem.group_allowance:
        return np.zeros((count, 0))
    size = problem.group_allowance / (problem.radius if component in ROTATIONS else 1.0)
    # what all groups have in common is nobody's zero
    columns = [own - np.mean(own) for own in _members(solution)]
    if any(component in pair for pair in PAIRS):
        angles = problem.angles[solution.table_positions]
        columns += [own * turn(angles) for own in columns[:] for turn in (np.cos, np.sin)]
    # two independent zeros differ by twice the variance of either
    return np.asarray(size / np.sqrt(6.0) * np.column_stack(columns), dtype=np.float64)


def _members(solution: PlateSolution) -> list[Floats]:
    """Return 1 for the solved positions (M,) of each group and 0 for the others."""
    step = grid_step(solution.table_positions, solution.problem.grid)
    count = len(solution.groups)
    return [(step % count == first).astype(np.float64) for first in range(count)]
