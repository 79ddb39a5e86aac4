"""The settings of the ball plate method, without what makes and solves a plan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, get_args

from rotcal_ros.foundation.settings import setting
from rotcal_ros.methods.ball_plate.measuring_order import DEFAULT_ORDER, Order
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
        (0.0, 0.0, 0.0),
        doc="m, point of the table axis at the height of the balls, in the machine frame",
        first=True,
    )
    table_start_deg: float = setting(
        0.0,
        doc="deg, table angle of table position 0, at which ball step 0 lies on the +x side",
        first=True,
    )
    cmm_positions: tuple[int, ...] = setting(
        (), doc="grid steps at which balls are measured; empty: all", minimum=0
    )
    order: str = setting(
        DEFAULT_ORDER,
        doc="interleaved: at every stop a share of the balls, in several turns of the table; "
        "table_once: all balls in one turn; probe_rests: the table brings the balls to the probe "
        "(paper)",
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
        doc="measure every turn of the table upward, and again downward, with all angles "
        "approached from the other side",
    )
    measure: str = setting(
        SURFACE,
        doc="what the machine publishes of a ball: surface (touch points) or centre",
        choices=(SURFACE, CENTRE),
        first=True,
    )
    points_per_ball: int = points_setting()


SETTINGS: Final[Mapping[str, type[Any]]] = {
    "plan": BallPlatePlanSettings,
    "solver": BallPlateSolverSettings,
    "simulation": PlateSimulationSettings,
}
"""The groups that this method declares for itself."""
