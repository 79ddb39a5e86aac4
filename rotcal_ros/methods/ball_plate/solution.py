"""The fits of a plate's groups, the noise of a centre, and the curves that follow from them.

A plate whose balls share the factor 2 with the grid sees the even and the odd table positions
separately (second paper, optimised method): half the work of the complete grid, but condition (22)
fails. Every group is a three rosette measurement of its own; the offset between the groups is not
measured.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rotcal_ros.arrays import Floats, Ints
from rotcal_ros.components import COMPONENTS
from rotcal_ros.errors import ObservabilityError
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.ball_plate import model
from rotcal_ros.methods.ball_plate.model import Solution
from rotcal_ros.methods.ball_plate.problem import BallPlateProblem
from rotcal_ros.methods.ball_plate.rejection import Fitted, fit_and_reject
from rotcal_ros.methods.ball_plate.screening import screen
from rotcal_ros.methods.ball_plate.separability import common_divisor
from rotcal_ros.methods.distributions import chi2_sf
from rotcal_ros.results import Rejection

SIGNIFICANCE = 0.01
"""Level of the chi-square test of the stated noise."""


@dataclass(frozen=True)
class Group:
    """One group: the table positions (M,) of the whole grid, and the problem of the group.

    The problem lives on the group's own grid, in a frame turned by ``turn`` radians about z.
    """

    positions: Ints
    turn: float
    problem: BallPlateProblem


@dataclass(frozen=True)
class Noise:
    """Standard deviation of a centre: ``used`` (m, or of unit weight), stated or estimated.

    ``sigma0`` is estimate / statement, 1 when nothing was stated; ``p_value`` belongs to the
    two-sided chi-square test of the statement, None when nothing was stated.
    """

    used: float
    estimated: float
    sigma0: float
    p_value: float | None
    dof: int

    @property
    def contradicts(self) -> bool:
        """Whether the residuals contradict the stated noise."""
        return self.p_value is not None and self.p_value < SIGNIFICANCE


@dataclass(frozen=True)
class PlateSolution:
    """A solved problem: ``whole`` are the rows that were fitted at all, ``fits`` one per group.

    ``rejected`` are the other rows and those that did not fit, in the order of the row numbers.
    """

    problem: BallPlateProblem
    whole: BallPlateProblem
    groups: tuple[Group, ...]
    fits: tuple[Fitted, ...]
    noise: Noise
    rejected: tuple[Rejection, ...]

    def deviations(self) -> dict[str, Floats]:
        """Return the table's six deviations (N,), metres and radians."""
        fields = {name: np.empty((self.problem.grid, 3)) for name in ("translation", "rotation")}
        for group, fit in zip(self.groups, self.fits, strict=True):
            for name, field in fields.items():
                field[group.positions] = turned_back(group, getattr(fit.solution.estimate, name))
        return {name: fields[f][:, axis] for name, (f, axis) in model.TABLE_COMPONENTS.items()}

    def std(self) -> dict[str, Floats]:
        """Return the standard deviations (N,) of the six deviations."""
        scale = self.noise.used
        if len(self.groups) == 1:
            unit = self.fits[0].solution.unit_std
            return {name: scale * unit.component(name) for name in COMPONENTS}
        return {name: scale * np.sqrt(np.diag(self.unit_covariance(name))) for name in COMPONENTS}

    def unit_covariance(self, name: str) -> Floats:
        """Return the (N, N) unit covariance of a component; zero between groups."""
        if len(self.groups) == 1:
            return turned_covariance(self.groups[0], self.fits[0].solution, name)
        covariance = np.zeros((self.problem.grid, self.problem.grid))
        for group, fit in zip(self.groups, self.fits, strict=True):
            place = np.ix_(group.positions, group.positions)
            covariance[place] = turned_covariance(group, fit.solution, name)
        return covariance


def adjust(problem: BallPlateProblem) -> PlateSolution:
    """Return the solution of ``problem``; raises what :func:`~.solve.solve` raises."""
    whole, unusable = screen(problem)
    alone = Group(np.arange(whole.grid), 0.0, whole)
    groups = split(whole) if problem.separate_groups else (alone,)
    fits = tuple(fit_and_reject(group.problem) for group in groups)
    rejected = unusable + [r for fit in fits for r in fit.rejected]
    in_order = tuple(sorted(rejected, key=lambda r: r.index))
    return PlateSolution(problem, whole, groups, fits, _noise(problem, fits), in_order)


def _noise(problem: BallPlateProblem, fits: tuple[Fitted, ...]) -> Noise:
    """Pool the residuals of all groups and test the stated noise."""
    total = sum(fit.solution.weighted_square_sum for fit in fits)
    dof = sum(fit.solution.dof for fit in fits)
    estimated = float(np.sqrt(total / dof))
    stated = 1.0 if problem.std is not None else problem.sigma
    if stated is None:
        return Noise(estimated, estimated, 1.0, None, dof)
    tail = chi2_sf(total / stated**2, dof)
    p_value = 2.0 * min(tail, 1.0 - tail)
    used = estimated if p_value < SIGNIFICANCE and estimated > stated else stated
    return Noise(used, estimated, estimated / stated, p_value, dof)


def split(problem: BallPlateProblem) -> tuple[Group, ...]:
    """Cut a problem into its groups of table positions.

    The number of groups is the common divisor of the ball steps and the grid (Eq. 22), 2 in the
    paper, 1 for a plate that connects all positions. Raises ObservabilityError when a group was
    not measured at all.
    """
    count = common_divisor(problem.grid, problem.balls)
    return tuple(_group(problem, first, count) for first in range(count))


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
