"""A cell that speaks no message of ours but the orders: table, probe and tracer of somebody else.

usage: foreign_cell.py MODE; the modes are the keys of MODES
"""

import sys
import time
from math import cos, degrees, pi, sin

import numpy as np
import rclpy
from geometry_msgs.msg import PointStamped, PoseStamped, Vector3Stamped
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rotcal_msgs.msg import ProbeTarget, TableAngle
from sensor_msgs.msg import JointState, Range
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger

ARCSEC = pi / 648000
NOISE_M = 0.2e-6
DEAD_M = 0.2718
MOUNT_M = np.array([0.30, 0.05, 0.15])
SHOT_AHEAD_NS = 4_000_000_000
"""So much the clock of the single-shot tracer is ahead."""
BEST = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
MODES = {
    "stream": {"angle": "float", "length": "float", "probe": PoseStamped},
    "asked": {"angle": "joint", "length": "shot", "probe": Vector3Stamped},
    "bursts": {"angle": "float", "length": "burst", "probe": PointStamped},
    "named": {"angle": "place", "length": "vector", "probe": PoseStamped},
    "type": {"angle": "joint", "length": "text", "probe": PoseStamped},
}


def error_rad(angle):
    """Return by how much the table turns too far."""
    return (6.0 * cos(angle - 0.4) + 2.5 * cos(2 * angle + 1.0)) * ARCSEC


class ForeignCell(Node):
    """Moves at once; what it says is in millimetres, degrees and kelvin."""

    def __init__(self, mode):
        super().__init__("foreign_cell", namespace="/cell")
        self.mode, self.noise = MODES[mode], np.random.default_rng(3)
        self.angle, self.probe = 0.0, np.zeros(3)
        kinds = {"float": Float64, "joint": JointState, "place": JointState}
        self.angles = self.create_publisher(kinds[self.mode["angle"]], "joint_states", BEST)
        kinds = {"shot": Range, "text": String, "vector": Vector3Stamped}
        self.lengths = self.create_publisher(
            kinds.get(self.mode["length"], Float64), "tracer_length", BEST
        )
        self.points = self.create_publisher(self.mode["probe"], "probe_point", BEST)
        self.air = self.create_publisher(Float64, "temperature", BEST)
        self.create_subscription(TableAngle, "table_angle", self.turn, 100)
        self.create_subscription(ProbeTarget, "probe_target", self.move, 100)
        self.create_service(Trigger, "/tracer/measure", self.shoot)
        slow = self.mode["angle"] == "joint"
        self.create_timer(0.1 if slow else 0.01, self.tell_angle)
        self.create_timer(0.3, lambda: self.air.publish(Float64(data=293.15)))
        if self.mode["length"] in ("float", "text", "vector"):
            self.create_timer(0.005, self.tell_length)
        if self.mode["length"] == "burst":
            self.create_timer(0.3, self.tell_burst)
        if self.mode["length"] != "shot":
            self.create_timer(0.05, self.tell_probe)

    def turn(self, order):
        self.angle = order.angle

    def move(self, order):
        self.probe = np.array(order.position)
        if self.mode["length"] == "shot":  # it reports a place only when it has arrived
            self.tell_probe()

    def length_mm(self):
        actual = self.angle + error_rad(self.angle)
        turn = np.array([[cos(actual), -sin(actual), 0], [sin(actual), cos(actual), 0], [0, 0, 1]])
        distance = np.linalg.norm(self.probe - turn @ MOUNT_M) - DEAD_M
        return 1e3 * float(distance + self.noise.normal(0.0, NOISE_M))

    def tell_angle(self):
        if self.mode["angle"] == "float":
            self.angles.publish(Float64(data=degrees(self.angle) % 360.0))
            return
        state = JointState(name=["rail", "rotary"], position=[5.0, degrees(self.angle)])
        state.velocity = [0.0, 0.0] if self.mode["angle"] == "joint" else []
        stamp(state, time.time_ns())
        self.angles.publish(state)

    def tell_length(self):
        if self.mode["length"] == "vector":
            message = Vector3Stamped()
            message.vector.x, message.vector.y = self.length_mm(), 1.0
            stamp(message, time.time_ns())
            self.lengths.publish(message)
            return
        text = self.mode["length"] == "text"
        self.lengths.publish(String(data="1 m") if text else Float64(data=self.length_mm()))

    def tell_burst(self):
        for _ in range(30):
            self.tell_length()
            time.sleep(0.002)

    def tell_probe(self):
        message = self.mode["probe"]()
        field = {PoseStamped: "pose", PointStamped: "point", Vector3Stamped: "vector"}
        place = getattr(message, field[type(message)])
        place = getattr(place, "position", place)
        place.x, place.y, place.z = (1e3 * self.probe).tolist()
        stamp(message, time.time_ns())
        self.points.publish(message)

    def shoot(self, _request, response):
        shot = Range(range=self.length_mm(), min_range=0.0, max_range=0.0)
        stamp(shot, time.time_ns() + SHOT_AHEAD_NS)
        self.lengths.publish(shot)
        response.success = True
        return response


def stamp(message, stamp_ns):
    """Stamp a message."""
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(ForeignCell(sys.argv[1]))
