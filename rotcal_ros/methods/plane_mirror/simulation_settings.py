"""The settings of the simulated laser tracker and mirror, parts of group ``simulation``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from rotcal_ros.foundation.settings import group, setting
from rotcal_ros.methods.simulation.settings import SimulationSettings

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

    station_azimuths_deg: tuple[float, ...] = setting(
        (0.0,), doc="deg, direction of each station from the table axis"
    )
    station_radius_m: float = setting(2.0, doc="m, distance from the axis", minimum=0.1)
    station_height_m: float = setting(0.35, doc="m, height of the tracker's head")
    station_placing_mm: float = setting(
        30.0, doc="mm, by which the person misses the place of a station", minimum=0.0
    )
    nest_placing_mm: float = setting(
        5.0, doc="mm, by which a nest stands beside its planned place", minimum=0.0
    )
    reflector_placing_mm: float = setting(
        2.0, doc="mm, by which a reflector is put up beside its place", minimum=0.0
    )
    reflectors_on_table: bool = setting(
        False, doc="the reflectors ride on the table instead of standing before a mirror"
    )
    range_std_um: float = setting(2.5, doc="um, noise along the beam at distance 0", minimum=0.0)
    range_std_um_per_m: float = setting(
        0.25, doc="um/m, growth of the noise along the beam with the distance", minimum=0.0
    )
    transverse_std_um: float = setting(
        3.75, doc="um, noise across the beam at distance 0", minimum=0.0
    )
    transverse_std_um_per_m: float = setting(
        1.5, doc="um/m, growth of the noise across the beam with the distance", minimum=0.0
    )
    measure_time_s: float = setting(
        1.0, doc="s, from the table at rest to the point", minimum=1e-3
    )
    azimuth_drift_arcsec_per_h: float = setting(
        0.0, doc="arcsec/h, drift of the tracker's azimuth, at all stations"
    )
    range_drift_um_per_h: float = setting(0.0, doc="um/h, drift of the tracker's range")
    displaced_nest: int = setting(
        0, doc="number of a nest that is displaced or badly seated; 0: none", minimum=0
    )
    displaced_at_stations: tuple[int, ...] = setting(
        (0,), doc="stations at which that nest is displaced", minimum=0
    )
    displaced_attempts: int = setting(
        1, doc="so many attempts at that nest find it displaced", minimum=1
    )
    displaced_mm: float = setting(1.0, doc="mm, by which that nest is displaced")


@dataclass(frozen=True)
class MirrorSimulationSettings(SimulationSettings):
    """The simulated cell of the plane-mirror method."""

    instrument: str = setting(TRACKER, doc="a laser tracker with a mirror", choices=(TRACKER,))
    tracker: TrackerSettings = group(TrackerSettings)
    mirror: SimulatedMirrorSettings = group(SimulatedMirrorSettings)
