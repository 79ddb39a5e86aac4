"""The settings of a simulated laser tracer that goes from place to place on the table."""

from __future__ import annotations

from dataclasses import dataclass

from rotcal_ros.foundation.settings import group, setting
from rotcal_ros.methods.tracer.simulation_settings import (
    LengthsSimulationSettings,
    SimulatedReadingsSettings,
)


@dataclass(frozen=True)
class CarriedTracerSettings(SimulatedReadingsSettings):
    """The simulated laser tracer, and the person who fixes it at its places."""

    places_m: tuple[float, ...] = setting(
        (0.15, 0.0, 0.12, -0.075, 0.1299, 0.12, -0.075, -0.1299, 0.12),
        doc="m, x y z of place 0, then of place 1 and so on, in the table frame at angle 0",
        minimum=-10.0,
        maximum=10.0,
    )
    placing_mm: float = setting(
        0.5, doc="mm, by which the person misses each coordinate of a place", minimum=0.0
    )
    mounting_zero_um: float = setting(
        0.0, doc="um, standard deviation of the zero from one mounting to the next", minimum=0.0
    )
    misplaced_place: int = setting(
        -1, doc="number of a place that the person mistakes; -1: none", minimum=-1
    )
    misplaced_mountings: int = setting(
        1, doc="so many mountings at that place are wrong", minimum=1
    )
    misplaced_mm: float = setting(50.0, doc="mm, by which they are wrong, along x")


@dataclass(frozen=True)
class SixSimulationSettings(LengthsSimulationSettings):
    """The simulated cell of the six-deviations method."""

    tracer: CarriedTracerSettings = group(CarriedTracerSettings)
