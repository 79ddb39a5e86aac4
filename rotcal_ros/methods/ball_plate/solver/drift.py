"""A drift of the CMM's origin: its columns in the model, and the fit with it estimated along.

The spectral solution stays: the few further columns E are bordered to it. With M the projector to
the residuals, their normal matrix is E' M E, their amount (E' M E)^-1 E' M y, and everything else
moves by what they cause.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.methods.ball_plate.solver.disturbance_response import Responder, responses, weights
from rotcal_ros.methods.ball_plate.solver.model import (
    FIELDS,
    LinearFit,
    OriginDrift,
    PlateParameters,
    Solution,
)
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem

VISIBLE = 0.01
"""Part of a drift's sum of squares that must be left in the residuals to estimate it."""


def drift_columns(run_time: Floats, degree: int) -> Floats:
    """Return the displacement (n, 3, 3 degree) of centres by a drift of 1 m over the run.

    ``run_time`` runs from -0.5 to 0.5. The linear part comes first, then the bow: 1 m more at
    both ends than in the middle.
    """
    shapes = np.stack([run_time, 4.0 * run_time**2], axis=1)[:, :degree]
    columns = shapes[:, None, :, None] * np.eye(3)[:, None, :]
    return columns.reshape(len(run_time), 3, 3 * degree)


def drifted(
    problem: BallPlateProblem, reference: BallPlateProblem, drift: OriginDrift | None
) -> Floats:
    """Return where an estimated drift moved the rows (n, 3); ``reference`` has its time."""
    if drift is None:
        return np.zeros_like(problem.centres)
    columns = drift_columns(problem.run_time_on(reference), len(drift.amount))
    moved: Floats = columns @ drift.amount.ravel()
    return moved


class Border:
    """The columns of a drift, what they do, and the normal matrix that is left of them.

    ``columns`` (n, 3, m) displace the rows, ``remains`` (n, 3, m) is what the residuals keep of
    them, ``parameters`` (m) what the fit takes for its own, ``inverse`` (m, m) the unit
    covariance of their amounts. Raises ObservabilityError where the residuals keep too little.
    """

    def __init__(self, problem: BallPlateProblem, respond: Responder) -> None:
        self.columns = drift_columns(problem.run_time, problem.drift)
        self.parameters, self.remains = responses(respond, self.columns)
        self.weighted = weights(problem)[:, :, None] * self.columns
        information = np.einsum("nia,nib->ab", self.weighted, self.remains)
        centred = self.columns - self.columns.mean(axis=0)
        total = np.einsum("nia,ni,nia->a", centred, weights(problem), centred)
        scale = 1.0 / np.sqrt(total)
        shares = np.linalg.eigvalsh(0.5 * (information + information.T) * np.outer(scale, scale))
        if shares[0] < VISIBLE:
            raise ObservabilityError(
                f"a drift cannot be told from errors of the table and the CMM in this order of "
                f"measurement: the residuals keep {max(shares[0], 0.0):.2g} of it, {VISIBLE:g} "
                "are needed; measure in the order interleaved, or leave solver.drift at none"
            )
        self.inverse = np.linalg.inv(0.5 * (information + information.T))
        self.moved = {
            name: np.stack([getattr(p, name) for p in self.parameters], axis=-1) for name in FIELDS
        }

    def amount(self, residuals: Floats) -> Floats:
        """Return how much (m,) of each column residuals (n, 3) without drift contain."""
        found: Floats = self.inverse @ np.einsum("nia,ni->a", self.weighted, residuals)
        return found

    def fit(self, plain: LinearFit) -> LinearFit:
        """Return the factored model with the drift among its unknowns."""

        def fit(observed: Floats) -> tuple[PlateParameters, Floats]:
            found, residuals = plain.fit(observed)
            amount = self.amount(residuals)
            less = {name: getattr(found, name) - m @ amount for name, m in self.moved.items()}
            return PlateParameters(**less), residuals - self.remains @ amount

        def solution(estimate: PlateParameters, residuals: Floats) -> Solution:
            return self._enlarged(plain.solution(estimate, residuals))

        return LinearFit(fit, solution)

    def settled(
        self,
        problem: BallPlateProblem,
        plain: LinearFit,
        settle: Callable[[BallPlateProblem, LinearFit], Solution],
    ) -> Solution:
        """Return the solution of the exact model: ``settle`` solves what the drift leaves.

        The amount follows from the linear model, and once more from what is left: the products
        with the pose of the axis are gone after that.
        """
        amount = self.amount(plain.fit(problem.deviations)[1])
        for _ in range(2):
            rest = replace(problem, centres=problem.centres - self.columns @ amount)
            solution = settle(rest, plain)
            amount = amount + self.amount(solution.residuals)
        found = OriginDrift(amount.reshape(-1, 3), self.inverse)
        return replace(self._enlarged(solution), drift=found)

    def _enlarged(self, solution: Solution) -> Solution:
        """Return a solution without drift with the uncertainty that its amount adds."""
        std = {
            name: np.sqrt(
                getattr(solution.unit_std, name) ** 2
                + np.einsum("...i,ij,...j->...", m, self.inverse, m)
            )
            for name, m in self.moved.items()
        }
        return replace(
            solution,
            unit_std=PlateParameters(**std),
            unit_covariance=partial(self._covariance, solution),
            cofactor=partial(self._cofactor, solution),
            dof=solution.dof - len(self.inverse),
            way=f"{solution.way} with drift",
        )

    def _covariance(self, solution: Solution, first: str, second: str) -> Floats:
        columns = np.stack([p.component(first) for p in self.parameters], axis=1)
        others = np.stack([p.component(second) for p in self.parameters], axis=1)
        added: Floats = columns @ self.inverse @ others.T
        return solution.unit_covariance(first, second) + added

    def _cofactor(self, solution: Solution) -> Floats:
        taken: Floats = self.remains @ self.inverse @ self.remains.swapaxes(1, 2)
        return solution.cofactor() - taken
