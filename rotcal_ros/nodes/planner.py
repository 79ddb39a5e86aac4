"""The planner: turns one goal into a finished calibration, step by step.

A lifecycle node with the action ``calibrate``; one goal at a time.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any, Final

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.service_introspection import ServiceIntrospectionState
from rotcal_msgs.action import Calibrate

from rotcal_ros.foundation.errors import RotcalError
from rotcal_ros.foundation.node_state import NodeState, State
from rotcal_ros.foundation.plugins import in_words
from rotcal_ros.methods import prepare_to_measure
from rotcal_ros.nodes.goal.cell_links import CellLinks
from rotcal_ros.nodes.goal.crew import Codes, Crew
from rotcal_ros.nodes.goal.goal_watch import GoalWatch
from rotcal_ros.nodes.goal.operator_requests import require_free
from rotcal_ros.nodes.goal.pauses import Pauses
from rotcal_ros.nodes.goal.progress import GoalProgress
from rotcal_ros.nodes.goal.run import GoalRun
from rotcal_ros.nodes.runtime.cell_node import IDLE_S, CellNode
from rotcal_ros.nodes.runtime.conversions import feedback_message
from rotcal_ros.nodes.runtime.emergency_stop import EmergencyStop
from rotcal_ros.nodes.runtime.plans import PlannerParameters, read_continuation
from rotcal_ros.nodes.runtime.qos import GOAL
from rotcal_ros.nodes.runtime.running import done_aside, run

RESULT_TIMEOUT_S: Final = 3600
FEEDBACK_PERIOD_S: Final = 0.1
NO_ORDERS: Final = "the planner orders nothing; a recording goes on"
RESTART_WAIT_S: Final = 20.0
"""A goal waits so long for a lost node of the suite to be restarted."""


class Planner(CellNode):
    """Commands the cell from the first step to the result."""

    def __init__(self) -> None:
        super().__init__("planner")

    def configure(self) -> None:
        """Read the configuration, and offer to calibrate."""
        self._run: GoalRun | None = None
        self._preparing, self._shown_s = False, -math.inf
        self._giving_up: str | None = None
        self._given_up: str | None = None
        self._configured = PlannerParameters(self)
        self._continuation = read_continuation(self)
        text = "s, how long a goal waits for lost nodes of the suite"
        self._restart_wait_s = self.parameter("restart_wait_s", RESTART_WAIT_S, text)
        self._links = CellLinks(self)
        self._stop = EmergencyStop(self, self._configured.safety, NO_ORDERS)
        self._pauses = Pauses(self, self._require_free, self._in_words)
        self._server = ActionServer(
            self,
            Calibrate,
            "calibrate",
            self._execute,
            goal_callback=self._judge_goal,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            result_timeout=RESULT_TIMEOUT_S,
        )
        if hasattr(self._server, "configure_introspection"):  # from Kilted on
            contents = ServiceIntrospectionState.CONTENTS
            self._server.configure_introspection(self.get_clock(), GOAL, contents)

    def activated(self) -> None:
        """Take goals."""
        self._giving_up = None

    def deactivated(self) -> None:
        """Give up the running goal; no other is accepted."""
        self._give_up("the planner was deactivated")

    def judge_parameters(self, changes: Mapping[str, Any]) -> None:
        """Raise ConfigurationError where no goal could be measured with these parameters."""
        if self.configured:
            self._configured.judge(changes)

    def begin_stop(self) -> None:
        """End the running goal with a valid bag."""
        self._give_up("the planner was ended")

    def stopped(self) -> bool:
        """Return whether no goal runs any more."""
        return not self.configured or (self._run is None and not self._preparing)

    def gather_s(self) -> float:
        """Let messages gather until there is a goal."""
        return IDLE_S if self.stopped() else 0.0

    def _give_up(self, why: str) -> None:
        self._giving_up = self._given_up = why
        if self._run is not None:
            self._run.watch.stopping = why

    def _judge_goal(self, _goal: Calibrate.Goal) -> GoalResponse:
        """Refuse a goal while another runs; the heartbeat tells the reason to the client."""
        free = self._run is None and not self._preparing
        if self.active and not self._giving_up and free:
            self._given_up = None
            return GoalResponse.ACCEPT
        self.get_logger().warning(f"goal refused: the planner is {self._in_words()}")
        return GoalResponse.REJECT

    def _in_words(self) -> str:
        """Return how the planner stands, for a person to read."""
        return self._beat_values()[0].in_words()

    def _require_free(self) -> None:
        """Raise NotFreeError where the running goal cannot be resumed yet."""
        if self._run is not None:
            require_free(self._run.watch)

    async def _execute(self, handle: ServerGoalHandle) -> Codes:
        try:
            goal = await self._prepared(handle)
        except RotcalError as error:
            handle.abort()
            return Codes(error_code=Codes.BAD_CONFIGURATION, error_msg=str(error))
        except Exception as error:
            handle.abort()
            return self._unknown(error)
        self._run = goal
        goal.watch.stopping = self._given_up  # meanwhile, even if it is active again
        try:
            outcome = await goal.execute()
        except Exception as error:
            outcome = self._unknown(error)
            await goal.bag.close_after_failure()
        finally:
            self._run = None
        self._end(handle, outcome, goal.verdict_line)
        return outcome

    def _unknown(self, error: Exception) -> Codes:
        self.health.note_error("goal", error)
        return Codes(error_code=Codes.UNKNOWN, error_msg=in_words(error))

    async def _prepared(self, handle: ServerGoalHandle) -> GoalRun:
        """Return :meth:`_prepare`, which may plan for seconds; the node goes on meanwhile."""
        self._preparing = True
        try:
            return await done_aside(self._prepare, handle)
        finally:
            self._preparing = False

    def _prepare(self, handle: ServerGoalHandle) -> GoalRun:
        """Return the run of a goal; ConfigurationError or PlanError when it is impossible."""
        calibration = prepare_to_measure(self._configured.configuration(handle.request))
        continuation, self._continuation = self._continuation, None
        plan_id, start_index = calibration.configuration.plan_id, handle.request.start_index
        asked = (plan_id, start_index)
        if continuation is None or (continuation.plan_id, continuation.start_index) != asked:
            calibration.plan.step(start_index)  # PlanError when there is no such step
            continuation = calibration.from_the_start(start_index)
        watch = GoalWatch(
            calibration.configuration.planner,
            self._links,
            self._stop,
            self._pauses,
            GoalProgress(
                total=len(calibration.plan.steps),
                step=continuation.start_index,
                left=len(continuation.steps),
            ),
            show=lambda progress: self._show(handle, progress),
            canceled=lambda: handle.is_cancel_requested,
            crew=Crew(self.health, self._restart_wait_s),
            patience_s=calibration.configuration.planner.preflight_timeout_s,
        )
        return GoalRun(calibration, continuation, watch)

    def _end(self, handle: ServerGoalHandle, outcome: Codes, verdict_line: str) -> None:
        if outcome.error_code == Codes.NONE:
            self.get_logger().info(f"calibration done, verdict {verdict_line}")
            handle.succeed()
            return
        self.get_logger().error(f"calibration ended: {outcome.error_msg}")
        if handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.abort()

    def _show(self, handle: ServerGoalHandle, progress: GoalProgress) -> None:
        """Publish feedback, not more often than a person can follow."""
        now = time.monotonic()
        measuring = 0 < progress.step < progress.total
        if now - self._shown_s < FEEDBACK_PERIOD_S and measuring and not self._pauses.waiting:
            return
        self._shown_s = now
        handle.publish_feedback(feedback_message(progress, self._links.current_std))

    def _report(self) -> tuple[NodeState, dict[str, Any]]:
        if self._run is None:
            return NodeState(State.PREPARING if self._preparing else State.READY), {}
        progress = self._run.watch.progress
        doing = (progress.doing,)
        state = NodeState(State.CALIBRATING, doing, progress.step, progress.total)
        return state, self._run.values()


def main() -> None:
    """Run the planner."""
    run(Planner)


if __name__ == "__main__":
    main()
