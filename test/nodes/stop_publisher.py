"""The safety controller of somebody else: says on /safety/estop what it is told on standard input.

``true`` and ``false`` go out as they come; ``error`` and ``ok`` as the status of a drive on
/diagnostics. The argument ``volatile`` or ``latched`` is its quality of service.
"""

import sys
from contextlib import suppress
from threading import Thread

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Bool

LEVELS = {"ok": DiagnosticStatus.OK, "error": DiagnosticStatus.ERROR}
rclpy.init()
node = Node("safety_controller")
latched = sys.argv[1] == "latched"
durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
stops = node.create_publisher(Bool, "/safety/estop", QoSProfile(depth=1, durability=durability))
diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", 10)


def listen():
    for line in sys.stdin:
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
