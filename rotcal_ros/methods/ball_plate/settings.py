"""The settings of the ball plate method, without what makes and solves a plan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, get_args

from rotcal_ros.foundation.settings import setting
from rotcal_ros.methods.ball_plate.design.ball_plan import DEFAULT_ORDER, Order
from rotcal_ros.methods.ball_plate.plate import Plate, points_setting
from rotcal_ros.methods.ball_plate.simulation_settings import PlateSimulationSettings
from rotcal_ros.methods.ball_plate.solver_settings import BallPlateSolverSettings

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
        DEFAULT_ORDER,
        doc="a share of the balls at every stop in several turns, or all balls in one turn of "
        "the table, or the probe rests (paper)",
        choices=get_args(Order),
    )
    rounds: int = setting(
        0,
        doc="turns of the table: interleaved, each for a share of the balls; table_once, each "
        "for a share of the CMM positions; 0: as many as the order asks for (4 and 1)",
        minimum=0,
        maximum=100,
    )
    closing: bool = setting(True, doc="measure the first table position again at the end")
    backlash: bool = setting(True, doc="approach all angles in the positive direction")
    bidirectional: bool = setting(
        False,
        doc="measure every turn of the table upward and, all angles from the other side, downward",
    )
    measure: str = setting(
        SURFACE, doc="touch points, or centres from the machine", choices=(SURFACE, CENTRE)
    )
    points_per_ball: int = points_setting()


SETTINGS: Final[Mapping[str, type[Any]]] = {
    "plan": BallPlatePlanSettings,
    "solver": BallPlateSolverSettings,
    "simulation": PlateSimulationSettings,
}
"""The groups that this method declares for itself."""
