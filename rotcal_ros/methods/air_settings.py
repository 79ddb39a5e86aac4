"""Who corrects lengths for the index of refraction of the air: group ``air``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from rotcal_ros.foundation.settings import setting


@dataclass(frozen=True)
class AirSettings:
    """The air that the light of a tracer goes through, and who corrects its lengths for it.

    What is published goes before what is given here.
    """

    refraction: Literal["instrument", "ciddor", "edlen"] = setting(
        "instrument",
        doc="who corrects lengths: the instrument has done so itself, or they are vacuum "
        "wavelengths counted and are corrected here, by the equation of this name",
    )
    vacuum_wavelength_nm: float = setting(
        632.991, doc="nm, wavelength of the light in vacuum", minimum=300.0, maximum=1700.0
    )
    co2_ppm: float = setting(
        450.0, doc="umol/mol, carbon dioxide in the air", minimum=0.0, maximum=2000.0
    )
    dead_path_m: float = setting(
        0.0,
        doc="m, optical path at which a length reads zero: the air in it is corrected as well",
        minimum=0.0,
        maximum=100.0,
    )
    temperature_c: float | None = setting(
        None, doc="degC, of the air where no temperature is captured", minimum=-40.0, maximum=100.0
    )
    pressure_pa: float | None = setting(
        None, doc="Pa, of the air where no air_pressure is captured", minimum=10e3, maximum=140e3
    )
    humidity: float | None = setting(
        None, doc="0 to 1, of the air where no relative_humidity is captured", minimum=0.0,
        maximum=1.0,
    )  # fmt: skip
    temperature_std_k: float = setting(
        0.1, doc="K, standard uncertainty of the temperature along the beam", minimum=0.0
    )
    pressure_std_pa: float = setting(
        20.0, doc="Pa, standard uncertainty of the pressure", minimum=0.0
    )
    humidity_std: float = setting(
        0.03, doc="standard uncertainty of the humidity, of 0 to 1", minimum=0.0
    )
