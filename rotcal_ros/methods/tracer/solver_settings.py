"""The settings of the laser-tracer method: group ``solver`` of a configuration."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.settings import expert, setting

Variant = Literal["station", "joint"]
Datum = Literal["prior", "free"]
Zero = Literal["auto", "per_station", "per_segment"]


@dataclass(frozen=True)
class TracerLimits:
    """When a length is rejected, and when a result is no longer called ok.

    The significance of a rejection is two-sided and shared among the lengths; 0.01 means
    |test value| > 4.3 at 704 lengths.
    """

    rejection_significance: float = expert(
        0.01,
        minimum=1e-9,
        maximum=0.5,
        doc="probability of rejecting any length at all when all are good",
    )
    noise_significance: float = expert(
        0.01,
        minimum=1e-9,
        maximum=0.5,
        doc="probability of estimating the noise from the residuals although it is as stated",
    )
    test_significance: float = expert(
        0.001,
        minimum=1e-9,
        maximum=0.5,
        doc="probability of a false alarm of each global test (chi-squared, closure, motion)",
    )
    max_rejected_share: float = expert(
        0.03,
        minimum=0.001,
        maximum=0.5,
        doc="share of rejected lengths beyond which the verdict is suspect",
    )
    max_station_std: float = expert(
        0.01,
        minimum=1e-6,
        maximum=0.999,
        doc="largest standard deviation of a station's position, as a share of the radius of the "
        "stations' circle; beyond it the geometry is refused",
    )

    def __post_init__(self) -> None:
        """Refuse shares and probabilities that are none; a file's ranges are narrower."""
        for limit in fields(TracerLimits):
            value = getattr(self, limit.name)
            if not 0.0 < value < 1.0:
                raise ConfigurationError(
                    f"tracer setting {limit.name} is {value}, expected 0 < value < 1"
                )


@dataclass(frozen=True)
class LengthNoiseSettings(TracerLimits):
    """How well the tracer measures and the machine places its targets."""

    length_std_m: float = setting(
        0.2e-6,
        minimum=1e-9,
        maximum=1e-2,
        first=True,
        doc="m, standard deviation of one captured length, repeatability included",
    )
    length_std_relative: float = setting(
        0.0,
        minimum=0.0,
        maximum=1e-2,
        doc="m/m, part of the standard deviation of a length that grows with the distance",
    )
    target_std_m: float = setting(
        1e-6,
        minimum=1e-9,
        maximum=1.0,
        first=True,
        doc="m, standard deviation of each coordinate of a target, from the errors of the machine",
    )
    slip_m: float = expert(
        0.3164e-6,
        minimum=0.0,
        maximum=1e-5,
        doc="m, a fringe by which the counter may slip unnoticed where lengths share zeros; what "
        "the residuals would not show of it is part of the uncertainty; 0: the counter does not "
        "slip",
    )


@dataclass(frozen=True)
class TracerSolverSettings(LengthNoiseSettings):
    """How the laser-tracer method is solved."""

    variant: Variant = setting(
        "joint", doc="station by station with known targets, or joint self-calibration"
    )
    datum: Datum = setting(
        "prior",
        doc="joint variant: targets as weighted prior, or as mere start values (free network)",
    )
    zero: Zero = setting(
        "auto",
        doc="the unknown zero of the lengths: one per_station, or one per_segment of unbroken "
        "beam, which measures better and needs the variant joint; auto: per segment for a table "
        "with the column segment, else per station",
    )
    zero_walk_std_m: float | None = expert(
        0.0,
        minimum=0.0,
        maximum=1e-4,
        doc="m, with a zero per_segment: standard deviation of its change from one length to the "
        "next, as by temperature; 0: it does not change; none (null): estimated from the lengths",
    )
    position_std_m: float = expert(
        1e-7,
        minimum=0.0,
        maximum=1e-3,
        doc="m, standard deviation of each coordinate of the reflector from one arrival to the "
        "next, besides target_std_m, which stays the same: what a resumed plan measures again "
        "may differ by it",
    )
    circle_std_m: float | None = expert(
        None,
        minimum=1e-9,
        maximum=1e-2,
        doc="m, standard deviation of the stations from one circle about the table's axis, "
        "radially and along it; none: no circle is assumed, and every station is found by itself",
    )
    error_motion_std_m: float | None = setting(
        None,
        minimum=0.0,
        maximum=1e-2,
        doc="m, standard deviation of the table's radial error motion at the tracer's height; 0: "
        "no such motion; none: as circle_std_m, else estimated from the circle of the stations",
    )
