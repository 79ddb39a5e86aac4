"""A node that publishes a plan which is nobody's, once for each line on its standard input."""

import sys

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rotcal_msgs.msg import CalibrationPlan

from rotcal_ros.nodes.runtime.qos import LATCHED

if __name__ == "__main__":
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # a signal ends it
    node = Node("stranger", namespace="/cell")
    publisher = node.create_publisher(CalibrationPlan, "plan", LATCHED)
    for line in sys.stdin:
        publisher.publish(CalibrationPlan(plan_id=line.strip(), total_steps=3))
