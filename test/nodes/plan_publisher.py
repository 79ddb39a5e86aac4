"""A node that publishes a plan which is nobody's, until it is ended."""

import time

import rclpy
from rclpy.node import Node
from rotcal_msgs.msg import CalibrationPlan

from rotcal_ros.nodes.qos import LATCHED

if __name__ == "__main__":
    rclpy.init()
    node = Node("stranger", namespace="/cell")
    publisher = node.create_publisher(CalibrationPlan, "plan", LATCHED)
    publisher.publish(CalibrationPlan(plan_id="nobody's", total_steps=3))
    while rclpy.ok():
        time.sleep(0.1)
