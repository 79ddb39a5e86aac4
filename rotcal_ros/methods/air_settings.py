"""Who corrects lengths for the index of refraction of the air: group ``air``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from rotcal_ros.foundation.settings import expert, setting


@dataclass(frozen=True)
class AirSettings:
    """The air that the light of a tracer goes through, and who corrects its lengths for it.

    What is published goes before what is given here, for the correction and for what report and
    certificate say of the air.
    """

    refraction: Literal["instrument", "ciddor", "edlen"] = setting(
        "instrument",
        doc="who corrects lengths for the air: the instrument itself, or this program, which "
        "then expects counts of vacuum wavelengths and uses the equation of this name",
    )
    vacuum_wavelength_nm: float = setting(
        632.991, doc="nm, wavelength of the light in vacuum", minimum=300.0, maximum=1700.0
    )
    co2_ppm: ClassVar[
        Annotated[
            float,
            "another 100 umol/mol, as between a hall and a full office, change a length by 1.5e-8",
        ]
    ] = 450.0
    dead_path_m: float = setting(
        0.0, minimum=0.0, maximum=100.0,
        doc="m, optical path at which a length reads zero; the air in it is corrected, too",
    )  # fmt: skip
    temperature_c: float | None = setting(
        None, minimum=-40.0, maximum=100.0,
        doc="degC, temperature of the air where none is captured",
    )  # fmt: skip
    pressure_pa: float | None = setting(
        None, minimum=10e3, maximum=140e3,
        doc="Pa, pressure of the air where no air_pressure is captured",
    )  # fmt: skip
    humidity: float | None = setting(
        None, minimum=0.0, maximum=1.0,
        doc="relative humidity of the air, 0 to 1, where no relative_humidity is captured",
    )  # fmt: skip
    temperature_std_k: float = expert(
        0.1, doc="K, standard uncertainty of the temperature along the beam", minimum=0.0
    )
    pressure_std_pa: float = expert(
        20.0, doc="Pa, standard uncertainty of the pressure", minimum=0.0
    )
    humidity_std: float = expert(
        0.03, doc="standard uncertainty of the relative humidity, of 0 to 1", minimum=0.0
    )
