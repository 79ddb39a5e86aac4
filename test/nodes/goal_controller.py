"""The machine of joint_controller.py with the action of joint_trajectory_controller too.

A goal of other joints is rejected, a new one takes the place of the one before, and one that is
not reached is given up by the tolerance of its goal. What goes wrong: ``rejects goals``,
``stalls``, ``says succeeded`` (1 degree off), ``falls silent``.
"""

import sys
import time
from math import radians

import rclpy
from control_msgs.action import FollowJointTrajectory
from joint_controller import Machine
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.task import Future

Result = FollowJointTrajectory.Result
OFF = radians(1.0)
GOAL_TIME_S = 0.5


class GoalMachine(Machine):
    def __init__(self, wrong, since):
        super().__init__(wrong, since)
        self.result, self.goal, self.until_s = None, 0.0, 0.0
        self.server = ActionServer(
            self, FollowJointTrajectory, "/drive/follow_joint_trajectory", self.execute,
            goal_callback=self.judge, cancel_callback=lambda _: CancelResponse.ACCEPT,
        )  # fmt: skip

    def judge(self, goal):
        good = goal.trajectory.joint_names == ["rotary"] and not self.fails("rejects goals")
        return GoalResponse.ACCEPT if good else GoalResponse.REJECT

    async def execute(self, handle):
        self.end(Result(error_code=-1, error_string="a newer goal came"))
        points = handle.request.trajectory.points
        self.goal, last = points[-1].positions[0], points[-1].time_from_start
        self.take(handle.request.trajectory)
        if self.fails("says succeeded"):
            self.stops[-1] = (self.stops[-1][0], self.goal - OFF)
        self.until_s = time.monotonic() + last.sec + last.nanosec * 1e-9 + GOAL_TIME_S
        mine = self.result = Future()
        result = await mine
        if result.error_code:
            handle.abort()
        else:
            handle.succeed()
        return result

    def turn(self):
        super().turn()
        if self.fails("falls silent"):
            return
        near = abs(self.angle - self.goal) < 1e-6
        if near or (self.fails("says succeeded") and self.angle == self.goal - OFF):
            self.end(Result())
        elif time.monotonic() > self.until_s:
            self.end(Result(error_code=-5, error_string="not there\x1b[2J in time"))

    def end(self, result):
        if self.result is not None and not self.result.done():
            self.result.set_result(result)


def main():
    rclpy.init()
    machine = GoalMachine(sys.argv[1], int(sys.argv[2]))
    while rclpy.ok():
        rclpy.spin_once(machine, timeout_sec=0.1)


if __name__ == "__main__":
    main()
