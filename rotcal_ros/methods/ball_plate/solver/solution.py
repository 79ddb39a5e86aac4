"""The fits of a plate's groups, the noise of a centre, and the curves that follow from them.

A plate whose balls share the factor 2 with the grid sees the even and the odd table positions
separately (second paper, optimised method): half the work of the complete grid, but condition (22)
fails. Every group is a three rosette measurement of its own; the offset between the groups is not
measured.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.foundation.results import Rejection
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.ball_plate.solver import general_least_squares, model
from rotcal_ros.methods.ball_plate.solver.closure import split as closing_apart
from rotcal_ros.methods.ball_plate.solver.model import Solution
from rotcal_ros.methods.ball_plate.solver.noise import AXIS_SIGNIFICANCE, CentreNoise, assess
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, grid_step, position_of
from rotcal_ros.methods.ball_plate.solver.rejection import Fitted, fit_and_reject
from rotcal_ros.methods.ball_plate.solver.screening import screen
from rotcal_ros.methods.ball_plate.solver.separability import common_divisor


@dataclass(frozen=True)
class PositionGroup:
    """One group: the table positions (M,) of the whole grid, and the problem of the group.

    The problem lives on the group's own grid, in a frame turned by ``turn`` radians about z.
    ``closing`` are rows measured again at the end, which the fit does without.
    """

    positions: Ints
    turn: float
    problem: BallPlateProblem
    closing: BallPlateProblem | None = None


@dataclass(frozen=True)
class PlateSolution:
    """A solved problem: ``whole`` are the rows that were fitted at all, ``fits`` one per group.

    ``rejected`` are the other rows and those that did not fit, in the order of the row numbers.
    """

    problem: BallPlateProblem
    whole: BallPlateProblem
    groups: tuple[PositionGroup, ...]
    fits: tuple[Fitted, ...]
    noise: CentreNoise
    rejected: tuple[Rejection, ...]

    @cached_property
    def table_positions(self) -> Ints:
        """The table positions that could be solved, ascending, (M,); the others were left out."""
        return np.sort(np.concatenate([*self._positions()]))

    def _positions(self) -> tuple[Ints, ...]:
        """Return the solved table positions of every group, on the whole grid."""
        return tuple(
            group.positions[fit.problem.table_positions]
            for group, fit in zip(self.groups, self.fits, strict=True)
        )

    def deviations(self) -> dict[str, Floats]:
        """Return the table's six deviations (M,), metres and radians."""
        fields = {
            name: np.empty((self.problem.n_positions, 3)) for name in ("translation", "rotation")
        }
        for group, fit, positions in zip(self.groups, self.fits, self._positions(), strict=True):
            for name, field in fields.items():
                field[positions] = turned_back(group, getattr(fit.solution.estimate, name))
        kept = self.table_positions
        return {n: fields[f][kept, axis] for n, (f, axis) in model.TABLE_COMPONENTS.items()}

    def std(self) -> dict[str, Floats]:
        """Return the standard deviations (M,) of the six deviations."""
        if len(self.groups) == 1:
            std = model.scaled(self.fits[0].solution.unit_std, self.noise.scale)
            return {name: std.component(name) for name in COMPONENTS}
        return {name: np.sqrt(np.diag(self.covariance(name))) for name in COMPONENTS}

    def covariance(self, name: str) -> Floats:
        """Return the (M, M) covariance of a component; zero between groups."""
        scale = model.of_component(self.noise.scale, name)
        covariance: Floats = scale * scale * self._unit_covariance(name)
        return covariance

    def _unit_covariance(self, name: str) -> Floats:
        if len(self.groups) == 1:
            return turned_covariance(self.groups[0], self.fits[0].solution, name)
        covariance = np.zeros((len(self.table_positions),) * 2)
        for group, fit, positions in zip(self.groups, self.fits, self._positions(), strict=True):
            at = np.searchsorted(self.table_positions, positions)
            place = np.ix_(at, at)
            covariance[place] = turned_covariance(group, fit.solution, name)
        return covariance


def adjust(problem: BallPlateProblem) -> PlateSolution:
    """Return the solution of ``problem``; raises what :func:`~.solve.solve` raises.

    Where one axis proves noisier than another, all is done again with the weights found; not after
    a knock, whose residuals are no noise.
    """
    once, closing = closing_apart(problem)
    whole, unusable = screen(once)
    stated = problem.sigma if problem.std is None else 1.0
    groups, fits = _fitted(whole, closing)
    noise = assess(_turned(groups, fits), stated)
    if noise.unequal and all(fit.knock is None for fit in fits):
        weights = _weights(whole, len(groups), noise)
        own = np.ones_like(whole.centres) if whole.std is None else whole.std
        groups, fits = _fitted(replace(whole, sigma=None, std=own * weights), closing)
        noise = assess(_turned(groups, fits), stated, first=noise, weights=weights)
    rejected = unusable + [r for fit in fits for r in fit.rejected]
    in_order = tuple(sorted(rejected, key=lambda r: r.index))
    return PlateSolution(problem, whole, groups, fits, noise, in_order)


def _fitted(
    whole: BallPlateProblem, closing: BallPlateProblem | None
) -> tuple[tuple[PositionGroup, ...], tuple[Fitted, ...]]:
    """Cut a problem into its groups, if it has any, and fit each."""
    alone = PositionGroup(np.arange(whole.n_positions), 0.0, whole, closing)
    groups = split(whole, closing) if whole.separate_groups else (alone,)
    return groups, tuple(
        fit_and_reject(group.problem, whole.take(np.isin(whole.rows, group.problem.rows)))
        for group in groups
    )


def _turned(
    groups: tuple[PositionGroup, ...], fits: tuple[Fitted, ...]
) -> list[tuple[Fitted, float]]:
    return [(fit, group.turn) for group, fit in zip(groups, fits, strict=True)]


def _weights(whole: BallPlateProblem, n_groups: int, noise: CentreNoise) -> Floats:
    """Return the standard deviations (3,) to weigh with.

    x and y count as one where nothing speaks against it; also for groups, whose frames are turned,
    and where the elimination would not fit into memory: then the larger one is stated.
    """
    weights: Floats = noise.estimated.copy()
    large = model.offsets(whole).total > general_least_squares.MAX_UNKNOWNS
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
    """Cut out the table positions first, first + count, ... and turn them to start at zero."""
    step = grid_step(problem.position, problem.grid)
    rows = np.flatnonzero(step % count == first)
    if not len(rows):
        raise ObservabilityError(
            f"no centre was measured at the table positions {first}, {first + count}, ...: "
            "one group is missing altogether"
        )
    part = problem.take(rows)
    if start is None:
        start = int(problem.balls[0] % count)  # ball steps are start + multiples of count
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
    return PositionGroup(positions, turn, group_problem)


def turned_back(group: PositionGroup, vectors: Floats) -> Floats:
    """Bring vectors (n, 3) of the group's frame back to the frame of the whole."""
    back: Floats = vectors @ rotation_about_z(group.turn).T
    return back


def turned_covariance(group: PositionGroup, solution: Solution, name: str) -> Floats:
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
