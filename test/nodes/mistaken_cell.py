"""A cell that works, but for one mistake of those who integrated it: mistaken_cell.py MISTAKE.

Table, tracer on it, probe and thermometer. Its table obeys table_angle; with a mistake that begins
with "adapter" it is the joint of a controller instead, behind /NAMESPACE/hw.
"""

import sys
import time
from collections import deque
from contextlib import suppress
from math import cos, degrees, hypot, sin

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.qos import DurabilityPolicy, QoSProfile
from rotcal_msgs.msg import ProbePoint, ProbeTarget, TableAngle, TracerLength
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectory

PROBE = (0.31, -0.22, 0.74)
TRACER = (0.3, 0.05, 0.15)
SPEED = 0.1  # rad/s
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class MistakenCell:
    def __init__(self, mistake):
        self.node, self.mistake = rclpy.create_node("foreign"), mistake
        self.angle, self.goal, self.ordered_s = 0.7, 0.7, 0.0
        self.lived_s = time.monotonic()
        self.told = deque(maxlen=15)  # 0.6 s
        behind = mistake.startswith("adapter")
        make = self.node.create_publisher
        self.states = [make(JointState, "hw/joint_states" if behind else "joint_states", 50)]
        if "second table" in mistake:
            other = rclpy.create_node("simulator")
            self.states.append(other.create_publisher(JointState, self.states[0].topic_name, 50))
        self.lengths = make(
            String if mistake == "other type" else TracerLength, "tracer_length", 50
        )
        self.points = make(ProbePoint, "probe_point", 50)
        self.air = make(Temperature, "temperature", 50)
        self.node.create_subscription(ProbeTarget, "probe_target", lambda _: None, 10)
        if behind:
            self.controller()
        else:
            qos = LATCHED if mistake == "latched orders" else 10
            self.node.create_subscription(TableAngle, "table_angle", self.order, qos)
        if mistake == "second planner":
            make(TableAngle, "table_angle", 10)
        self.node.create_timer(0.2 if "5 Hz" in mistake else 0.04, self.tell_table)
        self.node.create_timer(0.04, self.tell_tracer)
        self.node.create_timer(0.25, self.tell_rest)

    def controller(self):
        if self.mistake == "adapter, positions":
            self.node.create_subscription(Float64MultiArray, "hw/table/commands", print, 10)
        elif self.mistake != "adapter, not active":
            take = self.follow
            self.node.create_subscription(JointTrajectory, "hw/table/joint_trajectory", take, 10)

    def order(self, message):
        self.goal, self.ordered_s = message.angle, time.monotonic()

    def follow(self, message):
        self.goal, self.ordered_s = message.points[-1].positions[0], time.monotonic()

    def live(self):
        """Turn the table for the time that went by; return whether it moves."""
        now_s = time.monotonic()
        step = SPEED * (now_s - self.lived_s)
        self.lived_s = now_s
        if self.mistake == "stands still" or now_s - self.ordered_s < 0.1:
            return False
        way = self.goal - self.angle
        self.angle = self.goal if abs(way) <= step else self.angle + step * (1 if way > 0 else -1)
        return self.angle != self.goal

    def tell_table(self):
        wrong = self.mistake
        self.told.append((self.live(), self.angle))
        moving, shown = self.told[0] if wrong == "late feedback" else self.told[-1]
        if "degrees" in wrong:
            shown = degrees(shown)
        if wrong == "other sign":
            shown = -shown
        state = JointState(name=["arm", "C" if "other joint" in wrong else "rotary"])
        told = SPEED if moving else 0.0
        state.velocity = [] if "no velocity" in wrong else [0.0, 0.0 if wrong == "rests" else told]
        behind_s = 0.4 if "table's clock" in wrong else 0.0
        for number, publisher in enumerate(self.states):
            state.position = [0.4, shown + 0.1 * number]
            publisher.publish(self.stamped(state, behind_s))

    def tell_tracer(self):
        if self.mistake == "other type":
            self.lengths.publish(String(data="0.3"))
            return
        turned = -self.angle if self.mistake == "clockwise" else self.angle
        x = cos(turned) * TRACER[0] - sin(turned) * TRACER[1]
        y = sin(turned) * TRACER[0] + cos(turned) * TRACER[1]
        away = hypot(PROBE[0] - x, PROBE[1] - y, PROBE[2] - TRACER[2]) - 0.1
        away *= {"lengths in mm": 1e3, "lengths too small": 1e-3}.get(self.mistake, 1.0)
        broken = self.mistake == "no beam"
        status = TracerLength.STATUS_BEAM_BROKEN if broken else TracerLength.STATUS_OK
        behind_s = {"tracer's clock": 0.4, "tracer's clock far": 4.0}.get(self.mistake, 0.0)
        self.lengths.publish(self.stamped(TracerLength(length=away, status=status), behind_s))

    def tell_rest(self):
        factor = {"probe in mm": 1e3, "probe too small": 1e-3}.get(self.mistake, 1.0)
        point = ProbePoint(position=[factor * x for x in PROBE])
        frame = "base" if self.mistake == "other frame" else ""
        self.points.publish(self.stamped(point, frame=frame))
        air = Temperature(temperature=293.15 if self.mistake == "kelvin" else 20.0)
        self.air.publish(self.stamped(air))

    def stamped(self, message, behind_s=0.0, frame=""):
        now_ns = time.time_ns() - round(behind_s * 1e9)
        if self.mistake != "no stamps":
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(now_ns, 1_000_000_000)
        message.header.frame_id = frame
        return message


def main():
    rclpy.init(args=sys.argv)
    cell = MistakenCell(sys.argv[1])
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(cell.node)


if __name__ == "__main__":
    main()
