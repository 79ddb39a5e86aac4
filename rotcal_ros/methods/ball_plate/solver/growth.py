"""Growth of the plate: it warms while it is measured, and every ball moves away from its centre.

A plate that grows by g over the run displaces a ball at the time t, from -0.5 to 0.5, by g t times
its place. What it had grown by in the middle of the run is no error: the method does not know the
plate's size. The machine's errors take a growth where all balls that come to a CMM position come
there at one time, the table's only what a rigid motion imitates: so every order shows a growth, or
it does little harm. A machine whose scales shrink in x and y looks the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from rotcal_ros.adjust.effects import Seen, effect_test, unseen
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.protection import POWER
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.methods.ball_plate.materials import kelvin
from rotcal_ros.methods.ball_plate.solver.estimate import drift_columns
from rotcal_ros.methods.ball_plate.solver.model import LinearFit, Solution, rigid_motion
from rotcal_ros.methods.ball_plate.solver.order_effects import (
    FALSE_KNOCK,
    SIGNIFICANCE,
    SPARE,
    DisplacementPatterns,
    least_noise,
)
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, on_circle, places_of

LARGEST: Final = 5e-4
"""Growth over a run that could not be overlooked: 20 K of aluminium."""
PLAUSIBLE_K: Final = 20.0
"""Kelvin from which on a growth is not laid to the plate's temperature."""


@dataclass(frozen=True)
class GrowthTest:
    """How much the plate grew over the run, ``amount`` with ``std``; ``p_value`` if it did not.

    ``kelvin``: by how much a plate of its ``material`` has warmed then; None where not stated.
    """

    amount: float
    std: float
    p_value: float
    material: str
    kelvin: float | None

    @classmethod
    def of(cls, amount: float, std: float, p_value: float, material: str) -> GrowthTest:
        """Return the test of a growth with its kelvin."""
        return cls(amount, std, p_value, material, kelvin(amount, material))

    @property
    def significant(self) -> bool:
        """Whether the plate has grown."""
        return self.p_value < SIGNIFICANCE

    def sentence(self) -> str:
        """Say in words how much the plate grew, and by what cause."""
        grew, warms = ("grew", "warms") if self.amount > 0.0 else ("shrank", "cools")
        size, band = abs(self.amount) / MICROMETRE, 2.0 * self.std / MICROMETRE
        found = f"the plate {grew} by {size:.3g} +- {band:.2g} um/m over the run"
        if self.kelvin is None:
            cause = "plan.plate.material would give it in kelvin"
        elif abs(self.kelvin) > PLAUSIBLE_K:
            cause = (
                f"{self.material} does not with {PLAUSIBLE_K:g} K: the machine's scales changed"
            )
        else:
            cause = f"as {self.material} does that {warms} by {abs(self.kelvin):.2g} K"
        return (
            f"{found}, {cause} (p = {self.p_value:.2g}): let plate and machine settle, or measure "
            "in less time"
        )


@dataclass(frozen=True, eq=False)
class Growth:
    """A unit of growth as a fit sees it, and its test; None where there is nothing to test by.

    ``gain``: what it explains of w'w. ``evident``: beyond doubt, and more than a drift explains.
    """

    seen: Seen
    test: GrowthTest | None = None
    gain: float = 0.0
    evident: bool = False

    def error(self, std: Floats, dof: int, sigma: float) -> float:
        """Return the largest error of a growth that the test leaves unseen, in ``std`` (6, N).

        They belong to unit noise; ``sigma`` is that of the centres.
        """
        return unseen(
            self.seen, std.ravel(), LARGEST / sigma,
            significance=SIGNIFICANCE, power=POWER, dof=dof,
        ).error  # fmt: skip


def likelier(tests: Sequence[GrowthTest]) -> GrowthTest | None:
    """Return the likelier of several tests of one growth (Bonferroni); None of none."""
    if not tests:
        return None
    best = min(tests, key=lambda test: (test.p_value, test.std))
    return replace(best, p_value=min(1.0, len(tests) * best.p_value))


def growth_columns(problem: BallPlateProblem, run_time: Floats) -> Floats:
    """Return the displacement (n, 3, 1) of centres, m, by a growth of 1 over the run.

    ``run_time`` (n,) runs from -0.5 to 0.5.
    """
    places = problem.radius * on_circle(problem.angles[problem.cmm_index])
    return np.asarray((run_time[:, None] * places)[:, :, None])


def unit_growth(
    problem: BallPlateProblem, linear: LinearFit, closing: BallPlateProblem | None
) -> DisplacementPatterns:
    """Return what a growth of 1 over the run does in the order of a problem and its closing rows.

    Of these counts what no rigid motion explains.
    """
    columns = growth_columns(problem, problem.run_time)
    closed = np.zeros((1, 1))
    if closing is not None:
        again = closing.take(np.isin(closing.cell, problem.cell))
        first = places_of(again.cell, problem.cell)
        late = growth_columns(again, again.run_time_on(problem))
        change = (late - columns[first]).reshape(-1, 1)
        motion = rigid_motion(problem.angles[problem.cmm_index[first]]).reshape(-1, 6)
        change = change - motion @ np.linalg.lstsq(motion, change, rcond=None)[0]
        closed = 0.5 * change.T @ change  # of two centres, which have twice the variance of one
    return DisplacementPatterns(linear.seen(columns), closed)


def find_growth(problem: BallPlateProblem, linear: LinearFit, solution: Solution) -> Growth:
    """Look for a growth in the residuals of a fit."""
    columns = growth_columns(problem, problem.run_time)
    seen, rest = linear.seen(columns, solution.residuals), solution.weighted_square_sum
    found = effect_test(seen, (rest, solution.dof), least_noise(problem, solution))
    if not found.rank or solution.dof < SPARE:
        return Growth(seen)
    std = float(np.sqrt(found.variance * found.covariance[0, 0]))
    test = GrowthTest.of(float(found.size[0]), std, found.probability, problem.material)
    evident = found.probability < FALSE_KNOCK
    if evident:
        drift = linear.seen(drift_columns(problem.run_time, 1), solution.residuals)
        evident = found.squares > effect_test(drift).squares
    return Growth(seen, test, found.squares, evident)
