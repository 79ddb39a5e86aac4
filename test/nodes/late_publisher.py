"""A publisher that comes late with a quality of service that nobody can receive: best effort."""

import sys

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rotcal_msgs.msg import TracerLength

rclpy.init()
node = Node("late_publisher", namespace="/cell")
node.create_publisher(
    TracerLength, "tracer_length", QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
)
sys.stderr.write("here\n")
rclpy.spin(node)
