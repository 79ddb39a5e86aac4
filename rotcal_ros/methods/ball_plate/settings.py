"""The settings of the ball plate method, without what makes and solves a plan.

The plate (a file, or the group ``plan.plate``), the solver, the simulated cell, the plan.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass
from typing import Annotated, Any, ClassVar, Final, get_args

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.settings import expert, group, setting
from rotcal_ros.methods.ball_plate.measuring_order import DEFAULT_ORDER, Order
from rotcal_ros.methods.simulation.settings import SimulationSettings

EXPANSION: Final[Mapping[str, float]] = {
    "steel": 11.5e-6,
    "stainless steel": 17.2e-6,
    "cast iron": 11.4e-6,
    "aluminium": 23.6e-6,
    "duralumin": 22.9e-6,
    "titanium": 8.6e-6,
    "invar": 1.6e-6,
    "super invar": 0.72e-6,
    "alumina": 7.4e-6,
    "zirconia": 9.6e-6,
    "silicon carbide": 4.1e-6,
    "fused silica": 0.4e-6,
    "zerodur": 0.05e-6,
    "cfrp": 1.4e-6,
}
"""How much materials of plates grow near 20 degrees Celsius, 1/K.

They turn a growth into kelvin, for people: nothing is corrected by them. A tenth more or less is
usual from one plate to the next (ISO 3650: 11.5 +- 1.0 for steel).

* steel: ISO 3650:1998, gauge blocks
* zerodur: SCHOTT, expansion class 1, of which this is the limit, with either sign
* cfrp: quasi-isotropic layup, Scientific Reports 14 (2024), 10.1038/s41598-024-65836-1, Table 2;
  other layups from 0 to 4
* all others: W. D. Callister, Materials Science and Engineering, 7th ed., Table B.6 (duralumin:
  2024, aluminium: 6061, titanium: Ti-6Al-4V, stainless steel: 304)
