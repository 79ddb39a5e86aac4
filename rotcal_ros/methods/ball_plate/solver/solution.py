"""From a problem to the solved curves: groups of table positions, noise, and what is open.

A plate whose balls share the factor 2 with the grid sees the even and the odd table positions
separately (second paper, optimised method): half the work of the complete grid, but condition (22)
fails. Every group is a three-rosette measurement of its own, solved for itself on its own grid.

Nothing joins the groups. Each sees its six curves up to a constant, which the CMM takes back at
the CMM positions that it alone uses; and EXC, EYC and EAC, EBC up to what turns with the table,
which a shifted or tilted plate takes back (the 19 invisible directions of the paper hold both, for
one group). Groups share the plate, but as each is solved for itself, what turns is taken off each.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.components import COMPONENTS, ROTATIONS
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.foundation.results import FreeDirection, Rejection
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.ball_plate.solver import general_least_squares, model
from rotcal_ros.methods.ball_plate.solver.model import Solution
from rotcal_ros.methods.ball_plate.solver.noise import AXIS_SIGNIFICANCE, CentreNoise, assess
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, grid_step, position_of
from rotcal_ros.methods.ball_plate.solver.rejection import Fitted, fit_and_reject
from rotcal_ros.methods.ball_plate.solver.repeated_stops import closing_apart
from rotcal_ros.methods.ball_plate.solver.screening import screen
from rotcal_ros.methods.ball_plate.solver.separability import common_divisor

PAIRS = (("EXC", "EYC"), ("EAC", "EBC"))
"""Components that a plate shifted or tilted on the table takes back together."""


@dataclass(frozen=True)
class PositionGroup:
    """One group: the table positions (M,) of the whole grid, and the problem of the group.

    The problem lives on the group's own grid, in a frame turned by ``turn`` radians about z; on
    the table, at the group's position 0, its frame is turned by ``on_table`` radians.
    ``closing`` are rows measured again at the end, which the fit does without.
    """

    positions: Ints
    turn: float
    on_table: float
    problem: BallPlateProblem
    closing: BallPlateProblem | None = None


class SolvedGroup(NamedTuple):
    """A group with its fit."""

    group: PositionGroup
    fit: Fitted

    @property
    def positions(self) -> Ints:
        """The table positions of the whole grid that could be solved."""
        return self.group.positions[self.fit.problem.table_positions]


@dataclass(frozen=True)
class PlateSolution:
    """A solved problem: ``whole`` are the rows that were fitted at all, ``parts`` its groups.

    ``rejected`` are the other rows and those that did not fit, in the order of the row numbers.
    """

    problem: BallPlateProblem
    whole: BallPlateProblem
    parts: tuple[SolvedGroup, ...]
    noise: CentreNoise
    rejected: tuple[Rejection, ...]

    @cached_property
    def table_positions(self) -> Ints:
        """The table positions that could be solved, ascending, (M,); the others were left out."""
        return np.sort(np.concatenate([part.positions for part in self.parts]))

    def places(self) -> list[Ints]:
        """Return where the solved positions of each group stand among all that were solved."""
        return [np.searchsorted(self.table_positions, part.positions) for part in self.parts]

    def members(self) -> list[Floats]:
        """Return 1 for the solved positions (M,) of each group and 0 for the others."""
        step = grid_step(self.table_positions, self.problem.grid)
        count = len(self.parts)
        return [(step % count == first).astype(np.float64) for first in range(count)]

    def deviations(self) -> dict[str, Floats]:
        """Return the table's six deviations (M,), metres and radians."""
        count = len(self.table_positions)
        fields = {name: np.empty((count, 3)) for name in ("translation", "rotation")}
        for (group, fit), place in zip(self.parts, self.places(), strict=True):
            for name, field in fields.items():
                field[place] = turned_back(group, getattr(fit.solution.estimate, name))
        return {n: fields[f][:, axis].copy() for n, (f, axis) in model.TABLE_COMPONENTS.items()}

    def std(self) -> dict[str, Floats]:
        """Return the standard deviations (M,) of the six deviations."""
        if len(self.parts) == 1:
            std = model.scaled(self.parts[0].fit.solution.unit_std, self.noise.scale)
            return {name: std.component(name) for name in COMPONENTS}
        return {name: np.sqrt(np.diag(self.covariance(name))) for name in COMPONENTS}

    def covariance(self, name: str) -> Floats:
        """Return the (M, M) covariance of a component; zero between groups."""
        covariance = np.zeros((len(self.table_positions),) * 2)
        for (group, fit), place in zip(self.parts, self.places(), strict=True):
            covariance[np.ix_(place, place)] = _turned_covariance(group, fit.solution, name)
        scale = model.of_component(self.noise.scale, name)
        return np.asarray(scale * scale * covariance)


