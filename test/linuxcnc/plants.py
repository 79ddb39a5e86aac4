"""Plants with an error curve and a play drawn at random, on a real LinuxCNC with XYZA."""

import numpy as np
from real_linuxcnc import Axis, Running, plant_hal

from rotcal_ros.foundation.units import DEGREE

ORDERS = np.arange(1, 5)
REFERENCE_DEG = 0.0
BETWEEN_DEG = np.array(
    [7.5, 31.0, 52.5, 93.0, 127.0, 142.5, 187.5, 232.0, 251.0, 277.5, 322.5, 352.5]
)
SMALLER = 50.0
"""So many times smaller has the error to become."""


class Plant:
    """An error curve and a play that only the plant knows; degrees."""

    def __init__(self, seed):
        random = np.random.default_rng(seed)
        self.amplitudes = random.uniform(25.0, 60.0, len(ORDERS)) / ORDERS / 3600
        self.phases = random.uniform(0.0, 2 * np.pi, len(ORDERS))
        self.play_deg = random.uniform(6.0, 9.0) / 3600

    def error_deg(self, table_deg):
        at = np.multiply.outer(np.deg2rad(table_deg), ORDERS) + self.phases
        return np.sin(at) @ self.amplitudes

    def deviation(self, angle, side):
        """The deviation (rad) of an axis without table that comes from one side."""
        at = np.rad2deg(angle) - side * self.play_deg / 2
        return (at + self.error_deg(at)) * DEGREE - angle

    def deviations(self):
        """Those between the measured angles from both sides, from the zero of the forward one."""
        at = BETWEEN_DEG * DEGREE
        zero = self.deviation(REFERENCE_DEG * DEGREE, 1)
        return np.stack([self.deviation(at, 1), self.deviation(at, -1)]) - zero


def machine_with(plant, folder):
    """A machine that is homed where most plans begin: it stands there and has yet to arrive."""
    chain = plant_hal(-30.0, 420.0, 5.0, plant.error_deg, plant.play_deg)
    return Axis(folder, chain, limits=(-360, 720), velocity=360, acceleration=2000)


def true_deviations(axis):
    """The deviations (rad) of the plant's own angle from both sides, between measured angles."""
    with Running(axis) as running:
        zero = running.go(REFERENCE_DEG, 1)["actual_deg"] - REFERENCE_DEG
        up = [running.go(angle, 1)["actual_deg"] - angle for angle in BETWEEN_DEG]
        down = [running.go(angle, -1)["actual_deg"] - angle for angle in BETWEEN_DEG[::-1]]
        assert running.errors == []
    return (np.array([up, down[::-1]]) - zero) * DEGREE
