"""The tracer and the probe of examples/own_cell, on a table that somebody else turns.

It reads whenever ``table_actual`` says where the table is; its error is that of the own cell. Its
own ``joint_states`` are to be remapped away, they come from the drive. At one place the mean of
its noise is the same in each run, so that no run looks suspect by chance.
"""

import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rotcal_msgs.msg import TracerLength
from sensor_msgs.msg import JointState

sys.path.append(str(Path(__file__).parents[2] / "examples" / "own_cell"))
import own_cell

own_cell.READINGS = 0
"""None by its own clock."""
SEED = 0
PLACE_NOISE_M, READING_NOISE_M = 0.04e-6, 0.02e-6


def noise_of(place):
    """Return the generator of a place, given by numbers below 10 with two decimals."""
    return np.random.default_rng([SEED, *(np.rint(100 * place).astype(int) + 1000)])


class OwnTracer(own_cell.OwnCell):
    def __init__(self):
        super().__init__()
        # On a busy machine it reads less often; a long queue would make it read ever later.
        self.create_subscription(JointState, "table_actual", self.read, 5)

    def turn_table(self, order):
        """Leave the table alone."""

    def read(self, state):
        angle = state.position[0]
        away = self.probe.here - own_cell.tracer_at(angle)
        place = np.round([*self.probe.here, np.cos(angle), np.sin(angle)], 2)
        length = TracerLength(status=TracerLength.STATUS_OK, length_std=own_cell.NOISE_M)
        length.length = float(np.linalg.norm(away)) - own_cell.DEAD_DISTANCE_M
        length.length += noise_of(place).normal(0.0, PLACE_NOISE_M)
        length.length += self.noise.normal(0.0, READING_NOISE_M)
        length.sequence = self.count("length")
        stamp = state.header.stamp
        self.publish(self.lengths, length, stamp.sec * 1_000_000_000 + stamp.nanosec)


def main():
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(OwnTracer())


if __name__ == "__main__":
    main()
