"""A robot that carries the instrument: reads ``pause``, goes there, calls ``resume``.

What it read stands on standard output, one line of JSON for each place. Where an emergency stop
came while it was on its way, ``resume`` is refused: a person looks, and resumes.
"""

import json
import sys
from contextlib import suppress

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rotcal_msgs.msg import Pause
from std_srvs.srv import Trigger

rclpy.init()
node = Node("carrying_robot", namespace="/cell")
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def carry(pause):
    if not pause.waiting or pause.kind != Pause.KIND_MOVE:
        return
    place = {"what": pause.what, "station": pause.station, "position": list(pause.position)}
    sys.stdout.write(json.dumps({**place, "frame": pause.header.frame_id, "step": pause.step}))
    sys.stdout.write("\n")
    sys.stdout.flush()
    answer = node.create_client(Trigger, pause.resume).call_async(Trigger.Request())
    answer.add_done_callback(hear)


def hear(answer):
    """Leave it to a person where ``resume`` was refused: never just call it again."""
    if not answer.result().success:
        node.get_logger().warning(answer.result().message)


node.create_subscription(Pause, "pause", carry, latched)
with suppress(ExternalShutdownException):
    rclpy.spin(node)
