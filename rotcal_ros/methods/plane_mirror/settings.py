"""The settings of the plane-mirror method, without what makes and solves a plan.

The solver, the simulated tracker and mirror, the plan.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Final, Literal, get_args

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.settings import expert, group, setting
from rotcal_ros.methods.simulation.settings import SimulationSettings
from rotcal_ros.planning.table_angles import TableAngleSettings

Way = Literal["direct", "stitching", "registration", "joint"]
WAYS: Final[tuple[Way, ...]] = get_args(Way)
DIRECT: Final = "direct"
STITCHING: Final = "stitching"
JOINT: Final = "joint"
INCIDENCE_LIMIT_DEG: Final = 50.0
"""Usual limit of the angle between beam and mirror normal; a tracker sees little beyond."""


@dataclass(frozen=True)
class MirrorSolverSettings:
    """How the plane-mirror method is solved, and how well the tracker measures."""

    way: Way = setting(
        "joint",
        doc="all points in one least squares (joint), or as the paper has it: reflectors on the "
        "table (direct), how stations with a mirror are joined (stitching, registration)",
    )
    range_std_m: float = setting(
        2.5e-6, minimum=0.0, maximum=1e-2, first=True,
        doc="m, standard deviation of a tracker point along the beam, at distance 0",
    )  # fmt: skip
    range_std_relative: float = setting(
        0.25e-6, minimum=0.0, maximum=1e-2,
        doc="m/m, growth of the standard deviation along the beam with the distance",
    )  # fmt: skip
    transverse_std_m: float = setting(
        3.75e-6, minimum=0.0, maximum=1e-2, first=True,
        doc="m, standard deviation of a tracker point across the beam, at distance 0",
    )  # fmt: skip
    transverse_std_relative: float = setting(
        1.5e-6, minimum=0.0, maximum=1e-2,
        doc="m/m, growth of the standard deviation across the beam with the distance",
    )  # fmt: skip
    mirror_slope_std_arcsec: float = setting(
        0.0, minimum=0.0, maximum=3600.0, first=True,
        doc="arcsec, flatness of the mirror, as standard deviation of its slope from spot to spot",
    )  # fmt: skip
    tilt_std_arcsec: float = expert(
        1.0, minimum=1e-6, maximum=3600.0,
        doc="arcsec, standard deviation of the table's tilts (EAC, EBC) that is assumed",
    )  # fmt: skip
    uneven_drift_std_arcsec: float = expert(
        0.5, minimum=0.0, maximum=3600.0,
        doc="arcsec, standard deviation (k = 1) of the tracker's azimuth about the straight line "
        "between two rounds of nests that are a station apart; it is part of the uncertainty",
    )  # fmt: skip
    significance: ClassVar[
        Annotated[
            float,
            "two false alarms in a hundred sound results: of the noise, all groups, all effects "
            "each",
        ]
    ] = 0.005

    def __post_init__(self) -> None:
        for name in ("range_std", "transverse_std"):
            if getattr(self, f"{name}_m") + getattr(self, f"{name}_relative") <= 0.0:
                raise ConfigurationError(
                    f"{name}_m and {name}_relative are both 0: state the tracker's noise"
                )


TRACKER: Final = "tracker"


@dataclass(frozen=True)
class SimulatedMirrorSettings:
    """The mirror on the table as it really is, not as the plan has it."""

    centre_m: tuple[float, float, float] = setting(
        (0.05, 0.0, 0.15), doc="m, middle of the glass in the table frame at angle 0"
    )
    azimuth_deg: float = setting(0.0, doc="deg, direction of the normal with the table at angle 0")
    lean_deg: float = setting(
        1.4, doc="deg, the normal above the plane of rotation", minimum=-45.0, maximum=45.0
    )
    size_m: tuple[float, float] = setting(
        (0.1, 0.1), doc="m, width and height of the glass", minimum=0.001, maximum=10.0
    )
    sag_um: float = setting(0.0, doc="um, how far the edges are above the middle of the glass")
    twist_um: float = setting(0.0, doc="um, how far two opposite corners are above the others")


@dataclass(frozen=True)
class TrackerSettings:
    """The laser tracker, and the person who moves it and puts up its reflectors."""

    station_azimuths_deg: tuple[float, ...] = expert(
        (0.0,), doc="deg, direction of each station from the table axis"
    )
    station_radius_m: float = expert(2.0, doc="m, distance from the axis", minimum=0.1)
    station_height_m: float = expert(0.35, doc="m, height of the tracker's head")
    station_placing_mm: float = expert(
        30.0, doc="mm, by which the person misses the place of a station", minimum=0.0
    )
    nest_placing_mm: float = expert(
        5.0, doc="mm, by which a nest stands beside its planned place", minimum=0.0
    )
    reflector_placing_mm: float = expert(
        2.0, doc="mm, by which a reflector is put up beside its place", minimum=0.0
    )
    reflectors_on_table: bool = expert(
        False, doc="the reflectors ride on the table instead of standing before a mirror"
    )
    range_std_um: float = expert(2.5, doc="um, noise along the beam at distance 0", minimum=0.0)
    range_std_um_per_m: float = expert(
        0.25, doc="um/m, growth of the noise along the beam with the distance", minimum=0.0
    )
    transverse_std_um: float = expert(
        3.75, doc="um, noise across the beam at distance 0", minimum=0.0
    )
    transverse_std_um_per_m: float = expert(
        1.5, doc="um/m, growth of the noise across the beam with the distance", minimum=0.0
    )
    measure_time_s: float = expert(1.0, doc="s, from the table at rest to the point", minimum=1e-3)
    azimuth_drift_arcsec_per_h: float = expert(
        0.0, doc="arcsec/h, drift of the tracker's azimuth, at all stations"
    )
    range_drift_um_per_h: float = expert(0.0, doc="um/h, drift of the tracker's range")
    displaced_nest: int = expert(
        0, doc="number of a nest that is displaced or badly seated; 0: none", minimum=0
    )
    displaced_at_stations: tuple[int, ...] = expert(
        (0,), doc="stations at which that nest is displaced", minimum=0
    )
    displaced_attempts: int = expert(
        1, doc="so many attempts at that nest find it displaced", minimum=1
    )
    displaced_mm: ClassVar[
        Annotated[float, "as dirt in a nest; displaced_nest says whether there is any"]
    ] = 1.0


@dataclass(frozen=True)
class MirrorSimulationSettings(SimulationSettings):
    """The simulated cell of the plane-mirror method."""

    instrument: str = expert(TRACKER, doc="a laser tracker with a mirror", choices=(TRACKER,))
    tracker: TrackerSettings = group(TrackerSettings)
    mirror: SimulatedMirrorSettings = group(SimulatedMirrorSettings, expert=True)


MIRROR: Final = "mirror"
REFLECTORS: Final = "reflectors"


@dataclass(frozen=True)
class MirrorPlanSettings(TableAngleSettings):
    """Where the table turns, where the tracker stands and what it looks at.

    Places are in the machine frame, whose origin and +z are the table's.
    """

    carries: str = setting(
        MIRROR, choices=(MIRROR, REFLECTORS),
        doc="what the table carries: the mirror, or reflectors that the tracker sees directly",
    )  # fmt: skip
    positions_per_station: int = setting(
        4, doc="table positions measured from one tracker station", minimum=1, maximum=3600
    )
    shared_positions: int = setting(
        1, minimum=0, maximum=3599,
        doc="table positions that a station measures again of the station before",
    )  # fmt: skip
    station_radius_m: float = setting(
        2.0, minimum=0.1, maximum=30.0, first=True,
        doc="m, distance of the tracker from the table axis",
    )  # fmt: skip
    station_height_m: float = setting(
        0.35, doc="m, height of the tracker's head above the table", minimum=-10.0, maximum=10.0
    )
    station_azimuths_deg: tuple[float, ...] = expert(
        (), doc="deg, direction of each station from the axis; empty: each faces its positions"
    )
    incidence_limit_deg: float = expert(
        INCIDENCE_LIMIT_DEG, minimum=1.0, maximum=85.0,
        doc="deg, largest angle between beam and mirror normal",
    )  # fmt: skip
    nests_m: tuple[float, ...] = setting(
        (), minimum=-30.0, maximum=30.0, first=True,
        doc="m, x y z of the reflector nests, fixed around the machine, that join the stations: "
        "of nest 1, then of nest 2 and so on",
    )  # fmt: skip
    closing_nests: bool = setting(
        True,
        doc="measure the nests again before the tracker leaves a station; without that, its "
        "drift is in the deviations unnoticed",
    )
    nests_every: int = setting(
        0, minimum=0, maximum=3600,
        doc="table positions between two rounds of nests at a station; 0: only before and after "
        "its positions",
    )  # fmt: skip
    drift_limit_arcsec: float = expert(
        5.0, minimum=0.01,
        doc="arcsec, turn of the tracker between two rounds of nests beyond which its station is "
        "measured again",
    )  # fmt: skip
    bidirectional: bool = setting(
        False,
        doc="from every tracker station measure its positions on the way up and, from the other "
        "side, on the way down",
    )
    reflectors: int = setting(
        1, minimum=1, maximum=20,
        doc="reflectors put up at each position, each measured directly and in the mirror",
    )  # fmt: skip
    reflector_reach_m: float = expert(
        1.5, doc="m, distance of these reflectors from the mirror", minimum=0.05, maximum=30.0
    )
    table_reflectors_m: tuple[float, ...] = setting(
        (), minimum=-30.0, maximum=30.0,
        doc="m, x y z of reflector 1, then 2 and so on, on the table at angle 0; only where the "
        "table carries reflectors",
    )  # fmt: skip
    mirror_centre_m: tuple[float, float, float] = setting(
        (0.05, 0.0, 0.15), first=True,
        doc="m, x, y, z of the middle of the mirror's surface with the table at angle 0",
    )  # fmt: skip
    mirror_azimuth_deg: float = setting(
        0.0, doc="deg, direction of the mirror's normal with the table at angle 0"
    )
    mirror_lean_deg: float = setting(
        0.0, minimum=-45.0, maximum=45.0,
        doc="deg, angle of the mirror's normal above the horizontal",
    )  # fmt: skip
    mirror_size_m: tuple[float, float] = setting(
        (0.1, 0.1), doc="m, width and height of the mirror", minimum=0.001, maximum=10.0
    )


SETTINGS: Final[Mapping[str, type[Any]]] = {
    "plan": MirrorPlanSettings,
    "solver": MirrorSolverSettings,
    "simulation": MirrorSimulationSettings,
}
"""The groups that this method declares for itself."""
