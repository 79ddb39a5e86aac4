"""What a drift of the CMM, a knock or a growth of the plate would do in a planned order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.adjust.closures import ClosureTest
from rotcal_ros.adjust.distributions import noncentrality
from rotcal_ros.adjust.effects import ObservableEffect, ObservableFamily, largest_undetected
from rotcal_ros.adjust.engine import LIMITS
from rotcal_ros.adjust.fit import Fit, fit_model
from rotcal_ros.adjust.model import Disturbing
from rotcal_ros.adjust.observable import observe_columns
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.protection import POWER
from rotcal_ros.methods.ball_plate.measuring_order import BallPlan
from rotcal_ros.methods.ball_plate.solver.layout import PlateLayout
from rotcal_ros.methods.ball_plate.solver.plate_model import (
    LARGEST,
    RANDOM_MOMENTS,
    PlateRows,
    drift_columns,
    plate_model,
    plate_motion,
)
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, on_circle

AXES: Final = ("x", "y", "z")
MOMENTS: Final = 40
"""Moments at which a knock is looked at, evenly over the run."""


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


def forecast_order(plan: BallPlan, sigma: float, radius: float) -> OrderForecast:
    """Predict drift, knocks and growth for a plan.

    ``sigma`` of a centre coordinate and ``radius`` in m.
    Raises ObservabilityError when the plan does not separate the errors.
    """
    row = np.arange(len(plan.position))
    problem = BallPlateProblem.nominal(
        plan.grid, radius, plan.position, plan.ball_step, row=row, sigma=sigma
    )
    layout = PlateLayout(problem)
    model, rows = plate_model(layout), PlateRows(layout)
    fit = fit_model(model, np.ones(len(model.observed), dtype=np.bool_), model.std, model.first)
    std, significance = fit.counting(fit.noise_std), LIMITS.of_each_effect(model)
    closed = [ClosureTest(fit, relation) for relation in model.closures]

    def seen_of(displacements: Floats) -> ObservableEffect:
        columns = rows.of(displacements)
        seen: ObservableEffect | ObservableFamily = observe_columns(fit, columns)
        for each in closed:
            seen = each.beside(Disturbing("drift", "", columns, LARGEST), seen)
        assert isinstance(seen, ObservableEffect)
        return seen

    drift = seen_of(drift_columns(rows.time, 1))
    motion = plate_motion(problem)[layout.row]
    moments = np.unique(np.ceil((np.arange(MOMENTS) + 0.5) / MOMENTS * len(row)))
    knocks = [
        seen_of(motion * (np.arange(len(row)) >= moment)[:, None, None]) for moment in moments
    ]
    places = radius * on_circle(problem.angles[problem.cmm_index[layout.row]])
    growth = seen_of((rows.time[:, None] * places)[:, :, None])
    single = len(moments) * 6
    drifts = [_effect(fit, "drift", a, a, [drift], 1.0, significance) for a in range(3)]
    moves = [
        _effect(fit, kind, axis, first + axis, knocks, length, significance / single)
        for kind, first, length in (("shift", 0, 1.0), ("turn", 3, radius))
        for axis in range(3)
    ]
    errors = [
        largest_undetected(
            each, std, LARGEST, significance=significance / len(moments), power=POWER
        ).error
        for each in knocks
    ]
    return OrderForecast(
        effects=(*drifts, *moves),
        growth=_effect(fit, "growth", None, 0, [growth], 1.0, significance),
        drift_unseen=largest_undetected(
            drift, std, LARGEST, significance=significance, power=POWER
        ).error,
        knock_unseen=errors[_bad_moment(np.array(errors))],
    )


def _bad_moment(errors: Floats) -> int:
    """Return the moment whose error all but the worst moments do not exceed."""
    return int(np.argsort(errors)[int(np.ceil(RANDOM_MOMENTS * len(errors))) - 1])


def _effect(
    fit: Fit,
    kind: str,
    axis: int | None,
    column: int,
    each: list[ObservableEffect],
    length: float,
    significance: float,
) -> UnitEffect:
    """Return a ``column`` of effects, worth ``length`` m per unit, at a bad moment of several."""
    count = len(fit.model.outputs)
    moved = np.abs([seen.moved[:][column, :count] for seen in each])
    shown = np.array([seen.information[column, column] for seen in each])
    whole = np.array([seen.whole[column] for seen in each])
    needed = np.sqrt(noncentrality(significance, POWER, 1, np.inf))
    checked = shown > 1e-9 * whole
    sizes = np.where(checked, needed / np.sqrt(np.where(checked, shown, 1.0)), np.inf)
    relative = (moved / fit.noise_std[:count]).max(axis=1)
    # a size may be infinite: where nothing is in error 0 inf would not be a number
    hidden = np.where(
        relative > 1e-9 / LARGEST, relative * np.where(relative > 0.0, sizes, 0.0), 0.0
    )
    moment = _bad_moment(hidden)
    largest = length * moved[moment].reshape(len(COMPONENTS), -1).max(axis=1)
    return UnitEffect(
        kind=kind,
        axis="" if axis is None else AXES[axis],
        error=dict(zip(COMPONENTS, largest.tolist(), strict=True)),
        found_from=float(sizes[moment]) / length,
        unseen=float(hidden[moment]),
    )
