"""A machine of your own as one ROS 2 node: table, probe with reflector, laser tracer.

It knows nothing of rotcal_ros but its messages. Copy it, and put your machine where the physics
is: the three places are marked. Units are SI, angles in rad, stamps are the times of measurement.
"""

from contextlib import suppress
from dataclasses import dataclass
from math import cos, pi, sin

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rotcal_msgs.msg import ProbePoint, ProbeTarget, TableAngle, TracerLength
from sensor_msgs.msg import JointState, Temperature

ARCSEC = pi / 648000
PERIOD_S = 0.01
READINGS = 5
"""Lengths for each turn of the loop: the tracer reads five times as fast."""
NOISE_M = 0.2e-6
DEAD_DISTANCE_M = 0.2718
MOUNT_M = np.array([0.30, 0.05, 0.15])
"""Where the tracer stands on the table."""
TABLE_RAD_S, PROBE_M_S = 5.0, 20.0


def error_rad(angle: float) -> float:
    """Return by how much the table turns too far: what the calibration shall find."""
    return (6.0 * cos(angle - 0.4) + 2.5 * cos(2 * angle + 1.0)) * ARCSEC


def tracer_at(angle: float) -> np.ndarray:
    """Return where the tracer is (m, machine frame) when the table believes to be at ``angle``."""
    actual = angle + error_rad(angle)
    turn = np.array([[cos(actual), -sin(actual), 0], [sin(actual), cos(actual), 0], [0, 0, 1]])
    return turn @ MOUNT_M


@dataclass
class Axis:
    """Anything that moves to a goal with one speed; ``arrived`` once it is there."""

    here: np.ndarray
    goal: np.ndarray
    speed: float
    arrived: bool = True

    def move(self, seconds: float) -> None:
        """Go on for so long, and no further than the goal."""
        way, step = self.goal - self.here, self.speed * seconds
        distance = float(np.linalg.norm(way))
        self.arrived = distance <= step
        self.here = self.goal if self.arrived else self.here + way * (step / distance)


class OwnCell(Node):
    """Obeys the two orders, publishes what the instruments see."""

    def __init__(self) -> None:
        super().__init__("own_cell")
        self.noise = np.random.default_rng(7)
        self.table = Axis(np.zeros(1), np.zeros(1), TABLE_RAD_S)
        self.probe = Axis(np.zeros(3), np.zeros(3), PROBE_M_S)
        self.order: ProbeTarget | None = None
        self.counts = {"point": 0, "length": 0}
        self.states = self.create_publisher(JointState, "joint_states", 100)
        self.lengths = self.create_publisher(TracerLength, "tracer_length", 1000)
        self.points = self.create_publisher(ProbePoint, "probe_point", 10)
        self.temperatures = self.create_publisher(Temperature, "temperature", 10)
        self.create_subscription(TableAngle, "table_angle", self.turn_table, 100)
        self.create_subscription(ProbeTarget, "probe_target", self.move_probe, 100)
        self.create_timer(PERIOD_S, self.live)
        self.create_timer(0.5, self.tell_more)
        self.lived_ns = self.now_ns()

    def now_ns(self) -> int:
        """Return the time of the system clock."""
        return self.get_clock().now().nanoseconds

    def turn_table(self, order: TableAngle) -> None:
        """Send your table to ``order.angle``."""
        self.table.goal = np.array([order.angle])

    def move_probe(self, order: ProbeTarget) -> None:
        """Send your probe, with the reflector, to ``order.position``."""
        self.probe.goal = np.array(order.position)
        self.order = order

    def live(self) -> None:
        """Move on, and publish every reading with the time at which it was taken."""
        before, self.lived_ns = self.lived_ns, self.now_ns()
        seconds = (self.lived_ns - before) * 1e-9
        self.table.move(seconds)
        self.probe.move(seconds)
        angle, moving = float(self.table.here[0]), not self.table.arrived
        state = JointState(name=["rotary"], position=[angle])
        state.velocity = [TABLE_RAD_S if moving else 0.0]
        self.publish(self.states, state, self.lived_ns)
        if self.order is not None and self.probe.arrived and not moving:
            order, self.order = self.order, None
            self.answer(order)
        distance = float(np.linalg.norm(self.probe.here - tracer_at(angle))) - DEAD_DISTANCE_M
        for reading in range(1, READINGS + 1):  # a reading of your tracer
            stamp_ns = before + (self.lived_ns - before) * reading // READINGS
            length = TracerLength(status=TracerLength.STATUS_OK, length_std=NOISE_M)
            length.length = distance + self.noise.normal(0.0, NOISE_M)
            length.sequence = self.count("length")
            self.publish(self.lengths, length, stamp_ns)

    def answer(self, order: ProbeTarget) -> None:
        """Say that the probe is there: with the step and the attempt of its order."""
        point = ProbePoint(kind=order.kind, target=order.target, station=order.station)
        point.step, point.attempt = order.step, order.attempt
        self.tell_point(point)

    def tell_more(self) -> None:
        """Publish the temperature, and where the idle probe is: the preflight has to hear it."""
        self.publish(self.temperatures, Temperature(temperature=20.0), self.now_ns())
        if self.order is None:
            self.tell_point(ProbePoint(kind=ProbePoint.KIND_UNKNOWN))

    def tell_point(self, point: ProbePoint) -> None:
        """Publish a point where the probe is."""
        point.position = self.probe.here.tolist()
        point.sequence = self.count("point")
        self.publish(self.points, point, self.now_ns())

    def count(self, what: str) -> int:
        """Return the next number of what an instrument publishes."""
        self.counts[what] += 1
        return self.counts[what]

    def publish(self, publisher, message, stamp_ns: int) -> None:
        """Stamp and publish."""
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
        publisher.publish(message)


def main() -> None:
    """Run the cell until somebody ends it."""
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(OwnCell())


if __name__ == "__main__":
    main()
