"""The plan of the ball plate method: which ball at which table position, step by step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.catalogue.configuration import Configuration
from rotcal_ros.errors import ConfigurationError
from rotcal_ros.methods.ball_plate.plate import Plate, checked
from rotcal_ros.methods.ball_plate.solve import METHOD
from rotcal_ros.observations import Approach, PointKind
from rotcal_ros.planning.ball_plan import BallPlan, Kinematics, plan_measurement
from rotcal_ros.planning.plan import Plan, Point, Step
from rotcal_ros.settings import setting
from rotcal_ros.units import DEGREE

SURFACE: Final = "surface"
CENTRE: Final = "centre"


@dataclass(frozen=True)
class BallPlatePlanSettings:
    """The plate, where it stands, and the order in which its balls are measured."""

    plate: Plate = setting(doc="the ball plate")
    centre_m: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.0), doc="m, machine frame: point of the axis at the height of the balls"
    )
    table_start_deg: float = setting(
        0.0, doc="deg, table angle at which ball step 0 lies on the +x side; table position 0"
    )
    cmm_positions: tuple[int, ...] = setting(
        (), doc="grid steps at which balls are measured; empty: all", minimum=0
    )
    order: str = setting(
        "table_once",
        doc="the table goes around and the probe visits the balls, or the probe rests (paper)",
        choices=("table_once", "probe_rests"),
    )
    rounds: int = setting(
        1,
        doc="turns of the table, each for a share of the CMM positions: early results",
        minimum=1,
        maximum=100,
    )
    backlash: bool = setting(True, doc="approach all angles in the positive direction")
    measure: str = setting(
        SURFACE, doc="touch points, or centres from the machine", choices=(SURFACE, CENTRE)
    )
    points_per_ball: int = setting(
        15, doc="touch points on the upper half of a ball", minimum=5, maximum=1000
    )


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
                f"{configuration.source}: solver.{name}: {missing} are not in the plan, which has "
                f"{list(known)}"
            )
    if settings.plate.grid % solver.coarser:
        raise ConfigurationError(
            f"{configuration.source}: solver.coarser = {solver.coarser} does not divide the grid "
            f"of {settings.plate.grid} steps"
        )
    return planned


def ball_plate_plan(settings: BallPlatePlanSettings) -> Plan:
    """Return the plan of one ball plate calibration.

    The targets are the places of all grid steps at table position 0; a step's target is the
    ball's grid step. Raises ConfigurationError for a plate that cannot be, PlanError for CMM
    positions outside the grid.
    """
    plate = checked(settings.plate, "plan.plate")
    order = measuring_order(settings)
    places = np.array(settings.centre_m) + plate.places
    touched = settings.measure == SURFACE
    turns = np.round(order.table_angle / (2.0 * np.pi / plate.grid)).astype(np.int64)
    rows = zip(turns.tolist(), order.ball_step.tolist(), order.cmm_index.tolist(), strict=True)
    steps = tuple(
        Step(
            index=number,
            table_position=turn % plate.grid,
            table_angle=_angle(settings, turn),
            approach=Approach.POSITIVE if settings.backlash else Approach.UNKNOWN,
            kind=PointKind.SURFACE if touched else PointKind.CENTRE,
            target=ball,
            position=_point(places[position]),
            n_points=settings.points_per_ball if touched else 1,
            ball_diameter=plate.ball_diameter_m,
        )
        for number, (turn, ball, position) in enumerate(rows)
    )
    return Plan(
        method=METHOD,
        table_angles=tuple(_angle(settings, turn) for turn in range(plate.grid)),
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
        order="probe_rests" if settings.order == "probe_rests" else "table_once",
        rounds=settings.rounds,
        backlash=settings.backlash,
        radius=settings.plate.circle_radius_m,
        kinematics=kinematics,
    )


def _angle(settings: BallPlatePlanSettings, turn: int) -> float:
    return settings.table_start_deg * DEGREE + 2.0 * np.pi * turn / settings.plate.grid


def _point(place: np.ndarray) -> Point:
    x, y, z = place.tolist()
    return x, y, z
