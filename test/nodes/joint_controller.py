"""A machine of somebody else: a joint trajectory controller, its drive and joint_states.

Speaks as ros2_control does: /drive/joint_trajectory or /drive/commands in, /joint_states out,
with a mimic joint and an effort. The actual angle goes out on table_actual for the simulated
tracer. The first argument says what goes wrong, the second from which trajectory on.
"""

import sys
import time

import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

PERIOD_S = 0.005
TO_DEGREES = 57.29577951308232


class Machine(Node):
    def __init__(self, wrong, since):
        super().__init__("machine")
        self.wrong, self.since, self.taken = wrong, since, 0
        self.angle, self.stops, self.begun_s = 0.1, [], 0.0
        self.states = self.create_publisher(JointState, "/joint_states", 10)
        self.actual = self.create_publisher(JointState, "table_actual", 100)
        self.create_subscription(JointTrajectory, "/drive/joint_trajectory", self.take, 10)
        self.create_subscription(Float64MultiArray, "/drive/commands", self.jump, 10)
        self.create_timer(PERIOD_S, self.turn)

    def fails(self, what):
        return self.wrong == what and self.taken >= self.since

    def take(self, message):
        """Take a trajectory as joint_trajectory_controller does: or drop it without a word."""
        self.taken += 1
        if message.joint_names != ["rotary"] or self.fails("rejects"):
            return
        times = [p.time_from_start.sec + p.time_from_start.nanosec * 1e-9 for p in message.points]
        assert times == sorted(times)
        assert all(point.velocities[0] == 0.0 for point in message.points)
        self.begun_s = time.monotonic()
        self.stops = [
            (0.0, self.angle), *zip(times, (p.positions[0] for p in message.points), strict=True)
        ]  # fmt: skip

    def jump(self, message):
        """Follow a position within 2 deg, as a drive with a bound on its error does."""
        self.taken += 1
        if abs(message.data[0] - self.angle) < 2.0 / TO_DEGREES:
            self.angle = message.data[0]

    def turn(self):
        elapsed = time.monotonic() - self.begun_s
        for (before, start), (after, stop) in zip(self.stops, self.stops[1:], strict=False):
            if elapsed < after:
                part = max(0.0, (elapsed - before) / (after - before))
                if self.fails("stalls") and part > 0.5:
                    self.stops = []
                    return self.tell()
                self.angle = start + (stop - start) * part * part * (3 - 2 * part)
                return self.tell()
        if self.stops:
            self.angle = self.stops[-1][1]
        return self.tell()

    def tell(self):
        if self.fails("falls silent"):
            return
        shown = self.angle * (TO_DEGREES if self.wrong == "degrees" else 1.0)
        names = ["arm", "table"] if self.wrong == "other name" else ["arm", "rotary", "follower"]
        stamp = self.get_clock().now().to_msg()
        states = JointState(name=names, position=[0.4, shown, -shown][: len(names)])
        states.effort = [3.0] * len(names)
        actual = JointState(name=["rotary"], position=[self.angle], velocity=[0.0])
        for message, publisher in ((states, self.states), (actual, self.actual)):
            message.header.stamp = stamp
            publisher.publish(message)


def main():
    rclpy.init()
    machine = Machine(sys.argv[1], int(sys.argv[2]))
    while rclpy.ok():
        rclpy.spin_once(machine, timeout_sec=0.1)


if __name__ == "__main__":
    main()