"""
NOT_STATED: Final = ""


def kelvin(growth: float, material: str) -> float | None:
    """Return by how much a plate has warmed that grew by ``growth``; None: material not stated."""
    expansion = EXPANSION.get(material)
    return None if expansion is None else growth / expansion


def grid_setting(default: Any = MISSING, *, doc: str, first: bool = False) -> Any:
    """Declare the number of grid steps of a plate, planned or simulated."""
    return setting(default, doc=doc, minimum=3, maximum=36_000, first=first)


def points_setting(default: int = 15) -> Any:
    """Declare how many touch points a ball gets: a sphere has four unknowns, and needs a check."""
    return setting(
        default, doc="touch points on the upper half of a ball", minimum=5, maximum=1000
    )


@dataclass(frozen=True)
class Plate:
    """A circular ball plate, as a group of settings or as the entries of a plate file.

    Ball ``ball_steps[r]`` stands at the angle 2 pi step / ``grid``, counter-clockwise seen from
    above. ``separate_groups`` allows ball steps that share a factor with the grid (groups of
    positions without a connection). :func:`checked` refuses a plate that cannot be.
    """

    grid: int = grid_setting(
        doc="number of table positions in a turn: the grid that ball_steps counts in", first=True
    )
    ball_steps: tuple[int, ...] = setting(
        doc="grid steps on which balls stand, from 0", minimum=0, first=True
    )
    circle_radius_m: float = setting(
        doc="m, radius of the circle of ball centres", minimum=1e-3, first=True
    )
    ball_diameter_m: float = setting(doc="m, diameter of the balls", minimum=1e-4, first=True)
    name: str = setting("ball plate", doc="name of the plate")
    material: str = setting(
        NOT_STATED, choices=(NOT_STATED, *EXPANSION),
        doc="material of the plate, which turns its growth into kelvin; empty: another one",
    )  # fmt: skip
    separate_groups: bool = expert(
        False, doc="accept a plate whose table positions fall into groups that no ball connects"
    )

    @property
    def places(self) -> Floats:
        """Nominal places (grid, 3) of all steps at table position 0, metres."""
        from rotcal_ros.methods.ball_plate.solver.problem import grid_angles, on_circle

        return self.circle_radius_m * on_circle(grid_angles(self.grid))


def checked(plate: Plate, where: str) -> Plate:
    """Return ``plate``; ConfigurationError for steps off the grid and balls without room.

    And for lengths in millimetres.
    """
    steps = plate.ball_steps
    outside = sorted(step for step in steps if step >= plate.grid)
    if outside:
        raise ConfigurationError(
            f"{where}: ball_steps must lie in 0..{plate.grid - 1}, found {outside}"
        )
    twice = sorted({step for step in steps if steps.count(step) > 1})
    if twice or len(steps) < 3:
        raise ConfigurationError(
            f"{where}: {len(steps)} ball_steps, named twice: {twice}; give at least 3 "
            "different ones"
        )
    if plate.circle_radius_m > 10.0:
        raise ConfigurationError(
            f"{where}: a ball circle with a radius of {plate.circle_radius_m:g} m looks like "
            "millimetres; metres are expected"
        )
    places = np.sort(steps)
    smallest = int(np.diff(places, append=places[0] + plate.grid).min())
    chord = 2.0 * plate.circle_radius_m * np.sin(np.pi * smallest / plate.grid)
    if chord < plate.ball_diameter_m:
        raise ConfigurationError(
            f"{where}: balls {smallest} grid steps apart are {chord:.4f} m apart, less "
            f"than their diameter of {plate.ball_diameter_m:.4f} m; check circle and diameter"
        )
    return plate


CLOSED_FORM: Final = "closed_form"
DRIFTS: Final = ("none", "linear", "quadratic")
"""Drifts that can be estimated along; their places are the degrees in time."""


@dataclass(frozen=True)
class BallPlateSolverSettings:
    """How the ball plate method is solved, and which part of the data is evaluated."""

    variant: str = setting(
        "least_squares", choices=("least_squares", CLOSED_FORM),
        doc="least_squares: of what was measured, with gaps too; closed_form: the means of the "
        "second paper, of as many balls as table positions",
    )  # fmt: skip
    sigma_centre_m: float = setting(
        0.0, minimum=0.0, maximum=1e-2,
        doc="m, known standard deviation of a ball centre; 0: from the residuals",
    )  # fmt: skip
    drift: str = setting(
        "none", choices=DRIFTS,
        doc="drift of the CMM's origin over the run that is estimated, for each axis",
    )  # fmt: skip
    drift_allowance_m: float = setting(
        0.0, minimum=0.0, maximum=1e-3,
        doc="m, drift of the CMM's origin over the run, along each axis, that the uncertainty "
        "covers where it is not estimated; 0: none stated",
    )  # fmt: skip
    group_allowance_m: float = expert(
        0.0, minimum=0.0, maximum=1e-3,
        doc="m, on the circle of the balls: largest difference between the zeros of groups of "
        "table positions (plan.plate.separate_groups); 0: none stated, the difference is unknown",
    )  # fmt: skip
    sigma_axes_m: tuple[float, ...] = expert(
        (), minimum=0.0, maximum=1e-2,
        doc="m, known standard deviations of a ball centre in x, y, z; empty: the same in all",
    )  # fmt: skip
    own_std: bool = expert(
        False, doc="weight every centre by the standard deviation that the machine states for it"
    )
    balls: tuple[int, ...] = expert(
        (), doc="ball steps to evaluate, on the grid of the plate; empty: all", minimum=0
    )
    cmm_positions: tuple[int, ...] = expert(
        (), doc="CMM positions to evaluate, on the grid of the plate; empty: all", minimum=0
    )
    coarser: int = expert(
        1, doc="evaluate only every n-th step of the grid", minimum=1, maximum=1000
    )

    def __post_init__(self) -> None:
        if not self.sigma_axes_m:
            return
        if len(self.sigma_axes_m) != 3 or min(self.sigma_axes_m) <= 0.0:
            raise ConfigurationError(
                f"sigma_axes_m: expected three positive lengths (x, y, z), found "
                f"{list(self.sigma_axes_m)}"
            )
        if self.sigma_centre_m:
            raise ConfigurationError("give sigma_centre_m or sigma_axes_m, not both")


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
    azimuth_deg: float = expert(
        0.0, doc="deg, direction of ball step 0 from the table's x axis at angle 0"
    )
    manufacture_um: float = expert(
        5.0, doc="um, standard deviation of a ball's place along each axis", minimum=0.0
    )
    clamping_shift_um: tuple[float, float, float] = expert(
        (0.0, 0.0, 0.0), doc="um, shift of the plate on the table"
    )
    clamping_turn_arcsec: tuple[float, float, float] = expert(
        (0.0, 0.0, 0.0), doc="arcsec, turn of the plate on the table about x, y and z"
    )


@dataclass(frozen=True)
class TouchProbeSettings:
    """The coordinate measuring machine that touches the balls."""

    initial_position_m: tuple[float, float, float] = expert(
        (0.3, 0.0, 0.2), doc="m, place of the tip at the start"
    )
    points_per_ball: int = points_setting()
    tip_radius_m: float = expert(0.0015, doc="m, radius of the probe tip", minimum=0.0)
    squareness_um_per_m: tuple[float, float, float] = expert(
        (0.0, 0.0, 0.0), doc="um/m, by which x reads more per y, x more per z, y more per z"
    )
    scale_um_per_m: tuple[float, float, float] = expert(
        (0.0, 0.0, 0.0), doc="um/m, by which x, y and z read more"
    )
    lobing_um: float = expert(
        0.0, doc="um, amplitude of the probe's error over the direction of a touch, of order 3"
    )
    systematic_um: float = setting(
        1.0, doc="um, standard deviation of the machine's error along each axis", minimum=0.0
    )
    wavelength_m: ClassVar[
        Annotated[float, "a share of the travel, as of a machine's guideways and scales"]
    ] = 0.25
    noise_um: float = setting(
        0.2, doc="um, standard deviation of a touch point along each axis", minimum=0.0
    )
    dirt_probability: float = expert(
        0.0, doc="probability that dirt lies under a touch", minimum=0.0, maximum=1.0
    )
    dirt_um: ClassVar[
        Annotated[
            float,
            "a common dust grain; dirt_probability says whether there is any",
        ]
    ] = 8.0
    speed_m_s: float = expert(0.1, doc="m/s, largest speed", minimum=1e-6)
    acceleration_m_s2: float = expert(0.5, doc="m/s^2, acceleration", minimum=1e-6)
    clearance_m: float = expert(
        0.05, doc="m, height above the balls at which the tip travels", minimum=0.0
    )
    settling_time_s: float = expert(
        1.0, doc="s, wait after the last motion before the first touch", minimum=0.0
    )
    touch_time_s: float = expert(1.5, doc="s, from one touch to the next", minimum=1e-3)


@dataclass(frozen=True)
class PlateSimulationSettings(SimulationSettings):
    """The simulated cell of the ball plate method."""

    instrument: str = expert(
        TOUCH_PROBE, doc="a machine that touches the balls of a plate", choices=(TOUCH_PROBE,)
    )
    plate: SimulatedPlateSettings = group(SimulatedPlateSettings)
    touch_probe: TouchProbeSettings = group(TouchProbeSettings)


SURFACE: Final = "surface"
CENTRE: Final = "centre"


@dataclass(frozen=True)
class BallPlatePlanSettings:
    """The plate, where it stands, and the order in which its balls are measured."""

    plate: Plate = setting(doc="the ball plate")
    centre_m: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.0), first=True,
        doc="m, point of the table axis at the height of the balls, in the machine frame",
    )  # fmt: skip
    table_start_deg: float = setting(
        0.0, first=True,
        doc="deg, table angle of table position 0, at which ball step 0 lies on the +x side",
    )  # fmt: skip
    cmm_positions: tuple[int, ...] = expert(
        (), doc="grid steps at which balls are measured; empty: all", minimum=0
    )
    order: str = setting(
        DEFAULT_ORDER, choices=get_args(Order),
        doc="interleaved: at every stop a share of the balls, in several turns of the table; "
        "table_once: all balls in one turn; probe_rests: the table brings the balls to the probe "
        "(paper)",
    )  # fmt: skip
    rounds: int = setting(
        0, minimum=0, maximum=100,
        doc="turns of the table: interleaved, each for a share of the balls; table_once, each "
        "for a share of the CMM positions; 0: as many as the order needs (4 and 1)",
    )  # fmt: skip
    closing: bool = setting(True, doc="measure the first table position again at the end")
    backlash: bool = setting(True, doc="approach all angles in the positive direction")
    bidirectional: bool = setting(
        False,
        doc="measure every turn of the table upward, and again downward, with all angles "
        "approached from the other side",
    )
    measure: str = setting(
        SURFACE, choices=(SURFACE, CENTRE), first=True,
        doc="what the machine publishes of a ball: surface (touch points) or centre",
    )  # fmt: skip
    points_per_ball: int = points_setting()


SETTINGS: Final[Mapping[str, type[Any]]] = {
    "plan": BallPlatePlanSettings,
    "solver": BallPlateSolverSettings,
    "simulation": PlateSimulationSettings,
}
"""The groups that this method declares for itself."""
