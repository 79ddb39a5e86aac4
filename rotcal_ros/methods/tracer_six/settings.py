"""The settings of the six-deviations method: group ``solver`` of a configuration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from rotcal_ros.methods.tracer.settings import Datum, TracerLimits
from rotcal_ros.settings import setting

Zero = Literal["per_run", "per_station", "segments"]


@dataclass(frozen=True)
class TracerSixSolverSettings(TracerLimits):
    """How six deviations are solved from lengths, and how well the instrument measures."""

    datum: Datum = setting(
        "prior",
        doc="targets as weighted prior, or as mere start values (free network)",
    )
    zero: Zero = setting(
        "per_run",
        doc="which lengths share the zero of the counter: all of a run (a beam that never broke), "
        "those of a station, or those of a segment as the measurement tells",
    )
    length_std_m: float = setting(
        0.2e-6,
        doc="m, standard deviation of one captured length, repeatability included",
        minimum=1e-9,
        maximum=1e-2,
    )
    length_std_relative: float = setting(
        0.0,
        doc="m/m, part of the length deviation that grows with the distance",
        minimum=0.0,
        maximum=1e-2,
    )
    target_std_m: float = setting(
        1e-6, doc="m, standard deviation of each coordinate of a target", minimum=1e-9, maximum=1.0
    )
    scatter_translation_std_m: float | None = setting(
        None,
        doc="m, how the table's place scatters from arrival to arrival, along each axis; 0: known "
        "to repeat; absent: estimated from the distances between the places",
        minimum=0.0,
        maximum=1e-2,
    )
    scatter_rotation_std_rad: float | None = setting(
        None,
        doc="rad, how the table's attitude scatters from arrival to arrival, about each axis; 0: "
        "known to repeat; absent: estimated from the distances between the places",
        minimum=0.0,
        maximum=1e-2,
    )
    tilt_std_rad: float | None = setting(
        None,
        doc="rad, known standard deviation of the table's tilts EAC and EBC; two places need it; "
        "absent: nothing is known",
        minimum=1e-9,
        maximum=1e-2,
    )
