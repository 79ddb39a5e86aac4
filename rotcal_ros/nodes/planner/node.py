"""The planner node: offers the action ``calibrate``, one goal at a time."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any, Final, TypeVar

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rotcal_msgs.action import Calibrate
from rotcal_msgs.msg import CalibrationGoal, CalibrationProgress

from rotcal_ros.foundation.errors import ConfigurationError, RotcalError
from rotcal_ros.foundation.node_state import NodeState, State
from rotcal_ros.foundation.plugins import describe, nearest
from rotcal_ros.foundation.settings import to_mapping
from rotcal_ros.methods import prepare_to_measure
from rotcal_ros.methods.configuration import (
    GROUPS,
    Configuration,
    dump_configuration,
    parse_configuration,
    settings_classes,
)
from rotcal_ros.methods.method import DEFAULT, find_method
from rotcal_ros.nodes.planner.cell_links import CellLinks, Pauses
from rotcal_ros.nodes.planner.goal_run import GoalRun
from rotcal_ros.nodes.planner.goal_watch import Codes, GoalWatch, RequiredNodes
from rotcal_ros.nodes.planner.measuring import require_free
from rotcal_ros.nodes.planner.progress import GoalProgress
from rotcal_ros.nodes.runtime import conversions
from rotcal_ros.nodes.runtime.announced_plan import read_continuation
from rotcal_ros.nodes.runtime.cell_node import IDLE_S, CellNode
from rotcal_ros.nodes.runtime.emergency_stop import EmergencyStop
from rotcal_ros.nodes.runtime.managed_node import read_settings
from rotcal_ros.nodes.runtime.running import in_thread, run
from rotcal_ros.planning.settings import SafetySettings

Plain = TypeVar("Plain", CalibrationGoal, CalibrationProgress)
RESULT_TIMEOUT_S: Final = 3600
FEEDBACK_PERIOD_S: Final = 0.1
NO_ORDERS: Final = "the planner orders nothing; a recording goes on"
RESTART_WAIT_S: Final = 20.0
"""A goal waits this long for a lost node to be restarted."""
SAFETY, HEALTH = "safety", "health"
FROM_THE_START: Final = (SAFETY, HEALTH)
"""Groups that are fixed for all nodes at their start: no goal changes them."""
ALWAYS: Final = ("cell", "plan", "capture", "solver", "planner", *FROM_THE_START)
"""Groups that are parameters of the planner even if they were not given."""


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

    def activated(self) -> None:
        """Take goals."""
        self._giving_up = None

    def deactivated(self) -> None:
        """Give up the running goal and accept no other."""
        self._give_up("the planner was deactivated")

    def judge_parameters(self, changes: Mapping[str, Any]) -> None:
        """Raise ConfigurationError if no goal could be measured with these parameters."""
        if self.configured:
            self._configured.judge(changes)

    def begin_stop(self) -> None:
        """End the running goal with a valid bag."""
        self._give_up("the planner was ended")

    def stopped(self) -> bool:
        """Return whether no goal runs any more."""
        return not self.configured or (self._run is None and not self._preparing)

    def gather_s(self) -> float:
        """Collect messages until there is a goal."""
        return IDLE_S if self.stopped() else 0.0

    def _give_up(self, why: str) -> None:
        self._giving_up = self._given_up = why
        if self._run is not None:
            self._run.watch.stopping = why

    def _judge_goal(self, _goal: Calibrate.Goal) -> GoalResponse:
        """Refuse a goal while another runs; the client reads the reason in the beat."""
        free = self._run is None and not self._preparing
        if self.active and not self._giving_up and free:
            self._given_up = None
            return GoalResponse.ACCEPT
        self.get_logger().warning(f"goal refused: the planner is {self._in_words()}")
        return GoalResponse.REJECT

    def _in_words(self) -> str:
        """Return the planner's state for a person to read."""
        return self._beat_values()[0].describe()

    def _require_free(self) -> None:
        """Raise NotFreeError if the running goal cannot be resumed yet."""
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
        return Codes(error_code=Codes.UNKNOWN, error_msg=describe(error))

    async def _prepared(self, handle: ServerGoalHandle) -> GoalRun:
        """Run :meth:`_prepare` in a thread: it may take seconds, and the node goes on."""
        self._preparing = True
        try:
            return await in_thread(self._prepare, handle)
        finally:
            self._preparing = False

    def _prepare(self, handle: ServerGoalHandle) -> GoalRun:
        """Return the run of a goal; ConfigurationError or PlanError when it is impossible."""
        calibration = prepare_to_measure(self._configured.configuration(handle.request))
        continuation, self._continuation = self._continuation, None
        self._links.goals.publish(_plain(CalibrationGoal, handle, handle.request, self.now_ns()))
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
            required=RequiredNodes(self.health, self._restart_wait_s),
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
        feedback = feedback_message(progress, self._links.current_std)
        handle.publish_feedback(feedback)
        self._links.progress.publish(_plain(CalibrationProgress, handle, feedback, self.now_ns()))

    def _report(self) -> tuple[NodeState, dict[str, Any]]:
        if self._run is None:
            return NodeState(State.PREPARING if self._preparing else State.READY), {}
        progress = self._run.watch.progress
        doing = (progress.doing,)
        state = NodeState(State.CALIBRATING, doing, progress.step, progress.total)
        return state, self._run.values()


