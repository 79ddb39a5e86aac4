"""The settings of the balls on the table, without what makes and solves a plan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Final

from rotcal_ros.foundation.settings import expert, group, setting
from rotcal_ros.methods.ball_plate.settings import (
    CENTRE,
    SURFACE,
    TouchProbeSettings,
    points_setting,
)
from rotcal_ros.methods.simulation.settings import SimulationSettings
from rotcal_ros.planning.table_angles import (
    TableAngleSettings,
    passing_setting,
    run_up_setting,
)

DISPLACEMENT: Final = "displacement"
BAR: Final = "bar"
ANY, FALLING, WHITE_ONLY, STATED = "any", "falling", "white", "stated"
"""What may be known of the orders of error motions."""
FARTHEST_M: Final = 20.0
"""No machine with a rotary table is larger."""


@dataclass(frozen=True)
class BallsPlanSettings(TableAngleSettings):
    """Where the balls stand, where the table stops, how often."""

    balls_m: tuple[float, ...] = setting(
        (0.12, 0.0, 0.05), minimum=-FARTHEST_M, maximum=FARTHEST_M, first=True,
        doc="m, x y z of ball 0, then of ball 1 and so on, in the machine's coordinates with the "
        "table at angle 0, to a millimetre",
    )  # fmt: skip
    axis_m: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.0), minimum=-FARTHEST_M, maximum=FARTHEST_M, first=True,
        doc="m, nominal point of the table axis in the machine's coordinates: XOC and YOC are "
        "how far the axis is from it at its height, EXC and EYC are the table's motions there",
    )  # fmt: skip
    ball_diameter_m: float = setting(0.025, doc="m, of the balls", minimum=1e-4, first=True)
    chain: str = setting(
        "C",
        doc="rotary axes from the machine to the work: C alone, or on A or B, which tilts it; '-' "
        "before one that turns clockwise, seen against its direction",
        choices=tuple(f"{below}{c}" for below in ("", "A", "-A", "B", "-B") for c in ("C", "-C")),
    )
    tilts_deg: tuple[float, ...] = setting(
        (), doc="deg, where the tilting axis stops; 0 need not be among them"
    )
    tilt_limits_deg: tuple[float, float] = expert(
        (-120.0, 120.0), doc="deg, between which the tilting axis may stand"
    )
    tilting_axis_m: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.0), minimum=-FARTHEST_M, maximum=FARTHEST_M,
        doc="m, nominal point of the tilting axis: YOA and ZOA (XOB and ZOB) count from it",
    )  # fmt: skip
    runs: int = setting(
        2, minimum=1, maximum=100,
        doc="how often the table goes through its angles; with one ball only a second run checks "
        "anything",
    )  # fmt: skip
    closing: bool = setting(True, doc="measure the first table angle again at the end")
    turns_on: bool = setting(
        True, doc="the table goes on turning from run to run; false: it turns back first"
    )
    measure: str = setting(
        SURFACE, choices=(SURFACE, CENTRE, DISPLACEMENT, BAR), first=True,
        doc="what is measured of a ball: surface (touch points), centre, displacement from a "
        "nest in the spindle that follows it (R-test), or the length of a ball bar to the spindle",
    )  # fmt: skip
    bars_m: tuple[float, ...] = setting(
        (0.1, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.1), minimum=-FARTHEST_M, maximum=FARTHEST_M,
        doc="m, set-ups of a ball bar at each ball: how far outward from the axis, along its way "
        "and up the spindle is, which then turns with it; radial, tangential and axial of 0.1 m",
    )  # fmt: skip
    points_per_ball: int = points_setting(5)
    turning_deg_s: tuple[float, ...] = expert(
        (),
        doc="deg/s, speed at which the table turns in each run while displacements are read, "
        "negative for back; none: it stops at every angle",
    )
    run_up_deg: float = run_up_setting()
    passing_deg: float = passing_setting(1.0)


def below_the_table(chain: str) -> str:
    """Return the axis that tilts the table, A or B; empty: none does."""
    return chain.replace("-", "")[:-1]


def sense_of(chain: str, letter: str) -> float:
    """Return 1 for an axis of the chain that turns counter-clockwise, -1 for the others."""
    return -1.0 if f"-{letter}" in chain else 1.0


@dataclass(frozen=True)
class BallsSolverSettings:
    """How sure a centre is, and what is known about table and machine beforehand."""

    sigma_centre_m: float = setting(
        1e-6, minimum=1e-9, maximum=1e-2, first=True,
        doc="m, standard deviation of each coordinate of a centre, or of a ball bar's length, the "
        "table's repeatability included",
    )  # fmt: skip
    error_motion_std_m: float = setting(
        3e-6, minimum=1e-9, maximum=1e-2, first=True,
        doc="m, standard uncertainty (k = 1) of EXC, EYC and EZC at each angle, which counts "
        "where the balls do not determine them",
    )  # fmt: skip
    tilt_std_arcsec: float = setting(
        3.0, doc="arcsec, the same of EAC and EBC", minimum=1e-3, maximum=3600.0
    )
    error_motion_orders: str = expert(
        ANY, choices=(ANY, FALLING, WHITE_ONLY, STATED),
        doc="how these motions are spread over orders, undulations per turn: in any (the "
        "uncertainty holds the worst that fits), in sizes that are falling as 1 / order to the "
        "tenth, white (another at every angle), or as stated",
    )  # fmt: skip
    radial_orders: tuple[float, ...] = expert(
        (0.0, 1.0), minimum=0.0,
        doc="sizes of EXC and EYC in the orders 1, 2, 3 ..., in relation to each other, if they "
        "are stated",
    )  # fmt: skip
    axial_orders: tuple[float, ...] = expert((1.0,), doc="the same of EZC", minimum=0.0)
    tilt_orders: tuple[float, ...] = expert((0.0, 1.0), doc="the same of EAC and EBC", minimum=0.0)
    squareness_std_um_per_m: float = setting(
        10.0, minimum=1e-3, maximum=1e4,
        doc="um/m, standard uncertainty (k = 1) of the squareness of each pair of linear axes",
    )  # fmt: skip
    scale_std_um_per_m: float = setting(
        10.0, minimum=1e-3, maximum=1e4,
        doc="um/m, standard uncertainty (k = 1) of the length that each linear axis shows",
    )  # fmt: skip
    bar_std_m: float = expert(
        5e-6, minimum=1e-9, maximum=1.0,
        doc="m, standard uncertainty (k = 1) of the ball bar's own length in each set-up",
    )  # fmt: skip
    tip_std_m: float = setting(
        0.0, minimum=0.0, maximum=1e-3,
        doc="m, standard uncertainty (k = 1) of where the probe's tip, or a ball in the spindle, "
        "is in x, y and z; 0: not stated, and not in the uncertainty of the axis",
    )  # fmt: skip
    lag_std_s: float = expert(
        1e-3, minimum=1e-9, maximum=1.0,
        doc="s, standard uncertainty (k = 1) of how late the linear axes, and so the nest, are "
        "behind a table that turns; runs of several speeds determine it without that",
    )  # fmt: skip
    largest_shift_um: ClassVar[
        Annotated[
            float,
            "a drift or a knock by more is seen by anybody at the readings",
        ]
    ] = 100.0


@dataclass(frozen=True)
class SimulatedBallsSettings:
    """The balls as they really stand on the table."""

    balls_m: tuple[float, ...] = setting(
        (0.12, 0.0, 0.05), doc="m, x y z of each ball on the table at angle 0, from its foot"
    )
    ball_diameter_m: float = expert(0.025, doc="m, of the balls", minimum=1e-4)
    placing_mm: float = expert(
        0.3, doc="mm, standard deviation with which a person places them", minimum=0.0
    )
    tilts_deg: tuple[float, ...] = expert(
        (),
        doc="deg, as plan.tilts_deg, as the axis really stands, counter-clockwise; none: no axis "
        "tilts the table",
    )
    tilting_axis: str = expert("A", doc="which axis tilts it", choices=("A", "B"))
    tilting_axis_m: tuple[float, float, float] = expert(
        (0.0, 0.0, 0.0), doc="m, a point of that axis"
    )
    tilting_lean_arcsec: tuple[float, float, float] = expert(
        (0.0, 0.0, 0.0), doc="arcsec, by which that axis is turned about x, y and z"
    )
    bar_error_um: ClassVar[
        Annotated[float, "less than solver.bar_std_m, as of a good ball bar"]
    ] = 3.0
    bar_rate_hz: ClassVar[Annotated[float, "as a wireless ball bar sends"]] = 10.0
    nest_rate_hz: ClassVar[Annotated[float, "as displacement sensors of an R-test send"]] = 100.0
    nest_lag_s: float = expert(
        0.0, doc="s, by which the linear axes, and so the nest, are late behind a table that turns"
    )
    axis_m: tuple[float, float, float] = expert(
        (0.0, 0.0, 0.0), doc="m, about which the nest follows, as plan.axis_m"
    )


@dataclass(frozen=True)
class BallsSimulationSettings(SimulationSettings):
    """The simulated cell of the balls on the table."""

    balls: SimulatedBallsSettings = group(SimulatedBallsSettings)
    touch_probe: TouchProbeSettings = group(TouchProbeSettings)


SETTINGS: Final[Mapping[str, type[Any]]] = {
    "plan": BallsPlanSettings,
    "solver": BallsSolverSettings,
    "simulation": BallsSimulationSettings,
}
"""The groups that this method declares for itself."""
