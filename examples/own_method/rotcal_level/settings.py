"""What a configuration says of the levels: groups ``plan``, ``solver`` and ``simulation``."""

from __future__ import annotations

from dataclasses import dataclass

from rotcal_ros.foundation.settings import group, setting
from rotcal_ros.methods.simulation.settings import AngleReaderSettings, SimulationSettings
from rotcal_ros.planning.table_angles import TableAngleSettings

AZIMUTHS_DEG = (0.0, 90.0, 135.0, 225.0)


@dataclass(frozen=True)
class LevelPlanSettings(TableAngleSettings):
    """Where the table stops, and which way the levels point on it."""

    azimuths_deg: tuple[float, ...] = setting(
        AZIMUTHS_DEG,
        doc="deg, counter-clockwise from the table's x axis to the end of a level that reads more "
        "when it is higher; first those of the first setting, then of the next",
        first=True,
    )
    levels: int = setting(2, doc="levels on the table at once: azimuths of a setting", minimum=1)
    closing: bool = setting(True, doc="measure the first angle again at the end of a setting")
    readings: int = setting(3, doc="readings of a level at an angle", minimum=1, maximum=1000)


@dataclass(frozen=True)
class LevelSolverSettings:
    """How sure a reading and an azimuth are."""

    sigma_arcsec: float = setting(
        0.1, doc="arcsec, standard deviation of a reading", minimum=1e-6, first=True
    )
    azimuth_std_deg: float = setting(
        0.5, doc="deg, standard uncertainty (k = 1) of an azimuth", minimum=1e-6, first=True
    )


@dataclass(frozen=True)
class SimulatedLevelsSettings:
    """The levels as they really stand."""

    azimuths_deg: tuple[float, ...] = setting(AZIMUTHS_DEG, doc="deg, as plan.azimuths_deg")
    placing_deg: float = setting(0.5, doc="deg, scatter of the real azimuths", minimum=0.0)
    zero_arcsec: float = setting(20.0, doc="arcsec, scatter of the zeros", minimum=0.0)


@dataclass(frozen=True)
class LevelSimulationSettings(SimulationSettings):
    """The simulated cell of the levels."""

    levels: SimulatedLevelsSettings = group(SimulatedLevelsSettings)
    reader: AngleReaderSettings = group(AngleReaderSettings)
