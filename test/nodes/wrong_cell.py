"""A cell of somebody else with everything wrong that a cell can have: python wrong_cell.py."""

import sys
import time
from contextlib import suppress

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.qos import DurabilityPolicy, QoSProfile
from rotcal_msgs.msg import ProbePoint, TableAngle, TracerLength
from sensor_msgs.msg import JointState, Temperature

BEHIND_S = 4
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def stamped(message, behind_s=0, frame=""):
    now_ns = time.time_ns() - behind_s * 1_000_000_000
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(now_ns, 1_000_000_000)
    message.header.frame_id = frame
    return message


def main():
    rclpy.init(args=sys.argv)
    node = rclpy.create_node("foreign")
    states = node.create_publisher(JointState, "joint_states", 10)
    lengths = node.create_publisher(TracerLength, "tracer_length", 10)
    points = node.create_publisher(ProbePoint, "probe_point", 10)
    air = node.create_publisher(Temperature, "temperature", 10)
    node.create_publisher(TableAngle, "table_angle", 10)
    node.create_subscription(TableAngle, "table_angle", lambda _: None, LATCHED)

    def live():
        states.publish(stamped(JointState(name=["C"], position=[30.0], velocity=[0.0])))
        lengths.publish(stamped(TracerLength(length=350.0, status=TracerLength.STATUS_OK)))
        points.publish(stamped(ProbePoint(), BEHIND_S, "base"))
        air.publish(stamped(Temperature(temperature=293.15)))

    node.create_timer(0.02, live)
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


if __name__ == "__main__":
    main()
