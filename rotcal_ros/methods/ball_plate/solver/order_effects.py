"""What a drift or a knock does in a given order of measurement, and whether it would be seen.

Both displace the centres by known patterns, and the estimate is linear: so the error per unit is
exact, and what the residuals keep of the pattern tells the size at which a test finds it with a
probability of POWER. Nothing of this needs measured values.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from rotcal_ros.adjust.distributions import f_isf, f_noncentrality
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.protection import POWER
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.ball_plate.solver import model
from rotcal_ros.methods.ball_plate.solver.disturbance_response import curves, responses, weights
from rotcal_ros.methods.ball_plate.solver.drift import drift_columns
from rotcal_ros.methods.ball_plate.solver.estimate import factored
from rotcal_ros.methods.ball_plate.solver.problem import (
    BallPlateProblem,
    grid_angles,
    grid_step,
    on_circle,
)

SIGNIFICANCE: Final = 0.01
"""Level of the tests for a drift, for a motion of the plate and of the closure."""
MOMENTS: Final = 40
"""Moments at which a knock is looked at, evenly over the run; a quarter where each costs more."""
MANY_CENTRES: Final = 3000
RANDOM_MOMENTS: Final = 0.95
"""A knock comes at a random moment: its error is that of all but the worst 5 % of them."""
HARMLESS: Final = 1e-12
"""Square of an error per unit, in standard deviations, below which it is rounding."""
NOTHING: Final = 1e-8
"""Part of the total information below which a direction counts as unseen."""


@dataclass(frozen=True, eq=False)
class DisplacementPatterns:
    """Some patterns of displacement, m columns: amounts in metres, rotations times radius.

    ``response`` (6, N, m) are the errors of the six deviations per unit, m and rad. The amount a
    changes w'w of the fit by a' ``information`` a, and that of the difference between the first
    table position and its repetition at the end by a' ``closing`` a (zero without); (m, m).
    ``total`` is the mean information that perfect knowledge of all else would leave.
    """

    response: Floats
    information: Floats
    closing: Floats
    total: float

    @property
    def seen(self) -> float:
        """Information from which on a direction counts as seen, not as rounding."""
        return NOTHING * self.total


@dataclass(frozen=True, eq=False)
class OrderEffects:
    """Drift (x, y, z over the run) and knocks (shift x, y, z, turn about x, y, z) of an order.

    ``moments`` are the places in the order of measurement from which on the plate has moved.
    """

    drift: DisplacementPatterns
    knocks: tuple[DisplacementPatterns, ...]
    moments: Ints


@dataclass(frozen=True)
class RowOrder:
    """Which rows are measured when, in a form that can be looked up: arrays as bytes."""

    grid: int
    bidirectional: bool
    radius: float
    columns: bytes
    run_time: bytes
    std: bytes
    drift: int
    closing: bytes

    @property
    def rows(self) -> Ints:
        """Table position, ball step and row number, (3, n)."""
        return np.frombuffer(self.columns, dtype=np.int64).reshape(3, -1)

    def problem(self) -> BallPlateProblem:
        """Return the problem with nominal centres."""
        position, ball, row = self.rows
        step = grid_step(position, self.grid)
        angle = grid_angles(self.grid)[(step + ball) % self.grid]
        return BallPlateProblem(
            self.grid,
            self.radius,
            position,
            ball,
            self.radius * on_circle(angle),
            std=np.frombuffer(self.std).reshape(-1, 3) if self.std else None,
            row=row,
            time=np.frombuffer(self.run_time),
            drift=self.drift,
            bidirectional=self.bidirectional,
        )


def order_effects(problem: BallPlateProblem, closing: BallPlateProblem | None) -> OrderEffects:
    """Return what drift and knocks do in the order of a problem and of its closing rows.

    With ``problem.drift`` a drift is estimated, and the knocks are those beside it. Layouts are
    remembered: the same one costs nothing the second time.
    """
    return _of_layout(layout_of(problem, closing))


def layout_of(problem: BallPlateProblem, closing: BallPlateProblem | None) -> RowOrder:
    """Return what of a problem does not depend on the measured values."""
    rows = np.stack([problem.position, problem.ball_step, problem.rows])
    last = np.empty((0, 3), dtype=np.int64)
    if closing is not None:
        last = np.stack([closing.position, closing.ball_step, closing.rows], axis=1)
    return RowOrder(
        problem.grid,
        problem.bidirectional,
        problem.radius,
        rows.tobytes(),
        problem.run_time.tobytes(),
        b"" if problem.std is None else problem.std.tobytes(),
        problem.drift,
        last.tobytes(),
    )


@lru_cache(maxsize=4)
def _of_layout(layout: RowOrder) -> OrderEffects:
    problem = layout.problem()
    motion = motion_columns(problem)
    pairs = _ClosingRows(
        problem, np.frombuffer(layout.closing, dtype=np.int64).reshape(-1, 3), motion
    )
    solve = _solver(problem)
    n = len(problem.centres)
    quick = problem.complete and n <= MANY_CENTRES
    count = MOMENTS if quick else MOMENTS // 4
    moments = np.unique(np.ceil((np.arange(count) + 0.5) / count * n).astype(np.int64))
    place = np.empty(n, dtype=np.int64)
    place[np.argsort(problem.rows, kind="stable")] = np.arange(n)
    return OrderEffects(
        drift=solve(drift_columns(problem.run_time, 1), pairs.drift()),
        knocks=tuple(
            solve(np.where(place[:, None, None] >= m, motion, 0.0), pairs.knock(place, m))
            for m in moments
        ),
        moments=moments,
    )


def _solver(problem: BallPlateProblem) -> Callable[[Floats, Floats], DisplacementPatterns]:
    """Return the function from columns (n, 3, m) and their closure to a disturbance."""
    respond, weight = factored(problem).fit, weights(problem)[:, :, None]
    border = drift_columns(problem.run_time, problem.drift)
    own, own_left = (None, None)
    if problem.drift:
        found, own_left = responses(respond, border)
        own = curves(found)
        inverse = np.linalg.inv(np.einsum("nia,nib->ab", weight * border, own_left))

    def solve(columns: Floats, closing: Floats) -> DisplacementPatterns:
        found, left = responses(respond, columns)
        response = curves(found)
        information = np.einsum("nia,nib->ab", weight * columns, left)
        total = float(np.sum(weight * columns**2)) / columns.shape[2]
        if own is not None:
            shared = np.einsum("nia,nib->ab", weight * border, left)
            response = response - own @ (inverse @ shared)
            information = information - shared.T @ inverse @ shared
        return DisplacementPatterns(response, 0.5 * (information + information.T), closing, total)

    return solve


def motion_columns(problem: BallPlateProblem) -> Floats:
    """Return (n, 3, 6): displacement per unit shift of the plate, and rotation times radius."""
    turn = rotation_about_z(problem.angles)[problem.position]
    cross = model.cross_unit(grid_angles(problem.grid))[problem.ball_step]
    columns: Floats = np.concatenate([turn, turn @ cross], axis=2)
    return columns


class _ClosingRows:
    """Closing rows (position, ball step, row number) with the rows that they repeat."""

    def __init__(self, problem: BallPlateProblem, closing: Ints, motion: Floats) -> None:
        self.problem = problem
        cell = problem.position * problem.grid + problem.ball_step
        wanted = closing[:, 0] * problem.grid + closing[:, 1]
        known = np.isin(wanted, cell)
        order = np.argsort(cell, kind="stable")
        self.first = order[np.searchsorted(cell[order], wanted[known])]
        self.motion = motion[self.first]

    def drift(self) -> Floats:
        """Return the information on a drift (3, 3): it was 0.5 at the end."""
        change = 0.5 - self.problem.run_time[self.first]
        return 0.5 * float(change @ change) * np.eye(3)

    def knock(self, place: Ints, moment: int) -> Floats:
        """Return the information on a motion (6, 6) before row ``moment``."""
        moved = self.motion[place[self.first] < moment]
        information: Floats = 0.5 * np.einsum("nia,nib->ab", moved, moved)
        return information


def needed(parameters: int, dof: int, tests: int = 1) -> float:
    """Return the noncentrality that an F test at SIGNIFICANCE / ``tests`` finds with POWER."""
    limit = float(f_isf(SIGNIFICANCE / tests, parameters, dof))
    return f_noncentrality(limit, parameters, dof, POWER)


def found_size(
    disturbance: DisplacementPatterns, amount: Floats, fit: float, closure: float
) -> float:
    """Return how many times ``amount`` (m,) must be there to be found, for unit noise.

    ``fit`` and ``closure`` are the noncentralities that the two tests need; infinite when both
    are blind.
    """
    seen = amount @ disturbance.information @ amount / fit
    again = amount @ disturbance.closing @ amount / closure
    best = max(float(seen), float(again))
    blind = disturbance.seen * float(amount @ amount) / max(fit, closure)
    return float(best**-0.5) if best > blind else float("inf")


def worst_unseen(
    disturbance: DisplacementPatterns, std: Floats, fit: float, closure: float
) -> float:
    """Return the largest error, in ``std`` (6, N) for unit noise, of what is not yet found.

    Over all directions of the amounts, components and positions; of the bounds by either test
    and by both together the smallest holds.
    """
    gain = (disturbance.response / std[:, :, None]).reshape(-1, disturbance.response.shape[2])
    fitted, closed = disturbance.information / fit, disturbance.closing / closure
    floor = disturbance.seen / max(fit, closure)
    bounds = [
        factor * _largest(gain, information, floor)
        for factor, information in ((1.0, fitted), (1.0, closed), (2.0, fitted + closed))
    ]
    return float(np.sqrt(np.min(bounds, axis=0).max()))


def _largest(gain: Floats, information: Floats, floor: float) -> Floats:
    """Return the largest (g a)^2 for a' information a = 1, for every row g of ``gain``."""
    values, vectors = np.linalg.eigh(information)
    along = (gain @ vectors) ** 2
    seen = values > floor
    unseen = along[:, ~seen].sum(axis=1) > HARMLESS
    inside: Floats = (along[:, seen] / values[seen]).sum(axis=1)
    largest: Floats = np.where(unseen, np.inf, inside)
    return largest


def drift_error(effects: OrderEffects, std: Floats, dof: int) -> float:
    """Return the largest error of a linear drift that the tests leave unseen, in ``std``."""
    return worst_unseen(effects.drift, std, needed(3, dof), needed(6, dof))


def knock_error(effects: OrderEffects, std: Floats, dof: int) -> float:
    """Return the error of a knock that the tests leave unseen, in ``std``.

    The largest of all directions, components and positions, for all but the worst moments.
    """
    fit, closure = needed(6, dof, len(effects.knocks)), needed(6, dof)
    errors = np.sort([worst_unseen(k, std, fit, closure) for k in effects.knocks])
    return float(errors[int(np.ceil(RANDOM_MOMENTS * len(errors))) - 1])
