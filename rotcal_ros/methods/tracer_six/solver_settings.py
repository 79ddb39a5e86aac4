"""The settings of the six-deviations method: group ``solver`` of a configuration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from rotcal_ros.foundation.settings import setting
from rotcal_ros.methods.tracer.solver_settings import Datum, LengthNoiseSettings

Zero = Literal["per_run", "per_station", "per_segment"]
ZeroSetting = Literal["auto", Zero]


@dataclass(frozen=True)
class TracerSixSolverSettings(LengthNoiseSettings):
    """How six deviations are solved from lengths."""

    datum: Datum = setting(
        "prior",
        doc="targets as weighted prior, or as mere start values (free network)",
    )
    zero: ZeroSetting = setting(
        "auto",
        doc="which lengths share the unknown zero of the counter: all from one place (per_run: a "
        "beam that never broke), those of an angle and place (per_station), or those of one "
        "unbroken beam (per_segment); auto: per segment where the measurement tells the "
        "segments, else per run",
    )
    slip_m: float = setting(
        0.3164e-6,
        doc="m, a fringe by which the counter may slip unnoticed where lengths share zeros; what "
        "the residuals would not show of it is part of the uncertainty; 0: the counter does not "
        "slip",
        minimum=0.0,
        maximum=1e-5,
    )
    scatter_translation_std_m: float | None = setting(
        None,
        doc="m, standard deviation of the table's place from one arrival to the next, along each "
        "axis; 0: known to repeat; none: estimated from the distances between the places",
        minimum=0.0,
        maximum=1e-2,
    )
    scatter_rotation_std_rad: float | None = setting(
        None,
        doc="rad, standard deviation of the table's attitude from one arrival to the next, about "
        "each axis; 0: known to repeat; none: estimated from the distances between the places",
        minimum=0.0,
        maximum=1e-2,
    )
    tilt_std_rad: float | None = setting(
        None,
        doc="rad, known standard deviation of the table's tilts EAC and EBC; two places need it; "
        "none: nothing is known",
        minimum=1e-9,
        maximum=1e-2,
    )
