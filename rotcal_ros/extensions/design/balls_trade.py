"""Angles, runs and balls: how sure the axis gets by touched balls, and how long that takes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np

from rotcal_ros.adjust.engine import predicted
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.methods.calibration import Calibration, prepare_to_measure
from rotcal_ros.methods.configuration import Configuration, changed
from rotcal_ros.methods.table_balls.method import model, nominal
from rotcal_ros.methods.table_balls.settings import below_the_table
from rotcal_ros.planning.readings import Readings

USUAL: Final = """
method: table_balls
balls_m: [[0.15, 0.0, 0.08], [-0.075, 0.13, 0.04], [-0.075, -0.13, 0.12]]
axis_m: [0.0, 0.0, 0.08]
"""
"""Three balls that are not in a line; the method's usual uncertainties."""
FULL_TURN_DEG: Final = 360.0
AXES: Final = 4
"""Values of a line: two places, two turns."""


@dataclass(frozen=True)
class BallsTrade:
    """A plan with the first ``balls`` at so many ``angles`` of a turn, in so many ``runs``.

    ``centres`` are measured by ``touches`` in ``seconds``. ``place``, m, and ``lean``, rad: the
    largest U (k = 2) of XOC and YOC, AOC and BOC, those of a tilting axis included; ``turn``, rad,
    that of ECC. ``bound``, m: no plan of so many centres gets a place below it.
    """

    balls: int
    angles: int
    runs: int
    centres: int
    touches: int
    seconds: float
    place: float
    lean: float
    turn: float
    bound: float


def balls_trade(
    configuration: Configuration,
    balls: Sequence[int],
    angles: Sequence[int],
    runs: Sequence[int],
    *,
    touch_s: float,
    way_s: float,
    turn_deg_s: float,
) -> tuple[BallsTrade, ...]:
    """Return what each combination takes and gives, the quickest first.

    A touch takes ``touch_s``, the way to a ball ``way_s``, the table turns by ``turn_deg_s``.
    Plans that leave the axis open, or have more balls than the configuration, are left out.
    Raises PlanError when none is left.
    """
    plans = _plans(configuration, balls, angles, runs)
    rows = [_measured(plan, touch_s, way_s, turn_deg_s) for plan in plans]
    if not rows:
        raise PlanError(
            f"{configuration.source}: none of these numbers of balls, angles and runs tells the "
            "axis: allow more angles"
        )
    return tuple(sorted(rows, key=lambda row: row.seconds))


def _plans(
    configuration: Configuration, balls: Sequence[int], angles: Sequence[int], runs: Sequence[int]
) -> Iterator[Calibration]:
    """Yield the plans that tell the axis."""
    places = configuration.plan.balls_m
    for number, count, repeated in product(balls, angles, runs):
        if 3 * number > len(places):
            continue
        changes = (
            f"plan.balls_m={list(places[: 3 * number])}", "plan.table_angles_deg=[]",
            f"plan.table_step_deg={FULL_TURN_DEG / count}", f"plan.table_positions={count}",
            f"plan.runs={repeated}",
        )  # fmt: skip
        try:
            yield prepare_to_measure(changed(configuration, changes))
        except PlanError:
            continue


def _measured(plan: Calibration, touch_s: float, way_s: float, turn_deg_s: float) -> BallsTrade:
    settings, steps = plan.configuration.plan, plan.plan.steps
    see = nominal(plan.configuration, plan.plan)
    read = Readings.of([step.observed(see(step)) for step in steps])
    expanded = COVERAGE_FACTOR * predicted(model(plan.configuration, read)).std
    lines = AXES * (2 if below_the_table(settings.chain) else 1)
    of_lines = expanded[len(expanded) - lines :].reshape(-1, 2, 2)
    count = len(plan.plan.table_angles)
    turned = np.abs(np.diff([step.table_angle for step in steps])).sum() / DEGREE
    touches = sum(step.n_points for step in steps)
    return BallsTrade(
        balls=len(settings.balls_m) // 3,
        angles=count,
        runs=settings.runs,
        centres=len(steps),
        touches=touches,
        seconds=float(touches * touch_s + len(steps) * way_s + turned / turn_deg_s),
        place=float(of_lines[:, 0].max()),
        lean=float(of_lines[:, 1].max()),
        turn=float(expanded[: len(expanded) - lines][-count:].max()),
        bound=float(
            COVERAGE_FACTOR * plan.configuration.solver.sigma_centre_m / np.sqrt(len(steps))
        ),
    )
