"""Orders table angles, and says where the table has come to rest.

Its arguments are angles (deg); each is ordered half a second after the one before.
"""

import sys
import time
from math import degrees, radians

import rclpy
from rclpy.node import Node
from rotcal_msgs.msg import TableAngle
from sensor_msgs.msg import JointState

from rotcal_ros.nodes.runtime.qos import EVENT, STREAM

APART_S = 0.5


class Orders(Node):
    def __init__(self, angles):
        super().__init__("orders")
        self.angles, self.next_s, self.step, self.rest = angles, 0.0, 0, ""
        self.orders = self.create_publisher(TableAngle, "table_angle", EVENT)
        self.create_subscription(JointState, "joint_states", self.receive, STREAM)
        self.create_timer(0.05, self.order)

    def order(self):
        now = time.monotonic()
        if not self.angles or now < self.next_s or not self.orders.get_subscription_count():
            return
        self.next_s = now + APART_S
        self.step += 1
        self.orders.publish(TableAngle(step=self.step, angle=radians(self.angles.pop(0))))

    def receive(self, state):
        rest = f"at rest at {degrees(state.position[0]):.3f} deg"
        if abs(state.velocity[0]) < 1e-6 and rest != self.rest:
            self.rest = rest
            print(rest, flush=True)  # noqa: T201


if __name__ == "__main__":
    rclpy.init()
    node = Orders([float(angle) for angle in sys.argv[1].split(",")])
    while rclpy.ok():
        rclpy.spin_once(node, timeout_sec=0.1)
