"""The settings of the plane-mirror method, without what makes and solves a plan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from rotcal_ros.foundation.settings import setting
from rotcal_ros.methods.plane_mirror.simulation_settings import MirrorSimulationSettings
from rotcal_ros.methods.plane_mirror.solver_settings import (
    INCIDENCE_LIMIT_DEG,
    MirrorSolverSettings,
)
from rotcal_ros.planning.table_angles import TableAngleSettings

MIRROR: Final = "mirror"
REFLECTORS: Final = "reflectors"


@dataclass(frozen=True)
class MirrorPlanSettings(TableAngleSettings):
    """Where the table turns, where the tracker stands and what it looks at.

    Places are in the machine frame, whose origin and +z are the table's.
    """

    carries: str = setting(
        MIRROR,
        doc="what the table carries: the mirror, or reflectors that the tracker sees directly",
        choices=(MIRROR, REFLECTORS),
    )
    positions_per_station: int = setting(
        4, doc="table positions measured from one tracker station", minimum=1, maximum=3600
    )
    shared_positions: int = setting(
        1,
        doc="table positions that a station measures again of the station before",
        minimum=0,
        maximum=3599,
    )
    station_radius_m: float = setting(
        2.0,
        doc="m, distance of the tracker from the table axis",
        minimum=0.1,
        maximum=30.0,
        first=True,
    )
    station_height_m: float = setting(
        0.35, doc="m, height of the tracker's head above the table", minimum=-10.0, maximum=10.0
    )
    station_azimuths_deg: tuple[float, ...] = setting(
        (), doc="deg, direction of each station from the axis; empty: each faces its positions"
    )
    incidence_limit_deg: float = setting(
        INCIDENCE_LIMIT_DEG,
        doc="deg, largest angle between beam and mirror normal",
        minimum=1.0,
        maximum=85.0,
    )
    nests_m: tuple[float, ...] = setting(
        (),
        doc="m, x y z of the reflector nests, fixed around the machine, that join the stations: "
        "of nest 1, then of nest 2 and so on",
        minimum=-30.0,
        maximum=30.0,
        first=True,
    )
    closing_nests: bool = setting(
        True,
        doc="measure the nests again before the tracker leaves a station; without that, its "
        "drift is in the deviations unnoticed",
    )
    nests_every: int = setting(
        0,
        doc="table positions between two rounds of nests at a station; 0: only before and after "
        "its positions",
        minimum=0,
        maximum=3600,
    )
    drift_limit_arcsec: float = setting(
        5.0,
        doc="arcsec, turn of the tracker between two rounds of nests beyond which its station is "
        "measured again",
        minimum=0.01,
    )
    bidirectional: bool = setting(
        False,
        doc="from every tracker station measure its positions on the way up and, from the other "
        "side, on the way down",
    )
    reflectors: int = setting(
        1,
        doc="reflectors put up at each position, each measured directly and in the mirror",
        minimum=1,
        maximum=20,
    )
    reflector_reach_m: float = setting(
        1.5, doc="m, distance of these reflectors from the mirror", minimum=0.05, maximum=30.0
    )
    table_reflectors_m: tuple[float, ...] = setting(
        (),
        doc="m, x y z of reflector 1, then 2 and so on, on the table at angle 0; only where the "
        "table carries reflectors",
        minimum=-30.0,
        maximum=30.0,
    )
    mirror_centre_m: tuple[float, float, float] = setting(
        (0.05, 0.0, 0.15),
        doc="m, x, y, z of the middle of the mirror's surface with the table at angle 0",
        first=True,
    )
    mirror_azimuth_deg: float = setting(
        0.0, doc="deg, direction of the mirror's normal with the table at angle 0"
    )
    mirror_lean_deg: float = setting(
        0.0,
        doc="deg, angle of the mirror's normal above the horizontal",
        minimum=-45.0,
        maximum=45.0,
    )
    mirror_size_m: tuple[float, float] = setting(
        (0.1, 0.1), doc="m, width and height of the mirror", minimum=0.001, maximum=10.0
    )


SETTINGS: Final[Mapping[str, type[Any]]] = {
    "plan": MirrorPlanSettings,
    "solver": MirrorSolverSettings,
    "simulation": MirrorSimulationSettings,
}
"""The groups that this method declares for itself."""
