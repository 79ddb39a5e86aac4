"""The operator's page: shows in a browser what the cell does, and passes on a person's requests.

It receives what the nodes publish anyway and does not subscribe to instruments; no node waits for
it. FollowedGoal follows the planner's latest goal, whoever sent it.
"""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from typing import Any, Final

from action_msgs.msg import GoalStatus, GoalStatusArray
from action_msgs.srv import CancelGoal
from rclpy.qos import qos_profile_action_status_default
from rotcal_msgs.action import Calibrate
from std_srvs.srv import Trigger

from rotcal_ros.extensions.page.app import Answer
from rotcal_ros.extensions.page.board import Board, Course
from rotcal_ros.extensions.page.headline import HeardPlanner, now
from rotcal_ros.extensions.page.node import sections as page_sections
from rotcal_ros.extensions.page.node.topics import CapturedValues, PageTopics
from rotcal_ros.extensions.page.node.waiting_table import WaitingTable
from rotcal_ros.extensions.page.server import PageServer
from rotcal_ros.extensions.page.settings import PageSettings
from rotcal_ros.extensions.page.state import Cell, ShownUncertainty, StepProgress
from rotcal_ros.foundation.node_state import LOADING, NodeState, Reason, State, Why
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.nodes.client.calibrator import Feedback, Outcome
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.runtime.health import PLANNER
from rotcal_ros.nodes.runtime.qos import VIEW
from rotcal_ros.nodes.runtime.running import run

PERIOD_S: Final = 0.25
LAST_WORD_S: Final = 2.0
"""Time to wait for the end of a goal: its client may hear of it earlier and end the nodes."""


class OperatorPage(CellNode):
    """Turns messages and beats into the sections of the page."""

    def __init__(self) -> None:
        super().__init__("operator_page")

    def configure(self) -> None:
        """Serve the page."""
        settings = self.settings("page", PageSettings)
        self.board = Board()
        self._streams = CapturedValues()
        self._course = Course()
        self._drawn: float | None = None
        self._beat: object = None
        self._ending_s: float | None = None
        self._goal = FollowedGoal(self, self._begin)
        self._table = WaitingTable(self)
        self._topics = PageTopics(self, self.board)
        if "simulation" in self.given:
            self.board.show(cell=Cell(simulated=True))
        self.every(PERIOD_S, self._look)
        self._server = PageServer(settings, self.board, self)
        self.get_logger().info(f"page: {self._server.address}")

    def resume(self, instruction: str) -> Future[Answer]:
        """Go on after a person's work; called from the server's thread."""
        return self._asked(partial(self._goal.resume, instruction))

    def stop(self) -> Future[Answer]:
        """Cancel the goal; called from the server's thread."""
        return self._asked(self._goal.stop)

    def apply(self, confirmation: str, secret: str) -> Future[Answer]:
        """Confirm a table; called from the server's thread."""
        return self._asked(partial(self._table.apply, confirmation, secret))

    def begin_stop(self) -> None:
        """Wait for the last message of the planner, then tell the viewers the end."""
        self._ending_s = time.monotonic()

    def stopped(self) -> bool:
        """Return whether the viewers know how it ended."""
        assert self._ending_s is not None
        if self._goal.settled or time.monotonic() - self._ending_s > LAST_WORD_S:
            if not self.board.state.ended:
                self._look()
                self._server.close()
            return self._server.closed
        return False

    def _asked(self, work: Callable[[], Awaitable[Answer]]) -> Future[Answer]:
        """Run ``work`` in the executor; the future is for the thread of the server."""
        future: Future[Answer] = Future()

        async def do() -> None:
            try:
                inactive = Answer(False, str(self.not_active_error()))
                answer = await work() if self.active else inactive
                future.set_result(answer)
            except Exception as error:
                self.health.note_error("request of a person", error)
                future.set_result(Answer(False, str(error)))

        self.executor.create_task(do)
        return future

    def _begin(self) -> None:
        """Forget what belongs to an earlier goal."""
        self._course, self._drawn = Course(), None
        self._topics.begin()
        self.board.show(standing=ShownUncertainty(), recording=None)

    def _look(self) -> None:
        """Update what the heartbeats show."""
        health, goal = self.health, self._goal
        capture = health.others.get("capture")
        if capture is not None and capture is not self._beat:
            self._beat = capture
            self._streams.hear(health.values("capture"))
        offer = self._table.offer()
        self.board.show(
            now=now(self._heard(), offer),
            steps=goal.steps(),
            standing=self._standing(),
            lengths=self._streams.lengths(),
            length_course=self._streams.length_course(),
            temperatures=self._streams.temperatures(),
            nodes=page_sections.nodes(health),
            streams=self._streams.streams(),
            # An idle recorder says nothing more about the bag that it closed.
            recording=page_sections.recording(health.values("recorder"))
            or self.board.state.recording,
            offer=offer,
        )

    def _heard(self) -> HeardPlanner:
        health, goal = self.health, self._goal
        feedback, outcome = goal.feedback, goal.outcome
        return HeardPlanner(
            planner=health.node_state(PLANNER),
            silent=PLANNER in health.lost,
            calibrating=goal.running or (outcome is None and health.is_calibrating()),
            doing=feedback.doing if feedback else Why.UNKNOWN,
            activity=feedback.activity if feedback else "",
            instruction=feedback.instruction if feedback else "",
            stopping=goal.stopping,
            ended=outcome is not None,
            canceled=outcome is not None and outcome.canceled,
            verdict=outcome.verdict if outcome else "",
            error=outcome.error_msg if outcome else "",
        )

    def _standing(self) -> ShownUncertainty:
        """Return U of the curve, and if there is a goal the policy's figure beside it."""
        feedback, curve = self._goal.feedback, self._topics.uncertainty
        if feedback is None:
            return self.board.state.standing
        if curve is not None and curve != self._drawn:
            self._drawn = curve
            self._course.add(feedback.accepted, round(curve / ARCSEC, 4))
        if self._topics.withheld:
            return ShownUncertainty(withheld=self._topics.withheld)
        rms, goal = feedback.uncertainty_rad, feedback.goal_rad
        return ShownUncertainty(
            largest_arcsec=None if curve is None else round(curve / ARCSEC, 4),
            rms_arcsec=None if rms is None else round(rms / ARCSEC, 4),
            goal_arcsec=None if goal is None else goal / ARCSEC,
            course=self._course.points,
        )

    def _report(self) -> tuple[NodeState, dict[str, Any]]:
        address = self._server.address
        if self._topics.loading:
            return replace(LOADING, page=address), {}
        serving = Reason.of(Why.SERVING, address)
        return NodeState(State.READY, (serving,), page=address), {}


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
        """Whether nothing more will be heard of a goal."""
        return self._id is None or self.outcome is not None

    def steps(self) -> StepProgress | None:
        """Return how far the goal has come, None before its first feedback."""
        heard = self.feedback
        if heard is None:
            return None
        left_s = None if self.outcome or heard.instruction else heard.time_left_s
        return StepProgress(
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
        going_on = Reason(Why.GOING_ON)
        self.feedback = continuing = replace(
            asked, doing=going_on.code, activity=going_on.in_words(), instruction=""
        )
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


def main() -> None:
    """Run the operator's page."""
    run(OperatorPage)


if __name__ == "__main__":
    main()
