"""The laser tracer on the table and the machine that carries its reflector, as one instrument."""

from __future__ import annotations

import numpy as np

from rotcal_ros.arrays import Floats, Stamps
from rotcal_ros.catalogue.tracer.simulated_probe import SimulatedProbe
from rotcal_ros.catalogue.tracer.simulated_tracer import SimulatedTracer
from rotcal_ros.catalogue.tracer.simulation_settings import TracerSimulationSettings
from rotcal_ros.observations import TracerSample
from rotcal_ros.simulation.instrument import Table
from rotcal_ros.simulation.temperature import SimulatedTemperature
from rotcal_ros.simulation.ticks import Ticks
from rotcal_ros.units import DEGREE


class TracerAndReflector(SimulatedProbe):
    """A reflector on a probe, and the tracer that rides on the table and measures to it."""

    streams_lengths = True

    def __init__(
        self,
        settings: TracerSimulationSettings,
        table: Table,
        temperature: SimulatedTemperature,
        start_ns: int,
    ) -> None:
        super().__init__(settings.probe, settings.seed, start_ns)
        self._table, self._temperature = table, temperature
        self._mount = np.array(settings.tracer.mount_m)
        self._tracer = SimulatedTracer(settings.tracer, settings.faults, settings.seed, start_ns)
        self._ticks = Ticks(start_ns, settings.tracer.rate_hz)

    def distances(self, stamps: Stamps) -> Floats:
        """Return the true distances (n,) from the tracer to the reflector, m."""
        rotation, translation = self._table.poses(stamps)
        station = rotation @ self._mount + translation
        distances: Floats = np.linalg.norm(self.positions(stamps) - station, axis=1)
        return distances

    def lengths(self, now_ns: int) -> tuple[TracerSample, ...]:
        """Return the readings since the call before."""
        first, stamps = self._ticks.until(now_ns)
        if not len(stamps):
            return ()
        distances = self.distances(stamps)
        drifts = self._temperature.length_change(stamps, distances)
        angles_deg = self._table.angles(stamps) / DEGREE
        broken = self._tracer.blocked(angles_deg, self.target)
        return self._tracer.readings(first, stamps, distances, drifts, broken.astype(float))
