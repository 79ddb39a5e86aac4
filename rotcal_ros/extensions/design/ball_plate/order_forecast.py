"""What a drift of the CMM, a knock or a growth of the plate would do in a planned order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.methods.ball_plate.measuring_order import BallPlan
from rotcal_ros.methods.ball_plate.solver.estimate import solved
from rotcal_ros.methods.ball_plate.solver.growth import unit_growth
from rotcal_ros.methods.ball_plate.solver.order_effects import (
    DisplacementPatterns,
    bad_moment,
    drift_error,
    found_size,
    knock_error,
    needed,
    order_effects,
)
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem
from rotcal_ros.methods.ball_plate.solver.repeated_stops import closing_apart

AXES = ("x", "y", "z")


@dataclass(frozen=True)
class UnitEffect:
    """One disturbance: ``kind`` is drift, shift, turn or growth, ``axis`` x, y or z, if any.

    ``error`` has the largest error of each component, m or rad per metre of drift or shift, per
    radian of turn or per unit of growth; ``found_from``, m, rad or 1, is the size that the tests
    find with a probability of POWER, infinite where they are blind, and ``unseen`` the error there
    in standard deviations. A shift or turn of the plate is taken at a bad moment: 95 % are no
    worse.
    """

    kind: str
    axis: str
    error: dict[str, float]
    found_from: float
    unseen: float


@dataclass(frozen=True)
class OrderForecast:
    """The unit effects of an order, and the largest errors that drift and knocks leave unseen.

    The latter, in standard deviations, are over all directions together. ``growth`` is that of
    the plate over the run.
    """

    effects: tuple[UnitEffect, ...]
    growth: UnitEffect
    drift_unseen: float
    knock_unseen: float


def forecast(plan: BallPlan, sigma: float, radius: float) -> OrderForecast:
    """Predict drift, knocks and growth for a plan.

    ``sigma`` of a centre coordinate and ``radius`` in m.
    Raises ObservabilityError when the plan does not separate the errors.
    """
    row = np.arange(len(plan.position))
    once, closing = closing_apart(
        BallPlateProblem.nominal(plan.grid, radius, plan.position, plan.ball_step, row=row)
    )
    linear, solution = solved(once)
    std, dof = solution.unit_std.curves(), solution.dof
    effects = order_effects(once, closing)
    closure = needed(6, dof)
    drifts = [
        _effect("drift", a, [effects.drift], np.eye(3)[a], 1.0, std, needed(3, dof), closure)
        for a in range(3)
    ]
    unit, fit = np.eye(6), needed(6, dof, len(effects.knocks))
    knocks = [
        _effect(kind, a, effects.knocks, unit[start + a], length, std, fit, closure)
        for kind, start, length in (("shift", 0, 1.0), ("turn", 3, radius))
        for a in range(3)
    ]
    tests = 1 if closing is None else 2  # the closing rows have a test of their own
    growing = needed(1, dof, tests)
    grown = unit_growth(once, linear, closing)
    growth = _effect("growth", None, [grown], np.ones(1), 1.0, std, growing, growing)
    # sizes were found for unit noise
    *units, growth = (
        replace(e, found_from=sigma * e.found_from) for e in (*drifts, *knocks, growth)
    )
    return OrderForecast(
        effects=tuple(units),
        growth=growth,
        drift_unseen=drift_error(effects, std, dof),
        knock_unseen=knock_error(effects, std, dof),
    )


def _effect(
    kind: str,
    axis: int | None,
    patterns: Sequence[DisplacementPatterns],
    amount: Floats,
    length: float,
    std: Floats,
    fit: float,
    closure: float,
) -> UnitEffect:
    """Return the effect of ``amount`` (m,), worth ``length`` m per unit, at a bad moment."""
    errors = [np.abs(p.response @ amount) for p in patterns]
    sizes = np.array([found_size(p, amount, fit, closure) for p in patterns])
    relative = np.array([np.max(error / std) for error in errors])
    # a size may be infinite: where nothing is in error 0 inf would not be a number
    unseen = np.where(relative > 0.0, relative * np.where(relative > 0.0, sizes, 0.0), 0.0)
    moment = bad_moment(unseen)
    largest = length * errors[moment].max(axis=1)
    return UnitEffect(
        kind=kind,
        axis="" if axis is None else AXES[axis],
        error=dict(zip(COMPONENTS, largest.tolist(), strict=True)),
        found_from=float(sizes[moment]) / length,
        unseen=float(unseen[moment]),
    )
