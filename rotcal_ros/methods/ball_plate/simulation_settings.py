"""The settings of a simulated ball plate and of the machine that touches its balls."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from rotcal_ros.foundation.settings import group, setting
from rotcal_ros.methods.ball_plate.plate import grid_setting, points_setting
from rotcal_ros.methods.simulation.settings import SimulationSettings

TOUCH_PROBE: Final = "touch_probe"


@dataclass(frozen=True)
class SimulatedPlateSettings:
    """The ball plate as it really is: its balls, how well it is made, how it is clamped."""

    grid: int = grid_setting(72, doc="number of grid steps in a turn")
    ball_steps: tuple[int, ...] = setting(
        (0, 8, 12, 18, 21, 28, 32, 37, 42, 50, 58, 62), doc="grid steps of the balls", minimum=0
    )
    circle_radius_m: float = setting(0.185, doc="m, radius of the ball circle", minimum=1e-3)
    ball_diameter_m: float = setting(0.025, doc="m, diameter of the balls", minimum=1e-4)
    azimuth_deg: float = setting(
        0.0, doc="deg, direction of ball step 0 from the table's x axis at angle 0"
    )
    manufacture_um: float = setting(
        5.0, doc="um, standard deviation of a ball's place along each axis", minimum=0.0
    )
    clamping_shift_um: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.0), doc="um, shift of the plate on the table"
    )
    clamping_turn_arcsec: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.0), doc="arcsec, turn of the plate on the table about x, y and z"
    )


@dataclass(frozen=True)
class TouchProbeSettings:
    """The coordinate measuring machine that touches the balls."""

    initial_position_m: tuple[float, float, float] = setting(
        (0.3, 0.0, 0.2), doc="m, place of the tip at the start"
    )
    points_per_ball: int = points_setting()
    tip_radius_m: float = setting(0.0015, doc="m, radius of the probe tip", minimum=0.0)
    systematic_um: float = setting(
        1.0, doc="um, standard deviation of the machine's error along each axis", minimum=0.0
    )
    wavelength_m: float = setting(
        0.25, doc="m, distance over which the machine's error changes", minimum=1e-3
    )
    noise_um: float = setting(
        0.2, doc="um, standard deviation of a touch point along each axis", minimum=0.0
    )
    dirt_probability: float = setting(
        0.0, doc="probability that dirt lies under a touch", minimum=0.0, maximum=1.0
    )
    dirt_um: float = setting(8.0, doc="um, thickness of the dirt", minimum=0.0)
    speed_m_s: float = setting(0.1, doc="m/s, largest speed", minimum=1e-6)
    acceleration_m_s2: float = setting(0.5, doc="m/s^2, acceleration", minimum=1e-6)
    clearance_m: float = setting(
        0.05, doc="m, height above the balls in which the tip travels", minimum=0.0
    )
    settling_time_s: float = setting(
        1.0, doc="s, wait after the last motion before the first touch", minimum=0.0
    )
    touch_time_s: float = setting(1.5, doc="s, from one touch to the next", minimum=1e-3)


@dataclass(frozen=True)
class PlateSimulationSettings(SimulationSettings):
    """The simulated cell of the ball plate method."""

    instrument: str = setting(
        TOUCH_PROBE, doc="a machine that touches the balls of a plate", choices=(TOUCH_PROBE,)
    )
    plate: SimulatedPlateSettings = group(SimulatedPlateSettings)
    touch_probe: TouchProbeSettings = group(TouchProbeSettings)
