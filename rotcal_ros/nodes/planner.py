"""The planner: turns one goal into a finished calibration, step by step.

A lifecycle node with the action ``calibrate``; one goal at a time.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any, Final

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rotcal_msgs.action import Calibrate
from std_srvs.srv import Trigger

from rotcal_ros.catalogue import Calibration, prepare
from rotcal_ros.catalogue.configuration import (
    Configuration,
    dump_configuration,
    parse_configuration,
    settings_classes,
)
from rotcal_ros.catalogue.continuation import Continuation
from rotcal_ros.catalogue.method import DEFAULT, find_method
from rotcal_ros.errors import ConfigurationError, RotcalError
from rotcal_ros.nodes.cell_links import CellLinks
from rotcal_ros.nodes.continuing import read_continuation
from rotcal_ros.nodes.goal_run import GoalRun, Outcome
from rotcal_ros.nodes.health import Health
from rotcal_ros.nodes.parameters import declare_settings, read_settings, settings_mapping
from rotcal_ros.nodes.progress import Progress
from rotcal_ros.nodes.running import run_node
from rotcal_ros.planning.planner_settings import PlannerSettings

RESULT_TIMEOUT_S: Final = 3600
PLANNER_GROUPS: Final = ("cell", "plan", "capture", "solver", "planner")
"""Groups that the planner makes a configuration of when a goal comes without one."""
FEEDBACK_PERIOD_S: Final = 0.1


class Planner(LifecycleNode):
    """Commands the cell from the first step to the result."""

    def __init__(self) -> None:
        super().__init__("planner")
        self._run: GoalRun | None = None
        self._active = False
        self._stopping = False
        self._shown_s = -math.inf
        self._groups = self._declare()
        self._continuation = read_continuation(self)
        self._health = Health(self, self._report)
        self._links = CellLinks(self, self._health.guarded)
        self.create_service(Trigger, "resume", self._resume)
        self._server = ActionServer(
            self,
            Calibrate,
            "calibrate",
            self._execute,
            goal_callback=self._judge_goal,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            result_timeout=RESULT_TIMEOUT_S,
        )
        if self.declare_parameter("autostart", True).value:
            self.trigger_configure()
            self.trigger_activate()

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Accept goals from now on."""
        self._active = True
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Give up the running goal and accept no more."""
        self._active = False
        self._give_up("the planner was deactivated")
        return super().on_deactivate(state)

    def begin_stop(self) -> None:
        """End the running goal with a valid bag."""
        self._stopping = True
        self._give_up("the planner was ended")

    def stopped(self) -> bool:
        """Return whether no goal runs any more."""
        if self._run is None:
            self._health.leave()
        return self._run is None

    def _give_up(self, why: str) -> None:
        if self._run is not None:
            self._run.stopping = why

    def _declare(self) -> Mapping[str, type]:
        """Declare the parameters of the configured method and return its groups."""
        method = find_method(self.declare_parameter("method", DEFAULT).value)
        groups = {
            name: cls for name, cls in settings_classes(method).items() if name in PLANNER_GROUPS
        }
        for group, cls in groups.items():
            declare_settings(self, group, cls, read_only=False)
        return groups

    def _configuration(self, goal: Calibrate.Goal) -> Configuration:
        """Return the configuration of a goal, or that of the node's own parameters."""
        text, source = goal.configuration, "configuration of the goal"
        if not text:
            method = self.get_parameter("method").value
            groups = {g: settings_mapping(self, g, cls) for g, cls in self._groups.items()}
            text, source = dump_configuration(method, groups), "parameters of the planner"
        configuration = parse_configuration(text, source)
        if goal.method and goal.method != configuration.method.name:
            raise ConfigurationError(
                f"the goal asks for method {goal.method!r}, its configuration describes "
                f"{configuration.method.name!r}"
            )
        return configuration

    def _judge_goal(self, _goal: Calibrate.Goal) -> GoalResponse:
        """Refuse a goal while another runs; the heartbeat tells the reason to the client."""
        if self._active and not self._stopping and self._run is None:
            return GoalResponse.ACCEPT
        self.get_logger().warning(f"goal refused: the planner is {self._report()[0]}")
        return GoalResponse.REJECT

    def _resume(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Go on after a person's work is done."""
        if self._run is not None and self._run.paused:
            self._run.paused = False
            response.success = True
        else:
            response.message = f"nothing waits for resume: the planner is {self._report()[0]}"
        return response

    async def _execute(self, handle: ServerGoalHandle) -> Outcome:
        try:
            run = self._prepare(handle)
        except RotcalError as error:
            handle.abort()
            return Outcome(error_code=Outcome.BAD_CONFIGURATION, error_msg=str(error))
        self._run = run
        try:
            outcome = await run.execute()
        except Exception as error:
            self._health.note_error("goal", error)
            outcome = Outcome(error_code=Outcome.UNKNOWN, error_msg=repr(error))
        finally:
            self._run = None
        self._end(handle, outcome)
        return outcome

    def _prepare(self, handle: ServerGoalHandle) -> GoalRun:
        configuration = self._configuration(handle.request)
        calibration: Calibration = prepare(configuration)
        continuation = self._continuation_of(calibration, handle.request.start_index)
        if handle.request.configuration:
            settings = configuration.planner
        else:
            settings = read_settings(self, "planner", PlannerSettings)
        return GoalRun(
            calibration,
            settings,
            self._links,
            self._health,
            continuation=continuation,
            show=lambda progress: self._show(handle, progress),
            canceled=lambda: handle.is_cancel_requested,
        )

    def _continuation_of(self, calibration: Calibration, start_index: int) -> Continuation:
        """Return what is to be measured: the rest of an interrupted plan, or from an index on."""
        plan_id, plan = calibration.configuration.plan_id, calibration.plan
        known, self._continuation = self._continuation, None
        if known is not None and (known.plan_id, known.start_index) == (plan_id, start_index):
            return known
        plan.step(start_index)
        return Continuation(
            plan_id, 0, start_index, (), tuple(range(start_index, len(plan.steps))), ()
        )

    def _end(self, handle: ServerGoalHandle, outcome: Outcome) -> None:
        if outcome.error_code == Outcome.NONE:
            self.get_logger().info(f"calibration done, verdict {outcome.verdict}")
            handle.succeed()
            return
        self.get_logger().error(f"calibration ended: {outcome.error_msg}")
        if handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.abort()

    def _show(self, handle: ServerGoalHandle, progress: Progress) -> None:
        """Publish feedback, not more often than a person can follow."""
        now = time.monotonic()
        waiting = self._run is not None and self._run.paused
        measuring = 0 < progress.step < progress.total
        if now - self._shown_s < FEEDBACK_PERIOD_S and measuring and not waiting:
            return
        self._shown_s = now
        handle.publish_feedback(
            Calibrate.Feedback(
                step=progress.step,
                total=progress.total,
                activity=progress.activity,
                time_left=progress.time_left(),
                current_std=self._links.current_std,
                n_accepted=len(progress.accepted),
                n_rejected=progress.rejected,
            )
        )

    def _report(self) -> tuple[str, dict[str, Any]]:
        if self._run is None:
            return "ready" if self._active else "inactive", {}
        progress = self._run.progress
        return (
            f"calibrating: step {progress.step} of {progress.total}, {progress.activity}",
            {"accepted": len(progress.accepted), "rejected": progress.rejected},
        )


def make() -> Node:
    """Return the node."""
    return Planner()


def main(args: Sequence[str] | None = None) -> None:
    """Run the planner."""
    sys.exit(run_node(make, args))


if __name__ == "__main__":
    main()
