"""The index of refraction of air, after Ciddor and after Edlen.

* P. E. Ciddor, Refractive index of air: new equations for the visible and near infrared,
  Applied Optics 35 (1996) 1566-1573.
* B. Edlen, The refractive index of air, Metrologia 2 (1966) 71-80, as revised by K. P. Birch and
  M. J. Downs, Metrologia 30 (1993) 155-162 and 31 (1994) 315-316; the temperature in its term for
  water is that of J. A. Stone and J. H. Zimmerman, NIST Engineering Metrology Toolbox.

Both give the phase index for one vacuum wavelength, 300 to 1700 nm, which is the one for
interferometers. All inputs may be arrays of one shape.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import DataError

KELVIN: Final = 273.15
"""Kelvin at 0 degrees Celsius."""
GAS_CONSTANT: Final = 8.314510
"""J/(mol K), as in Ciddor's paper; it nearly cancels."""
PRESSURES_PA: Final = (10e3, 140e3)
"""Possible pressures of air, Pa."""
TEMPERATURES_C: Final = (-40.0, 100.0)
"""Temperatures that the equations are meant for."""


@dataclass(frozen=True, slots=True)
class Equation:
    """An equation for the index: its ``name`` for people, its own standard uncertainty."""

    name: str
    index: Callable[[Air, float, float], Floats]
    std: float


@dataclass(frozen=True, slots=True)
class Air:
    """Air: ``temperature_c`` in degrees Celsius, ``pressure_pa``, ``humidity`` relative, 0 to 1.

    Each is (n,). Raises DataError for what cannot be air, which most often is another unit.
    """

    temperature_c: Floats
    pressure_pa: Floats
    humidity: Floats

    def __post_init__(self) -> None:
        _require("temperature", self.temperature_c, TEMPERATURES_C, "degC", "kelvin")
        _require("pressure", self.pressure_pa, PRESSURES_PA, "Pa", "hectopascal")
        _require("relative humidity", self.humidity, (0.0, 1.0), "(a ratio)", "per cent")

    def vapour_pressure(self) -> Floats:
        """Return the partial pressure of water, Pa: saturation after R. S. Davis (1992)."""
        kelvin = self.temperature_c + KELVIN
        saturated = np.exp(
            1.2378847e-5 * kelvin**2 - 1.9121316e-2 * kelvin + 33.93711047 - 6.3431645e3 / kelvin
        )
        return np.asarray(self.humidity * saturated, dtype=np.float64)


def ciddor(air: Air, vacuum_wavelength_nm: float, co2_ppm: float = 450.0) -> Floats:
    """Return the index of refraction (n,) after Ciddor (1996), appendix B."""
    squared = (1000.0 / vacuum_wavelength_nm) ** 2  # of the wave number, um^-2
    kelvin = air.temperature_c + KELVIN
    factor = 1.00062 + 3.14e-8 * air.pressure_pa + 5.6e-7 * air.temperature_c**2
    water = factor * air.vapour_pressure() / air.pressure_pa  # molar fraction
    standard_air = 1e-8 * (5792105.0 / (238.0185 - squared) + 167917.0 / (57.362 - squared))
    standard_air *= 1.0 + 0.534e-6 * (co2_ppm - 450.0)
    standard_vapour = 1.022e-8 * (
        295.235 + 2.6422 * squared - 0.032380 * squared**2 + 0.004028 * squared**3
    )
    molar = 1e-3 * (28.9635 + 12.011e-6 * (co2_ppm - 400.0))  # kg/mol of dry air
    reference_air = _density(molar, 101325.0, 288.15, 0.0, 1.0)
    reference_vapour = _density(0.018015, 1333.0, 293.15, 1.0, 1.0)
    dry = _density(molar, air.pressure_pa, kelvin, water, 1.0 - water)
    vapour = _density(0.018015, air.pressure_pa, kelvin, water, water)
    return np.asarray(
        1.0 + dry / reference_air * standard_air + vapour / reference_vapour * standard_vapour,
        dtype=np.float64,
    )


