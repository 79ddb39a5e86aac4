"""The simulated machine tool: its probe touches balls that somebody has put on the table."""

from __future__ import annotations

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.units import MILLIMETRE
from rotcal_ros.methods.ball_plate.simulated_probe import SimulatedTouchProbe
from rotcal_ros.methods.simulation.air import SimulatedTemperature
from rotcal_ros.methods.simulation.instrument import SimulatedInstrument, Table
from rotcal_ros.methods.simulation.noise import IndexedNoise, NoiseSource
from rotcal_ros.methods.table_balls.settings import BallsSimulationSettings
from rotcal_ros.planning.points import triples


def placed_balls(settings: BallsSimulationSettings) -> Floats:
    """Return the true centres (k, 3) in the table frame at angle 0, m."""
    places = np.array(triples(settings.balls.balls_m, "balls_m"))
    missed = IndexedNoise(settings.seed, NoiseSource.BALL).normal(0, places.size)
    off = settings.balls.placing_mm * MILLIMETRE * missed.reshape(places.shape)
    return np.asarray(places + off)


def simulated_instrument(
    settings: BallsSimulationSettings,
    table: Table,
    _temperature: SimulatedTemperature,
    start_ns: int,
) -> SimulatedInstrument:
    """Return the machine that touches the balls on ``table``."""
    balls, diameter_m = placed_balls(settings), settings.balls.ball_diameter_m
    return SimulatedTouchProbe(settings, settings.touch_probe, balls, diameter_m, table, start_ns)
