"""The settings of the plane-mirror method: group ``solver`` of a configuration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, get_args

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.settings import setting

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
        doc="reflectors on the table (direct), or how the stations with a mirror are joined",
    )
    range_std_m: float = setting(
        2.5e-6,
        doc="m, standard deviation of a tracker point along the beam, at distance 0",
        minimum=0.0,
        maximum=1e-2,
        first=True,
    )
    range_std_relative: float = setting(
        0.25e-6,
        doc="m/m, growth of the standard deviation along the beam with the distance",
        minimum=0.0,
        maximum=1e-2,
    )
    transverse_std_m: float = setting(
        3.75e-6,
        doc="m, standard deviation of a tracker point across the beam, at distance 0",
        minimum=0.0,
        maximum=1e-2,
        first=True,
    )
    transverse_std_relative: float = setting(
        1.5e-6,
        doc="m/m, growth of the standard deviation across the beam with the distance",
        minimum=0.0,
        maximum=1e-2,
    )
    mirror_slope_std_arcsec: float = setting(
        0.0,
        doc="arcsec, flatness of the mirror, as standard deviation of its slope from spot to spot",
        minimum=0.0,
        maximum=3600.0,
        first=True,
    )
    tilt_std_arcsec: float = setting(
        1.0,
        doc="arcsec, standard deviation of the table's tilts (EAC, EBC) that is assumed",
        minimum=1e-6,
        maximum=3600.0,
    )
    uneven_drift_std_arcsec: float = setting(
        0.5,
        doc="arcsec, standard deviation (k = 1) of the tracker's azimuth about the straight line "
        "between two rounds of nests that are a station apart; it is part of the uncertainty",
        minimum=0.0,
        maximum=3600.0,
    )
    significance: float = setting(
        1e-3, doc="probability of a false alarm of each test", minimum=1e-9, maximum=0.5
    )

    def __post_init__(self) -> None:
        """Refuse a tracker without noise along or across the beam: its weight has no end."""
        for name in ("range_std", "transverse_std"):
            if getattr(self, f"{name}_m") + getattr(self, f"{name}_relative") <= 0.0:
                raise ConfigurationError(
                    f"{name}_m and {name}_relative are both 0: state the tracker's noise"
                )