class PlannerParameters:
    """The parameters of a planner: the groups of its configured method, and its ``safety``.

    Raises ConfigurationError for any parameter that is misspelt (with the nearest name) or
    impossible.
    """

    def __init__(self, node: CellNode) -> None:
        self._node = node
        method = find_method(node.parameter("method", DEFAULT, "method of the calibration"))
        for group, value in node.given.items():
            if isinstance(value, dict) and group not in GROUPS:
                raise ConfigurationError(
                    f"{node.get_name()}: parameters: unknown group {group!r}"
                    f"{nearest(group, GROUPS)}"
                )
        self._groups = {
            group: cls
            for group, cls in settings_classes(method).items()
            if group in ALWAYS or group in node.given
        }
        for group, cls in self._groups.items():
            node.settings(group, cls, read_only=group in FROM_THE_START)
        self.safety: SafetySettings = read_settings(node, SAFETY, SafetySettings)
        self._fixed = {SAFETY: self.safety, HEALTH: node.health.settings}

    def configuration(self, goal: Calibrate.Goal) -> Configuration:
        """Return the configuration of a goal, or that of the parameters if it has none."""
        text, source = goal.configuration, "configuration of the goal"
        if not text:
            method = self._node.get_parameter("method").value
            groups = {
                group: to_mapping(read_settings(self._node, group, cls))
                for group, cls in self._groups.items()
            }
            text, source = dump_configuration(method, groups), "parameters of the planner"
        configuration = parse_configuration(text, source)
        for group, own in self._fixed.items():
            if group in configuration.given and configuration.group(group) != own:
                raise ConfigurationError(
                    f"{source}: its group {group} differs from the one that the planner was "
                    "started with: start the nodes with this configuration"
                )
        if goal.method and goal.method != configuration.method.name:
            raise ConfigurationError(
                f"the goal requests method {goal.method!r}, its configuration describes "
                f"{configuration.method.name!r}"
            )
        return configuration

    def judge(self, changes: Mapping[str, Any]) -> None:
        """Raise ConfigurationError if no goal can be measured with ``changes``, name -> value."""
        for group in {name.partition(".")[0] for name in changes} & self._groups.keys():
            read_settings(self._node, group, self._groups[group], changes)


def feedback_message(progress: GoalProgress, current_std: float) -> Calibrate.Feedback:
    """Return the progress of a goal; ``current_std`` in rad."""
    return Calibrate.Feedback(
        step=progress.step,
        total=progress.total,
        activity=progress.doing.describe(),
        doing=progress.doing.code,
        instruction=progress.doing.instruction or "",
        time_left=progress.time_left(),
        current_std=current_std,
        n_accepted=len(progress.accepted),
        n_rejected=progress.rejected,
        left=progress.left,
        uncertainty=progress.uncertainty,
        goal=progress.goal,
    )


def _plain(kind: type[Plain], handle: ServerGoalHandle, content: Any, now_ns: int) -> Plain:
    """Return the ``content`` of a goal or a feedback as a message that bags can hold."""
    fields = {name: getattr(content, name) for name in content.get_fields_and_field_types()}
    return kind(header=conversions.header(now_ns), goal_id=handle.goal_id, **fields)


def main() -> None:
    """Run the planner."""
    run(Planner)


if __name__ == "__main__":
    main()