def _density(
    molar: float, pressure: Floats | float, kelvin: Floats | float, water: Floats | float,
    share: Floats | float,
) -> Floats | float:  # fmt: skip
    """Return the density (kg/m^3) of the ``share`` of a component of moist air, BIPM 1981/91."""
    celsius, ratio = kelvin - KELVIN, pressure / kelvin
    compressibility = (
        1.0
        - ratio
        * (
            1.58123e-6 - 2.9331e-8 * celsius + 1.1043e-10 * celsius**2
            + (5.707e-6 - 2.051e-8 * celsius) * water
            + (1.9898e-4 - 2.376e-6 * celsius) * water**2
        )
        + ratio**2 * (1.83e-11 - 0.765e-8 * water**2)
    )  # fmt: skip
    return share * ratio * molar / (compressibility * GAS_CONSTANT)


def edlen(air: Air, vacuum_wavelength_nm: float, co2_ppm: float = 450.0) -> Floats:
    """Return the index of refraction (n,) after Edlen, revised by Birch and Downs (1993, 1994)."""
    squared = (1000.0 / vacuum_wavelength_nm) ** 2
    celsius, pressure = air.temperature_c, air.pressure_pa
    standard = 1e-8 * (8342.54 + 2406147.0 / (130.0 - squared) + 15998.0 / (38.9 - squared))
    standard *= 1.0 + 0.540e-6 * (co2_ppm - 450.0)
    dry = pressure * standard / 96095.43
    dry = dry * (1.0 + 1e-8 * (0.601 - 0.00972 * celsius) * pressure) / (1.0 + 0.003661 * celsius)
    water = 1e-10 * (3.7345 - 0.0401 * squared) * 292.75 / (celsius + KELVIN)
    return np.asarray(1.0 + dry - water * air.vapour_pressure(), dtype=np.float64)


EQUATIONS: Final[Mapping[str, Equation]] = {
    "ciddor": Equation("Ciddor (1996)", ciddor, 1e-8),
    "edlen": Equation("Edlen as revised by Birch and Downs (1993, 1994)", edlen, 1e-8),
}
"""Equations by the names that settings give them; both authors state 2e-8 at k = 2 or less."""


@dataclass(frozen=True, slots=True)
class Sensors:
    """Standard uncertainties of what the index is calculated from, in K, Pa and as a ratio."""

    temperature_k: float
    pressure_pa: float
    humidity: float


def index_std(
    equation: Equation, air: Air, sensors: Sensors, vacuum_wavelength_nm: float, co2_ppm: float
) -> Floats:
    """Return the standard uncertainty (n,) of the index: sensors and equation, JCGM 100, 5.1.2.

    The sensitivities come from a small step up and down, kept within the possible range of air.
    """

    def index(celsius: Floats, pressure: Floats, humidity: Floats) -> Floats:
        moved = Air(celsius, pressure, humidity)
        return equation.index(moved, vacuum_wavelength_nm, co2_ppm)

    celsius, pressure, humidity = air.temperature_c, air.pressure_pa, air.humidity
    low, high = np.maximum(humidity - 0.01, 0.0), np.minimum(humidity + 0.01, 1.0)
    by_kelvin = (
        index(celsius + 0.05, pressure, humidity) - index(celsius - 0.05, pressure, humidity)
    ) / 0.1
    by_pascal = (
        index(celsius, pressure + 50.0, humidity) - index(celsius, pressure - 50.0, humidity)
    ) / 100.0
    by_humidity = (index(celsius, pressure, high) - index(celsius, pressure, low)) / (high - low)
    return np.asarray(
        np.sqrt(
            (by_kelvin * sensors.temperature_k) ** 2
            + (by_pascal * sensors.pressure_pa) ** 2
            + (by_humidity * sensors.humidity) ** 2
            + equation.std**2
        ),
        dtype=np.float64,
    )


def _require(
    what: str, values: Floats, limits: tuple[float, float], unit: str, mistaken: str
) -> None:
    """Raise DataError unless all ``values`` lie within ``limits``."""
    low, high = limits
    bad = np.flatnonzero(~((values >= low) & (values <= high)))
    if bad.size:
        raise DataError(
            f"a {what} of {np.ravel(values)[bad[0]]:g} is impossible for air: expected "
            f"{low:g} to {high:g} {unit}; is it in {mistaken}?"
        )
