"""A cell with one thing wrong.

usage: wrong_machine.py ("no echo" | "degrees" | "clock" | "deaf")
"""

import math
import sys
import time

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rotcal_msgs.msg import ProbePoint, ProbeTarget, TableAngle, TracerLength
from sensor_msgs.msg import JointState, Temperature

from rotcal_ros.nodes.runtime.conversions import make_header
from rotcal_ros.nodes.runtime.qos import EVENT, LATCHED, STREAM

OFF_NS = 4_000_000_000


class WrongMachine(Node):
    """Obeys at once; the length is the table angle in millimetres."""

    def __init__(self, wrong):
        super().__init__("wrong_machine", namespace="/cell")
        self._wrong = wrong
        self._angle, self._number = 0.0, 0
        self._joints = self.create_publisher(JointState, "joint_states", STREAM)
        self._lengths = self.create_publisher(TracerLength, "tracer_length", STREAM)
        self._points = self.create_publisher(ProbePoint, "probe_point", EVENT)
        self._air = self.create_publisher(Temperature, "temperature", EVENT)
        orders = LATCHED if wrong == "deaf" else QoSProfile(depth=10)
        self.create_subscription(TableAngle, "table_angle", self._turn, orders)
        self.create_subscription(ProbeTarget, "probe_target", self._move, EVENT)
        self.create_timer(0.01, self._stream)
        self.create_timer(0.5, self._idle)

    def _turn(self, order):
        self._angle = order.angle

    def _move(self, order):
        key = {} if self._wrong == "no echo" else {"step": order.step, "attempt": order.attempt}
        self._point(kind=order.kind, target=order.target, position=order.position, **key)

    def _stream(self):
        now = time.time_ns()
        angle = math.degrees(self._angle) if self._wrong == "degrees" else self._angle
        table = JointState(name=["C"], position=[angle], velocity=[0.0])
        table.header = make_header(now)
        self._joints.publish(table)
        length = TracerLength(sequence=self._number, length=1e-3 * self._angle, status=1)
        length.header = make_header(now - (OFF_NS if self._wrong == "clock" else 0))
        self._lengths.publish(length)
        self._number += 1

    def _idle(self):
        self._point()
        self._air.publish(Temperature(header=make_header(time.time_ns()), temperature=20.0))

    def _point(self, **values):
        self._points.publish(ProbePoint(header=make_header(time.time_ns()), **values))


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(WrongMachine(sys.argv[1]))
