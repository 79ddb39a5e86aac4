"""The plan of the ball plate method: which ball at which table position, step by step."""

from __future__ import annotations

from typing import cast

import numpy as np

from rotcal_ros.foundation.errors import ConfigurationError, PlanError
from rotcal_ros.foundation.observations import Approach, PointKind
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.methods.ball_plate.measuring_order import (
    BallPlan,
    Kinematics,
    Order,
    plan_measurement,
)
from rotcal_ros.methods.ball_plate.settings import (
    CLOSED_FORM,
    SURFACE,
    BallPlatePlanSettings,
    checked,
)
from rotcal_ros.methods.ball_plate.solver.problem import position_of
from rotcal_ros.methods.ball_plate.solver.result import METHOD, MOST_OPEN
from rotcal_ros.methods.ball_plate.solver.separability import MIN_BALLS, common_divisor
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.planning.plan import Plan, Point, Step
from rotcal_ros.planning.table_angles import planned_arrivals


def plan(configuration: Configuration) -> Plan:
    """Return the plan of a ball plate configuration.

    Raises ConfigurationError when the solver is to evaluate balls or positions off the plan.
    """
    settings: BallPlatePlanSettings = configuration.plan
    planned, solver = ball_plate_plan(settings), configuration.solver
    positions = settings.cmm_positions or range(settings.plate.grid)
    for name, wanted, known in (
        ("balls", solver.balls, settings.plate.ball_steps),
        ("cmm_positions", solver.cmm_positions, positions),
    ):
        if missing := sorted(set(wanted) - set(known)):
            raise ConfigurationError(
                f"{configuration.source}: solver.{name}: {missing} are not in the plan: choose "
                f"among {list(known)}"
            )
    if settings.plate.grid % solver.coarser:
        raise ConfigurationError(
            f"{configuration.source}: solver.coarser = {solver.coarser} does not divide the grid "
            f"of {settings.plate.grid} steps: choose a divisor of it"
        )
    return planned


def check_plan(configuration: Configuration, planned: Plan) -> None:
    """Raise PlanError where too many table positions would have too few balls to be solved.

    Or where the closed form is asked for of fewer balls than it needs.
    """
    settings, solver = configuration.plan, configuration.solver
    balls = np.array(solver.balls or settings.plate.ball_steps)
    needed = settings.plate.grid // common_divisor(settings.plate.grid, balls)
    if solver.variant == CLOSED_FORM and (len(balls) < needed or settings.cmm_positions):
        raise PlanError(
            f"solver.variant = {CLOSED_FORM} needs as many balls as positions, {needed}, and all "
            f"CMM positions; {len(balls)} balls are to be evaluated: measure more, or leave it out"
        )
    seen = {(step.table_position, step.target) for step in planned.steps}
    grid = len(planned.table_angles)
    count = np.bincount([position for position, _ in seen], minlength=grid)
    poor = np.flatnonzero(count < MIN_BALLS)
    if len(poor) > MOST_OPEN * grid:
        raise PlanError(
            f"fewer than {MIN_BALLS} balls are measured at {len(poor)} of {grid} "
            f"table positions, such as {poor[0]}, which leaves their errors open: name more "
            "cmm_positions, or none for all"
        )


def ball_plate_plan(settings: BallPlatePlanSettings) -> Plan:
    """Return the plan of one ball plate calibration.

    The targets are the places of all grid steps at table position 0; a step's target is the
    ball's grid step. With ``bidirectional`` table position 2 N - 1 - i stands at the angle of
    position i, reached from above. Raises ConfigurationError for a plate that cannot be, PlanError
    for CMM positions outside the grid, and for both directions without backlash.
    """
    plate = checked(settings.plate, "plan.plate")
    order = measuring_order(settings)
    places = np.array(settings.centre_m) + plate.places
    touched = settings.measure == SURFACE
    every = planned_arrivals(plate.grid, runs=1, bidirectional=settings.bidirectional)
    turns = np.round(order.table_angle / (2.0 * np.pi / plate.grid)).astype(np.int64)
    numbers = position_of(order.position, order.upward, plate.grid)
    columns = (turns, numbers, order.ball_step, order.cmm_index)
    rows = zip(*(column.tolist() for column in columns), strict=True)
    steps = tuple(
        Step(
            index=index,
            table_position=number,
            table_angle=_angle(settings, turn),
            approach=every[number].approach if settings.backlash else Approach.UNKNOWN,
            kind=PointKind.SURFACE if touched else PointKind.CENTRE,
            target=ball,
            position=_point(places[position]),
            n_points=settings.points_per_ball if touched else 1,
            ball_diameter=plate.ball_diameter_m,
        )
        for index, (turn, number, ball, position) in enumerate(rows)
    )
    return Plan(
        method=METHOD,
        table_angles=tuple(_angle(settings, visit.target) for visit in every),
        targets=tuple(_point(place) for place in places),
        steps=steps,
    )


def measuring_order(
    settings: BallPlatePlanSettings, kinematics: Kinematics | None = None
) -> BallPlan:
    """Return the rows of the plan with its table travel and predicted duration."""
    return plan_measurement(
        settings.plate.grid,
        list(settings.plate.ball_steps),
        positions=list(settings.cmm_positions) or None,
        order=cast("Order", settings.order),
        rounds=settings.rounds,
        closing=settings.closing,
        backlash=settings.backlash,
        bidirectional=settings.bidirectional,
        radius=settings.plate.circle_radius_m,
        kinematics=kinematics,
    )


def _angle(settings: BallPlatePlanSettings, turn: int) -> float:
    return settings.table_start_deg * DEGREE + 2.0 * np.pi * turn / settings.plate.grid


def _point(place: np.ndarray) -> Point:
    x, y, z = place.tolist()
    return x, y, z
