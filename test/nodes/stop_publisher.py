"""The safety controller of somebody else: says on /safety/estop what it is told on standard input.

``true`` and ``false`` go out as they come; ``error`` and ``ok`` as the status of a drive on
/diagnostics. The argument ``volatile`` or ``latched`` is its quality of service. What is volatile
goes out when the nodes that follow as arguments listen, with a reliable subscription each.
"""

import sys
import time
from contextlib import suppress
from threading import Thread

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool

LEVELS = {"ok": DiagnosticStatus.OK, "error": DiagnosticStatus.ERROR}
rclpy.init()
node = Node("safety_controller")
latched = sys.argv[1] == "latched"
durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
stops = node.create_publisher(Bool, "/safety/estop", QoSProfile(depth=1, durability=durability))
diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", 10)


def is_heard(publisher):
    """Return whether all who shall hear it are matched, not only known."""
    known = node.get_subscriptions_info_by_topic(publisher.topic_name)
    ears = {s.node_name for s in known if s.qos_profile.reliability == ReliabilityPolicy.RELIABLE}
    return ears.issuperset(sys.argv[2:]) and publisher.get_subscription_count() >= len(known)


def listen():
    for line in sys.stdin:
        while not (is_heard(stops) and is_heard(diagnostics)):
            time.sleep(0.02)
        for word in line.split():
            if word in LEVELS:
                status = DiagnosticStatus(level=LEVELS[word], name="plc: drive", message="I2t")
                diagnostics.publish(DiagnosticArray(status=[status]))
            else:
                stops.publish(Bool(data=word == "true"))
    rclpy.try_shutdown()


Thread(target=listen, daemon=True).start()
with suppress(ExternalShutdownException):
    rclpy.spin(node)
