"""A plate that was knocked during the measurement: all later centres jump, and we say when."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotcal_ros.adjust.distributions import f_isf
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.ball_plate.solver import model
from rotcal_ros.methods.ball_plate.solver.model import LinearFit, Solution
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, grid_angles

FALSE_ALARM = 1e-6
"""Probability that good data are said to contain a knock."""
CANDIDATES = 3


@dataclass(frozen=True)
class Knock:
    """The plate moved between the rows ``last`` and ``first`` (row numbers).

    ``shift`` (3,) metres and ``rotation`` (3,) radians are its motion on the table, in the
    table's frame at position 0, ``gain`` what it explains of w'w, ``scatter`` the variance it was
    tested against. Motions that the CMM's own
    errors can imitate are found as zero: they do no harm either.
    """

    last: int
    first: int
    ball_step: int
    position: int
    shift: Floats
    rotation: Floats
    gain: float
    scatter: float

    def sentence(self) -> str:
        """Say in words what happened and when."""
        x, y, z = self.shift / MICROMETRE
        a, b, c = self.rotation / ARCSEC
        return (
            f"the plate moved on the table between rows {self.last} and {self.first} (before "
            f"ball step {self.ball_step} at table position {self.position}): all later "
            f"centres are displaced by about ({x:.2f}, {y:.2f}, {z:.2f}) um and turned by "
            f"({a:.2f}, {b:.2f}, {c:.2f}) arcsec; fix the plate and measure again"
        )


def find_knock(
    problem: BallPlateProblem, linear: LinearFit, solution: Solution, sigma: float | None
) -> Knock | None:
    """Look along the rows in their order of measurement for a moment when the plate moved.

    The motion has six parameters from the moment on; the gain of w'w is tested against the
    remaining scatter, or the stated ``sigma`` (of unit weight) where that is larger. None when no
    moment stands out.
    """
    order = np.argsort(problem.rows, kind="stable")
    motion = _motion_design(problem)[order]
    weight = np.ones_like(problem.centres) if problem.std is None else problem.std**-2
    weighted = (weight * solution.residuals)[order]
    later = np.cumsum(np.einsum("nij,ni->nj", motion, weighted)[::-1], axis=0)[::-1]
    best: tuple[float, int, Floats] | None = None
    for start in _candidates(later, motion, weight[order]):
        gain, amount = _fit_motion(problem, linear, order[start:], motion[start:], later[start])
        if best is None or gain > best[0]:
            best = (gain, start, amount)
    if best is None or solution.dof <= 12:
        return None
    gain, start, amount = best
    rest = (solution.weighted_square_sum - gain) / (solution.dof - 6)
    scatter = max(rest, (sigma or 0.0) ** 2, model.least_variance(problem, solution.estimate))
    if gain / 6.0 < scatter * f_isf(FALSE_ALARM / len(order), 6, solution.dof - 6):
        return None
    row = order[start]
    return Knock(
        last=int(problem.rows[order[start - 1]]),
        first=int(problem.rows[row]),
        ball_step=int(problem.ball_step[row]),
        position=int(problem.position[row]),
        shift=amount[:3],
        rotation=amount[3:] / problem.radius,
        gain=gain,
        scatter=scatter,
    )


def _motion_design(problem: BallPlateProblem) -> Floats:
    """Return (n, 3, 6): displacement of a centre per unit shift, and rotation times radius."""
    turn = rotation_about_z(problem.angles)[problem.position]
    cross = model.cross_unit(grid_angles(problem.grid))[problem.ball_step]
    return np.concatenate([turn, turn @ cross], axis=2)


def _candidates(later: Floats, motion: Floats, weight: Floats) -> list[int]:
    """Return the most likely moments by a bound on their gain, best first.

    The bound leaves out that table and CMM absorb part of the motion; it peaks where the gain
    does. Moments within 1 % of each other count as one.
    """
    own = np.einsum("nij,ni,nik->njk", motion, weight, motion)
    information = np.cumsum(own[::-1], axis=0)[::-1]
    total = information[0]
    starts = np.arange(1, len(later))
    share = information[starts] @ np.linalg.pinv(total)
    spread = information[starts] @ (np.eye(6) - share.swapaxes(1, 2)) + 1e-9 * total
    amount = np.linalg.solve(spread, later[starts][:, :, None])[:, :, 0]
    bound = np.einsum("nj,nj->n", later[starts], amount)
    chosen: list[int] = []
    for index in np.argsort(-bound, kind="stable"):
        if all(abs(int(starts[index]) - other) > 0.01 * len(later) for other in chosen):
            chosen.append(int(starts[index]))
        if len(chosen) == CANDIDATES:
            break
    return chosen


def _fit_motion(
    problem: BallPlateProblem,
    linear: LinearFit,
    rows: Ints,
    motion: Floats,
    right: Floats,
) -> tuple[float, Floats]:
    """Return gain of w'w and the motion (6,) when the rows from a moment on have moved."""
    moved = np.zeros((len(problem.centres), 3, 6))
    moved[rows] = motion
    remains = np.stack([linear.fit(moved[:, :, c])[1] for c in range(6)], axis=2)
    weight = np.ones_like(problem.centres) if problem.std is None else problem.std**-2
    information = np.einsum("nij,ni,nik->jk", moved, weight, remains)
    information = 0.5 * (information + information.T)
    amount: Floats = np.linalg.pinv(information, rcond=1e-6, hermitian=True) @ right
    return float(right @ amount), amount
