"""The simulated temperature: a drift, a swing, and what they do to the readings."""

from __future__ import annotations

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Stamps
from rotcal_ros.foundation.observations import TemperatureSample
from rotcal_ros.foundation.units import MICROMETRE, NANOSECOND
from rotcal_ros.simulation.noise import IndexedNoise, NoiseSource
from rotcal_ros.simulation.settings import TemperatureSettings

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
        change: Floats = self.settings.drift_k_per_h * time / 3600.0 + swing
        return change

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
