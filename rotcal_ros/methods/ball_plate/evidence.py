"""Tests of a fit in its order of measurement, for a CMM that drifts and a plate that moves.

Both look for patterns that :mod:`order_effects` predicts, in the residuals of the fit. The search
for a knock in :mod:`knock` has the last word on a plate that jumped; the one here finds what is
too small for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.adjust.distributions import f_sf
from rotcal_ros.arrays import Floats
from rotcal_ros.methods.ball_plate.drift import VISIBLE, drift_columns
from rotcal_ros.methods.ball_plate.model import Drift, Solution, least_variance
from rotcal_ros.methods.ball_plate.order_effects import (
    SIGNIFICANCE,
    Disturbance,
    OrderEffects,
    motion_columns,
)
from rotcal_ros.methods.ball_plate.problem import BallPlateProblem
from rotcal_ros.methods.ball_plate.response import weights
from rotcal_ros.units import ARCSEC, MICROMETRE

SPARE: Final = 8
"""Degrees of freedom below which nothing can be tested."""
SETTLED: Final = 0.01
"""Share of the stated noise that the iteration of the exact model may leave in the residuals."""


@dataclass(frozen=True)
class DriftTest:
    """Linear drift of the CMM's origin: ``amount`` (3,), m over the run, with ``std``; p value.

    ``estimated``: part of the fit, and so no reason for doubt.
    """

    amount: Floats
    std: Floats
    p_value: float
    estimated: bool

    @property
    def significant(self) -> bool:
        """Whether there is a drift."""
        return self.p_value < SIGNIFICANCE

    def sentence(self) -> str:
        """Say in words how much drifts."""
        shown = ", ".join(
            f"{a / MICROMETRE:.3f} +- {2.0 * s / MICROMETRE:.3f}"
            for a, s in zip(self.amount, self.std, strict=True)
        )
        found = f"the origin of the CMM drifts by ({shown}) um over the run in x, y, z"
        if self.estimated:
            return f"{found}; it is estimated and taken off"
        return (
            f"{found} (p = {self.p_value:.2g}): solver.drift: linear takes it off, with its "
            "uncertainty"
        )


@dataclass(frozen=True)
class MotionTest:
    """The most likely motion of the plate: from ``row`` on, shift (3,) m, rotation (3,) rad."""

    row: int
    shift: Floats
    rotation: Floats
    p_value: float

    @property
    def significant(self) -> bool:
        """Whether the plate has moved."""
        return self.p_value < SIGNIFICANCE

    def sentence(self) -> str:
        """Say in words what seems to have moved when."""
        x, y, z = self.shift / MICROMETRE
        a, b, c = self.rotation / ARCSEC
        return (
            f"the plate seems to have moved on the table near row {self.row} by ({x:.3f}, "
            f"{y:.3f}, {z:.3f}) um and ({a:.3f}, {b:.3f}, {c:.3f}) arcsec (p = "
            f"{self.p_value:.2g}): look at its clamping, or measure again"
        )


def find_drift(
    problem: BallPlateProblem, solution: Solution, effects: OrderEffects
) -> DriftTest | None:
    """Test the three linear drifts together; None where the residuals do not keep them."""
    if solution.drift is not None:
        return _estimated(solution, solution.drift)
    columns = drift_columns(problem.run_time, 1)
    centred = columns - columns.mean(axis=0)
    weight = weights(problem)
    total = np.einsum("nia,ni,nia->a", centred, weight, centred)
    scale = 1.0 / np.sqrt(total)
    kept = np.linalg.eigvalsh(effects.drift.information * np.outer(scale, scale))
    if kept[0] < VISIBLE or solution.dof < SPARE:
        return None
    right = np.einsum("nia,ni->a", columns, weight * solution.residuals)
    least = _least(problem, solution)
    amount, inverse, p_value, variance = _tested(effects.drift, right, solution, least)
    return DriftTest(amount, np.sqrt(variance * np.diag(inverse)), p_value, estimated=False)


def find_motion(
    problem: BallPlateProblem, solution: Solution, effects: OrderEffects
) -> MotionTest | None:
    """Look for a motion of the plate at each of the moments of ``effects``."""
    if solution.dof < SPARE:
        return None
    order = np.argsort(problem.rows, kind="stable")
    pulled = (weights(problem) * solution.residuals)[order]
    each = np.einsum("nia,ni->na", motion_columns(problem)[order], pulled)
    later = np.cumsum(each[::-1], axis=0)[::-1]
    best: MotionTest | None = None
    least = _least(problem, solution)
    for moment, knock in zip(effects.moments, effects.knocks, strict=True):
        if moment >= len(order):
            continue
        amount, _, p_value, _ = _tested(knock, later[moment], solution, least)
        p_value = min(1.0, p_value * len(effects.knocks))
        if best is None or p_value < best.p_value:
            row = int(problem.rows[order[moment]])
            best = MotionTest(row, amount[:3], amount[3:] / problem.radius, p_value)
    return best


def _least(problem: BallPlateProblem, solution: Solution) -> float:
    """Return the variance below which the rest is no noise; in units of ``std``, if given."""
    stated = 1.0 if problem.std is not None else problem.sigma or 0.0
    return max(least_variance(problem, solution.estimate), (SETTLED * stated) ** 2)


def _tested(
    pattern: Disturbance, right: Floats, solution: Solution, floor: float
) -> tuple[Floats, Floats, float, float]:
    """Return amount, unit covariance, p value of its F test, and the variance of the rest."""
    values, vectors = np.linalg.eigh(pattern.information)
    seen = values > pattern.seen
    rank = int(np.count_nonzero(seen))
    inverse = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T
    amount: Floats = inverse @ right
    gain = float(right @ amount)
    dof = solution.dof - rank
    if not rank:
        return amount, inverse, 1.0, floor
    variance = max((solution.weighted_square_sum - gain) / dof, floor)
    return amount, inverse, f_sf(gain / rank / variance, rank, dof), variance


def _estimated(solution: Solution, drift: Drift) -> DriftTest:
    linear = drift.unit_covariance[:3, :3]
    variance = solution.weighted_square_sum / solution.dof
    amount = drift.amount[0]
    value = float(amount @ np.linalg.solve(linear, amount)) / 3.0 / max(variance, 1e-300)
    std = np.sqrt(variance * np.diag(linear))
    return DriftTest(amount, std, f_sf(value, 3, solution.dof), estimated=True)


def stronger(
    drifts: Sequence[DriftTest], motions: Sequence[MotionTest]
) -> list[DriftTest | MotionTest]:
    """Return the significant findings worth telling; of a drift and a motion the likelier one.

    A drift looks like a small motion and the other way round.
    """
    every: list[DriftTest | MotionTest] = [*drifts, *motions]
    found = [t for t in every if t.significant]
    known: list[DriftTest | MotionTest] = [d for d in drifts if d.significant and d.estimated]
    doubts = sorted((t for t in found if t not in known), key=lambda t: t.p_value)
    return known + doubts[:1]
