"""The fits of a plate's groups, the noise of a centre, and the curves that follow from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.components import COMPONENTS
from rotcal_ros.methods.ball_plate import model
from rotcal_ros.methods.ball_plate.problem import BallPlateProblem
from rotcal_ros.methods.ball_plate.rejection import Fitted, fit_and_reject
from rotcal_ros.methods.ball_plate.screening import screen
from rotcal_ros.methods.ball_plate.two_groups import (
    Group,
    split,
    turned_back,
    turned_covariance,
)
from rotcal_ros.methods.distributions import chi2_sf
from rotcal_ros.results import Rejection

SIGNIFICANCE = 0.01
"""Level of the chi-square test of the stated noise."""


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
