"""Several groups of table positions, each with its own zero (second paper, optimised method).

A plate whose balls share the factor 2 with the grid sees the even and the odd table positions
separately: half the work of the complete grid, but condition (22) fails. Every group is a three
rosette measurement of its own; the offset between the groups is not measured.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rotcal_ros.arrays import Floats, Ints
from rotcal_ros.errors import ObservabilityError
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.ball_plate import model
from rotcal_ros.methods.ball_plate.model import Solution
from rotcal_ros.methods.ball_plate.problem import BallPlateProblem
from rotcal_ros.methods.ball_plate.separability import common_divisor


@dataclass(frozen=True)
class Group:
    """One group: the table positions (M,) of the whole grid, and the problem of the group.

    The problem lives on the group's own grid, in a frame turned by ``turn`` radians about z.
    """

    positions: Ints
    turn: float
    problem: BallPlateProblem


def split(problem: BallPlateProblem) -> tuple[Group, ...]:
    """Cut a problem into its groups of table positions.

    The number of groups is the common divisor of the ball steps and the grid (Eq. 22), 2 in the
    paper, 1 for a plate that connects all positions. Raises ObservabilityError when a group was
    not measured at all.
    """
    count = common_divisor(problem.grid, problem.balls)
    return tuple(_group(problem, first, count) for first in range(count))


def offset_warning(count: int) -> str:
    """Return the sentence that belongs beside every grouped result."""
    names = "odd and even table positions" if count == 2 else f"{count} groups of table positions"
    return f"The offset between the {names} is not measured: each group has its own zero."


def _group(problem: BallPlateProblem, first: int, count: int) -> Group:
    """Cut out the table positions first, first + count, ... and turn them to start at zero."""
    rows = np.flatnonzero(problem.position % count == first)
    if not len(rows):
        raise ObservabilityError(
            f"no centre was measured at the table positions {first}, {first + count}, ...: "
            "one group is missing altogether"
        )
    part = problem.take(rows)
    start = int(problem.balls[0] % count)  # ball steps are start + multiples of count
    turn = float(problem.angles[(first + start) % problem.grid])
    back = rotation_about_z(-turn)
    std = part.std
    if std is not None:  # x and y are mixed by the turn
        plane = np.sqrt(np.mean(std[:, :2] ** 2, axis=1))
        std = np.column_stack([plane, plane, std[:, 2]])
    group_problem = replace(
        part,
        grid=problem.grid // count,
        position=(part.position - first) // count,
        ball_step=(part.ball_step - start) // count,
        centres=part.centres @ back.T,
        std=std,
        separate_groups=False,
    )
    return Group(np.arange(first, problem.grid, count), turn, group_problem)


def turned_back(group: Group, vectors: Floats) -> Floats:
    """Bring vectors (n, 3) of the group's frame back to the frame of the whole."""
    back: Floats = vectors @ rotation_about_z(group.turn).T
    return back


def turned_covariance(group: Group, solution: Solution, name: str) -> Floats:
    """Return the (M, M) unit covariance of one component in the frame of the whole."""
    field, axis = model.TABLE_COMPONENTS[name]
    if group.turn == 0.0:
        return solution.unit_covariance(name, name)
    weights = rotation_about_z(group.turn)[axis]
    names = [n for n, (f, _) in model.TABLE_COMPONENTS.items() if f == field]
    total = np.zeros((len(group.positions),) * 2)
    for first, weight in zip(names, weights, strict=True):
        for second, other in zip(names, weights, strict=True):
            if weight and other:
                total += weight * other * solution.unit_covariance(first, second)
    return total