def adjust(problem: BallPlateProblem) -> PlateSolution:
    """Return the solution of ``problem``; raises what :func:`~.result.solve` raises.

    Where one axis proves noisier than another, all is done again with the weights found; not after
    a knock, or with a plate that has grown, whose residuals are no noise.
    """
    once, closing = closing_apart(problem)
    whole, unusable = screen(once)
    stated = problem.sigma if problem.std is None else 1.0
    parts = _fitted(whole, closing)
    noise = assess(_turned(parts), stated)
    if noise.unequal and all(p.fit.knock is None and not p.fit.grown for p in parts):
        weights = _weights(whole, len(parts), noise)
        std = whole.noise_unit * weights
        parts = _fitted(replace(whole, sigma=None, std=std), closing)
        noise = assess(_turned(parts), stated, first=noise, weights=weights)
    rejected = unusable + [r for part in parts for r in part.fit.rejected]
    in_order = tuple(sorted(rejected, key=lambda r: r.index))
    return PlateSolution(problem, whole, parts, noise, in_order)


def _fitted(whole: BallPlateProblem, closing: BallPlateProblem | None) -> tuple[SolvedGroup, ...]:
    """Cut a problem into its groups, if it has any, and fit each."""
    alone = PositionGroup(np.arange(whole.n_positions), 0.0, 0.0, whole, closing)
    groups = split(whole, closing) if whole.separate_groups else (alone,)
    named = (whole.take(np.isin(whole.rows, group.problem.rows)) for group in groups)
    return tuple(
        SolvedGroup(group, fit_and_reject(group.problem, rows))
        for group, rows in zip(groups, named, strict=True)
    )


def _turned(parts: tuple[SolvedGroup, ...]) -> list[tuple[Fitted, float]]:
    """Return the fits with the angles (rad) that their frames are turned by."""
    return [(fit, group.turn) for group, fit in parts]


def _weights(whole: BallPlateProblem, n_groups: int, noise: CentreNoise) -> Floats:
    """Return the standard deviations (3,) to weigh with.

    x and y count as one where nothing speaks against it; also for groups, whose frames are turned,
    and where the elimination would not fit into memory: then the larger one is stated.
    """
    weights: Floats = noise.estimated.copy()
    large = model.n_unknowns(whole) > general_least_squares.MAX_UNKNOWNS
    if noise.plane >= AXIS_SIGNIFICANCE or n_groups > 1 or large:
        weights[:2] = np.hypot(weights[0], weights[1]) / np.sqrt(2.0)
    return weights


def split(
    problem: BallPlateProblem, closing: BallPlateProblem | None = None
) -> tuple[PositionGroup, ...]:
    """Cut a problem into its groups of table positions.

    The number of groups is the common divisor of the ball steps and the grid (Eq. 22), 2 in the
    paper, 1 for a plate that connects all positions. Raises ObservabilityError when a group was
    not measured at all.
    """
    count = common_divisor(problem.grid, problem.balls)
    groups = [_group(problem, first, count) for first in range(count)]
    if closing is not None:
        for first in np.unique(grid_step(closing.position, closing.grid) % count).tolist():
            again = _group(closing, first, count, int(problem.balls[0] % count)).problem
            groups[first] = replace(groups[first], closing=again)
    return tuple(groups)


