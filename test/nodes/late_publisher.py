"""A publisher that comes late with a quality of service that nobody can receive: best effort.

It comes when it is told to by SIGUSR1: nobody has to wait for its imports in the middle of a run.
"""

import signal
import sys

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rotcal_msgs.msg import TracerLength

# before threads are made, which would take the signal
signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGUSR1})
rclpy.init()
node = Node("late_publisher", namespace="/cell")
sys.stderr.write("ready\n")
signal.sigwait({signal.SIGUSR1})
node.create_publisher(
    TracerLength, "tracer_length", QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
)
sys.stderr.write("here\n")
rclpy.spin(node)
