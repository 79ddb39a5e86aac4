"""The simulated air: temperature, pressure and humidity, and their effect on the readings."""

from __future__ import annotations

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Stamps
from rotcal_ros.foundation.observations import HumiditySample, PressureSample, TemperatureSample
from rotcal_ros.foundation.refraction import Air, ciddor
from rotcal_ros.foundation.units import MICROMETRE, NANOSECOND
from rotcal_ros.methods.simulation.noise import IndexedNoise, NoiseSource
from rotcal_ros.methods.simulation.settings import SimulatedAirSettings, TemperatureSettings


class SimulatedAir:
    """The air of the cell as a function of machine time."""

    def __init__(
        self,
        settings: SimulatedAirSettings,
        temperature: SimulatedTemperature,
        seed: int,
        start_ns: int,
    ) -> None:
        self.settings, self._temperature, self._start_ns = settings, temperature, start_ns
        self._pressure_noise = IndexedNoise(seed, NoiseSource.PRESSURE)

    def pressure(self, stamps: Stamps) -> Floats:
        """Return the true pressure (n,), Pa."""
        settings, time = self.settings, (stamps - self._start_ns) * NANOSECOND
        swing = np.sin(2 * np.pi * time / settings.pressure_swing_period_s)
        return np.asarray(settings.pressure_pa + settings.pressure_swing_pa * swing)

    def index(self, stamps: Stamps) -> Floats:
        """Return the true index of refraction (n,) for the tracer's light."""
        celsius = self._temperature.settings.mean_c + self._temperature.change(stamps)
        humidity = np.full(len(stamps), self.settings.humidity)
        air = Air(celsius, self.pressure(stamps), humidity)
        return ciddor(air, self.settings.vacuum_wavelength_nm)

    def readings(self, first: int, stamps: Stamps) -> tuple[PressureSample | HumiditySample, ...]:
        """Return the readings number ``first`` and following at ``stamps``, if published."""
        if not self.settings.published:
            return ()
        settings, count = self.settings, len(stamps)
        noise_pa = settings.noise_pa * self._pressure_noise.normal(first, count)
        times = stamps.tolist()
        pressures = (self.pressure(stamps) + noise_pa).tolist()
        return (
            *(PressureSample(t, SENSOR, value) for t, value in zip(times, pressures, strict=True)),
            *(HumiditySample(t, SENSOR, settings.humidity) for t in times),
        )


SENSOR = "air"


class SimulatedTemperature:
    """The air of the cell as a function of machine time."""

    def __init__(self, settings: TemperatureSettings, seed: int, start_ns: int) -> None:
        self.settings, self._start_ns = settings, start_ns
        self._noise = IndexedNoise(seed, NoiseSource.TEMPERATURE)

    def change(self, stamps: Stamps) -> Floats:
        """Return the true change of temperature since the start, K, (n,)."""
        time = (stamps - self._start_ns) * NANOSECOND
        swing = self.settings.swing_k * np.sin(2 * np.pi * time / self.settings.swing_period_s)
        return np.asarray(self.settings.drift_k_per_h * time / 3600.0 + swing)

    def length_change(self, stamps: Stamps, distances: Floats) -> Floats:
        """Return by how much readings over ``distances`` (n,) grow, m."""
        growth = self.settings.length_um_per_m_k * distances
        change: Floats = self.change(stamps) * (growth + self.settings.dead_distance_um_per_k)
        return change * MICROMETRE

    def readings(self, first: int, stamps: Stamps) -> tuple[TemperatureSample, ...]:
        """Return the readings number ``first`` and following at ``stamps``."""
        noise = self.settings.noise_k * self._noise.normal(first, len(stamps))
        values = self.settings.mean_c + self.change(stamps) + noise
        rows = zip(stamps.tolist(), values.tolist(), strict=True)
        return tuple(TemperatureSample(stamp, SENSOR, value) for stamp, value in rows)
