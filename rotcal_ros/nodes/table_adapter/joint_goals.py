"""A joint moved by goals of FollowJointTrajectory: the controller reports how each goal ends."""

from __future__ import annotations

from functools import partial
from typing import Any, Final

from action_msgs.msg import GoalStatus
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionClient

from rotcal_ros.foundation.escapes import printable
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.table_adapter.joint_controllers import (
    ControllerReport,
    JointController,
    trajectory_message,
)
from rotcal_ros.planning.approach import JointPath

ERRORS: Final = {
    -1: "invalid goal",
    -2: "invalid joints",
    -3: "its stamp is too old",
    -4: "the tolerance of the path was violated",
    -5: "the tolerance of the goal was violated",
}
"""What the error codes of a result mean."""
MOST_SAID: Final = 200
"""Characters of a controller's own words that are passed on."""


class GoalController(JointController):
    """joint_trajectory_controller by its action. The tolerances are those of the controller."""

    def __init__(self, node: CellNode, controller: str, joint: str) -> None:
        self._controller, self._joint = controller, joint
        self._guarded = node.health.guarded
        self._client = ActionClient(
            node, FollowJointTrajectory, f"{controller}/follow_joint_trajectory"
        )
        self._latest: JointPath | None = None
        self._handle: Any = None
        self._report = ControllerReport()

    def heard(self) -> bool:
        """Return whether the action is offered."""
        return bool(self._client.server_is_ready())

    def send(self, way: JointPath) -> None:
        """Send a goal; the controller gives up the previous one by itself."""
        self._latest, self._handle, self._report = way, None, ControllerReport()
        goal = FollowJointTrajectory.Goal(trajectory=trajectory_message(self._joint, way))
        answer = self._client.send_goal_async(goal)
        answer.add_done_callback(self._guarded(partial(self._answered, way)))

    def halt(self) -> str:
        """Cancel the goal, also one that is not accepted yet: the controller holds the joint."""
        if self._handle is not None:
            self._handle.cancel_goal_async()
        self._latest = self._handle = None
        return "its goal is canceled"

    def report(self) -> ControllerReport:
        """Return what the controller says of the latest goal."""
        return self._report

    def _answered(self, way: JointPath, answer: Any) -> None:
        """Hear whether a goal was accepted."""
        handle = answer.result()
        if self._latest is None and handle.accepted:
            handle.cancel_goal_async()
        if way is not self._latest:
            return
        if not handle.accepted:
            self._say("rejected the goal", "is it active, and does it move this joint?")
            return
        self._handle = handle
        handle.get_result_async().add_done_callback(self._guarded(partial(self._ended, way)))

    def _ended(self, way: JointPath, ending: Any) -> None:
        """Hear what became of a goal; one that a newer one replaced does not matter."""
        ended = ending.result()
        if way is not self._latest:
            return
        if ended.status == GoalStatus.STATUS_CANCELED:
            self._say("canceled the goal", "another client asked it to, or it was deactivated")
        elif ended.status != GoalStatus.STATUS_SUCCEEDED or ended.result.error_code:
            code, own = ended.result.error_code, ended.result.error_string[:MOST_SAID]
            why = f"{ERRORS.get(code, 'unknown reason')} (error {code})"
            self._say("gave the goal up", f"{why}, {printable(own)}" if own else why)
        else:
            self._report = ControllerReport(done=True)

    def _say(self, what: str, why: str) -> None:
        assert self._latest is not None
        goal_deg = self._latest.goal / DEGREE
        self._report = ControllerReport(f"{self._controller} {what} of {goal_deg:.4f} deg: {why}")
