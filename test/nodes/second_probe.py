"""Somebody who joins a run: points 15 um off, a table turned away, forged observations."""

import sys

import rclpy
from rclpy.node import Node
from rotcal_msgs.msg import Observation, ProbePoint
from sensor_msgs.msg import JointState

from rotcal_ros.nodes.runtime.qos import EVENT, STREAM

OFF_M = 15e-6
MARK = "second"


class SecondProbe(Node):
    """Everything it hears it says again, wrongly."""

    def __init__(self):
        super().__init__("second_probe", namespace="/cell")
        self._again(ProbePoint, "probe_point", EVENT)
        self._again(JointState, "joint_states", STREAM)
        self._again(Observation, "observation", EVENT)

    def _again(self, kind, topic, qos):
        publisher = self.create_publisher(kind, topic, qos)

        def say(message):
            if message.header.frame_id != MARK:
                message.header.frame_id = MARK
                self._spoil(message)
                publisher.publish(message)

        self.create_subscription(kind, topic, say, qos)

    def _spoil(self, message):
        if isinstance(message, JointState):
            message.position = [1.0 + angle for angle in message.position]
        elif isinstance(message, ProbePoint):
            message.position = [x + OFF_M for x in message.position]
            message.point += 100
        else:
            message.mean = [x + OFF_M for x in message.mean]


if __name__ == "__main__":
    rclpy.init()
    probe = SecondProbe()
    sys.stderr.write("here\n")
    rclpy.spin(probe)
