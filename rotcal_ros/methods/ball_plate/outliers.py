"""Which centres do not fit: the normalised residual of every centre, and the rejection rule."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotcal_ros.arrays import Floats, Ints
from rotcal_ros.methods.ball_plate.model import Solution
from rotcal_ros.methods.ball_plate.problem import BallPlateProblem
from rotcal_ros.methods.distributions import f_isf

FALSE_ALARM = 0.01
"""Probability that good data lose any centre at all."""
LEAK = 0.3
"""Part of the worst normalised residual below which a row may only follow a worse one."""
DETERMINED = 1e-8
"""Residual cofactors below this part of the largest belong to coordinates without a check."""


@dataclass(frozen=True)
class CentreTest:
    """Test of every centre (n,): its removal would lower w'w by ``gain``.

    ``value`` is the normalised residual sqrt(gain / rank) / sigma, ``critical`` (n,) what it may
    reach in good data, ``redundancy`` in [0, 1] how much of an error stays in the residual.
    """

    gain: Floats
    value: Floats
    critical: Floats
    redundancy: Floats

    @property
    def outside(self) -> Ints:
        """Rows beyond their critical value, the worst first."""
        ratio = self.value / self.critical
        rows = np.flatnonzero(ratio > 1.0)
        return rows[np.argsort(-ratio[rows], kind="stable")]


def judge_centres(
    problem: BallPlateProblem, solution: Solution, sigma: float | None
) -> CentreTest:
    """Test each centre against the scatter of all the others.

    Its own part is left out, so that a gross error cannot hide behind the scatter it causes.
    Where the stated ``sigma`` (of unit weight) is larger it takes the place of the scatter; a
    statement that is too small must not cost good centres (the chi-square test reports it).
    """
    own = np.ones_like(problem.centres) if problem.std is None else problem.std**2
    cofactor = solution.cofactor()
    values, vectors = np.linalg.eigh(cofactor / own.max(axis=1)[:, None, None])
    values = values * own.max(axis=1)[:, None]
    checked = values > DETERMINED * own.max(axis=1)[:, None]
    along = np.einsum("nij,ni->nj", vectors, solution.residuals)
    gain = np.sum(np.where(checked, along**2 / np.where(checked, values, 1.0), 0.0), axis=1)
    rank = np.maximum(checked.sum(axis=1), 1)
    others = np.maximum(solution.dof - rank, 1)
    variance = np.maximum(solution.weighted_square_sum - gain, 0.0) / others
    if sigma is not None:
        variance = np.maximum(variance, sigma**2)
    critical = np.sqrt(f_isf(FALSE_ALARM / len(gain), rank, others))
    floor = np.finfo(np.float64).eps ** 2 * problem.radius**2 / own.max(axis=1)
    return CentreTest(
        gain=gain,
        value=np.sqrt(gain / rank / np.maximum(variance, floor)),
        critical=critical,
        redundancy=np.einsum("nii,ni->n", cofactor, 1.0 / own) / 3.0,
    )


def choose(problem: BallPlateProblem, test: CentreTest) -> Ints:
    """Return the rows to reject together: the worst, and others that share nothing with it.

    A gross error leaks into the residuals of the same ball, table and CMM position, and a little
    into all others; rows that share none of the three with a worse one, and are not much
    smaller than the worst, are guilty on their own account. The others wait for the next fit.
    """
    chosen: list[int] = []
    outside = test.outside
    for row in outside:
        if test.value[row] < LEAK * test.value[outside[0]]:
            continue
        shares = (
            problem.ball_step[row] == problem.ball_step[chosen],
            problem.position[row] == problem.position[chosen],
            problem.cmm_index[row] == problem.cmm_index[chosen],
        )
        if not np.any(shares):
            chosen.append(int(row))
    return np.array(chosen, dtype=np.int64)
