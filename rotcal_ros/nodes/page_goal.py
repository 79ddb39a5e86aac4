"""Following the goal of a planner from outside: any node may, whoever sent it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from action_msgs.msg import GoalStatus, GoalStatusArray
from action_msgs.srv import CancelGoal
from rclpy.qos import qos_profile_action_status_default
from rotcal_msgs.action import Calibrate
from std_srvs.srv import Trigger

from rotcal_ros.nodes.cell_node import CellNode
from rotcal_ros.nodes.outcome import Feedback, Outcome
from rotcal_ros.nodes.qos import VIEW
from rotcal_ros.page.app import Answer
from rotcal_ros.page.state import Steps

RUNNING = (GoalStatus.STATUS_ACCEPTED, GoalStatus.STATUS_EXECUTING, GoalStatus.STATUS_CANCELING)


class FollowedGoal:
    """The latest goal of the action ``calibrate``: its feedback, and how it ended.

    ``begun`` is called with every new goal. ``outcome`` is None while it runs.
    """

    def __init__(self, node: CellNode, begun: Callable[[], None]) -> None:
        self._begun = begun
        self._id: Any = None
        self.running = self.stopping = False
        self.feedback: Feedback | None = None
        self.outcome: Outcome | None = None
        impl = Calibrate.Impl
        node.listen(impl.FeedbackMessage, "calibrate/_action/feedback", self._hear, VIEW)
        node.listen(
            GoalStatusArray,
            "calibrate/_action/status",
            self._look,
            qos_profile_action_status_default,
        )
        self._result = node.create_client(impl.GetResultService, "calibrate/_action/get_result")
        self._cancel = node.create_client(CancelGoal, "calibrate/_action/cancel_goal")
        self._resume = node.create_client(Trigger, "resume")

    @property
    def settled(self) -> bool:
        """Whether nothing more is to be heard of a goal."""
        return self._id is None or self.outcome is not None

    def steps(self) -> Steps | None:
        """Return how far the goal has come, None before its first feedback."""
        heard = self.feedback
        if heard is None:
            return None
        left_s = None if self.outcome or heard.instruction else heard.time_left_s
        return Steps(
            step=heard.step,
            total=heard.total,
            accepted=heard.accepted,
            rejected=heard.rejected,
            left=heard.left,
            end_s=None if left_s is None else round(time.time() + left_s, 1),
        )

    async def resume(self, instruction: str) -> Answer:
        """Tell the planner that the work of this instruction is done, once."""
        asked = self.feedback
        if asked is None or not asked.instruction:
            return Answer(False, "nothing waits for resume")
        if instruction != asked.instruction:
            return Answer(False, "something else is asked for now")
        if not self._resume.service_is_ready():
            return Answer(False, "the planner does not answer")
        # A second click finds nothing asked for until the planner has spoken again.
        self.feedback = continuing = replace(asked, activity="going on")
        answer = await self._resume.call_async(Trigger.Request())
        if not answer.success and self.feedback is continuing:
            self.feedback = asked
        return Answer(answer.success, answer.message or "the calibration goes on")

    async def stop(self) -> Answer:
        """Cancel the goal that is followed, and no other."""
        if self._id is None or not self.running:
            return Answer(False, "no calibration runs")
        request = CancelGoal.Request()
        request.goal_info.goal_id = self._id
        answer = await self._cancel.call_async(request)
        self.stopping = answer.return_code == CancelGoal.Response.ERROR_NONE
        return Answer(self.stopping, "stopping" if self.stopping else "it has ended already")

    def _look(self, message: GoalStatusArray) -> None:
        goals = sorted(message.status_list, key=lambda s: _time(s.goal_info.stamp))
        if not goals:
            return
        latest = goals[-1]
        if self._id is None or bytes(latest.goal_info.goal_id.uuid) != bytes(self._id.uuid):
            self._id = latest.goal_info.goal_id
            self.feedback, self.outcome, self.stopping = None, None, False
            self._begun()
            self._ask_for_the_end(self._id)
        self.running = latest.status in RUNNING
        self.stopping = self.stopping or latest.status == GoalStatus.STATUS_CANCELING

    def _ask_for_the_end(self, goal_id: Any) -> None:
        request = Calibrate.Impl.GetResultService.Request(goal_id=goal_id)

        def note(future: Any) -> None:
            if goal_id is self._id and future.exception() is None:
                self.outcome, self.running = Outcome.of(future.result()), False

        self._result.call_async(request).add_done_callback(note)

    def _hear(self, message: Any) -> None:
        if self._id is not None and bytes(message.goal_id.uuid) == bytes(self._id.uuid):
            self.feedback = Feedback.of(message.feedback)


def _time(stamp: Any) -> tuple[int, int]:
    return stamp.sec, stamp.nanosec