def _group(
    problem: BallPlateProblem, first: int, count: int, start: int | None = None
) -> PositionGroup:
    """Cut out the table positions first, first + count, ... and turn them to start at zero.

    ``start``: the first ball step of the group's plate; None: that of the problem.
    """
    step = grid_step(problem.position, problem.grid)
    rows = np.flatnonzero(step % count == first)
    if not len(rows):
        raise ObservabilityError(
            f"no centre was measured at the table positions {first}, {first + count}, ...: "
            "one group is missing altogether; measure it"
        )
    part = problem.take(rows)
    if start is None:
        start = int(problem.balls[0] % count)  # ball steps are start + multiples of count
    # the group's position 0 with its ball step 0 lies on its +x axis
    turn = float(problem.angles[(first + start) % problem.grid])
    back = rotation_about_z(-turn)
    std = part.std
    if std is not None:  # x and y are mixed by the turn
        plane = np.sqrt(np.mean(std[:, :2] ** 2, axis=1))
        std = np.column_stack([plane, plane, std[:, 2]])
    grid, upward = problem.grid // count, part.position < problem.grid
    group_problem = replace(
        part,
        grid=grid,
        position=position_of((step[rows] - first) // count, upward, grid),
        ball_step=(part.ball_step - start) // count,
        centres=part.centres @ back.T,
        std=std,
        separate_groups=False,
    )
    own = np.arange(group_problem.n_positions)
    positions = position_of(first + count * grid_step(own, grid), own < grid, problem.grid)
    return PositionGroup(positions, turn, float(problem.angles[start]), group_problem)


def turned_back(group: PositionGroup, vectors: Floats) -> Floats:
    """Bring vectors (n, 3) of the group's frame back to the frame of the whole."""
    back: Floats = vectors @ rotation_about_z(group.turn).T
    return back


def _turned_covariance(group: PositionGroup, solution: Solution, name: str) -> Floats:
    """Return the (M, M) unit covariance of one component in the frame of the whole."""
    field, axis = model.TABLE_COMPONENTS[name]
    if group.turn == 0.0:
        return solution.unit_covariance(name, name)
    weights = rotation_about_z(group.turn)[axis]
    names = [n for n, (f, _) in model.TABLE_COMPONENTS.items() if f == field]
    total = np.zeros((len(solution.estimate.rotation),) * 2)
    for first, weight in zip(names, weights, strict=True):
        for second, other in zip(names, weights, strict=True):
            if weight and other:
                total += weight * other * solution.unit_covariance(first, second)
    return total


def groups_in_words(count: int) -> str:
    """Return what the groups are called in messages."""
    names = f"{count} groups of" if count > 2 else "odd and even"
    return f"the {names} table positions"


def zeros_of(solution: PlateSolution) -> tuple[str, tuple[FreeDirection, ...]]:
    """Return what the deviations count from, and the free directions between the groups.

    A stated allowance bounds these: the covariance holds it, and none is free.
    """
    if len(solution.parts) == 1:
        return "mean", ()
    problem = solution.problem
    bounded = problem.group_allowance > 0.0
    return "mean of each group", () if bounded else _free_directions(solution)


def _free_directions(solution: PlateSolution) -> tuple[FreeDirection, ...]:
    """Return the offsets of all groups but the first against it, and what turns with each."""
    angles = solution.problem.angles[solution.table_positions]
    name = groups_in_words(len(solution.parts))
    found = []
    for own in solution.members()[1:]:
        found += [FreeDirection(name, {c: own}) for c in COMPONENTS]
        for x, y in PAIRS:
            cos, sin = own * np.cos(angles), own * np.sin(angles)
            found += [FreeDirection(name, {x: cos, y: sin})]
            found += [FreeDirection(name, {x: -sin, y: cos})]
    return tuple(found)


def allowed(solution: PlateSolution, component: str) -> Floats:
    """Return what a stated allowance does to a component, (M, r) independent errors.

    Between any two groups constant and turning part differ by no more than the allowance, m on the
    circle of the balls, with equal probability for all values in between; within a group they do
    not differ.
    """
    problem = solution.problem
    count = len(solution.table_positions)
    if len(solution.parts) == 1 or not problem.group_allowance:
        return np.zeros((count, 0))
    size = problem.group_allowance / (problem.radius if component in ROTATIONS else 1.0)
    # what all groups have in common is no zero of a group
    columns = constant = [own - np.mean(own) for own in solution.members()]
    if any(component in pair for pair in PAIRS):
        angles = problem.angles[solution.table_positions]
        columns = constant + [own * turn(angles) for own in constant for turn in (np.cos, np.sin)]
    # uniform within +- size: a variance of size^2 / 3, of which either zero has one half
    return np.asarray(size / np.sqrt(6.0) * np.column_stack(columns), dtype=np.float64)
