"""A measuring machine with a rotary table behind I++ DME, as a node of the cell.

It passes orders to the ``driver`` beside it, which talks to the machine in a thread of its own
because it waits for answers, and it publishes points and feedback.
"""

from __future__ import annotations

from concurrent.futures import TimeoutError as FutureTimeout
from typing import Any, Final

from rotcal_msgs.msg import CalibrationPlan, ProbePoint
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from rotcal_ipp_dme.client import NOT_STARTED
from rotcal_ipp_dme.driver import Driver
from rotcal_ipp_dme.protocol import DmeError
from rotcal_ipp_dme.settings import DmeSettings
from rotcal_ros.bags import names
from rotcal_ros.capture.messages import OrderPairing
from rotcal_ros.capture.publishers import RUN, unique_run_name
from rotcal_ros.foundation.node_state import LOADING, NodeState
from rotcal_ros.foundation.observations import Command, ProbeSample, TableSample
from rotcal_ros.nodes.runtime import announced_plan, conversions
from rotcal_ros.nodes.runtime.beat_values import BLOCKED, set_warning
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.runtime.emergency_stop import EmergencyStop
from rotcal_ros.nodes.runtime.health import PLANNER
from rotcal_ros.nodes.runtime.qos import EVENT, STREAM
from rotcal_ros.nodes.runtime.running import run_node
from rotcal_ros.planning.plan import Plan
from rotcal_ros.planning.settings import CellSettings, SafetySettings

WATCH_PERIOD_S: Final = 0.1
LOOKS_FIRST: Final = round(5.0 / WATCH_PERIOD_S)
"""Looks before the machine is contacted: within 5 s another running adapter is discovered."""
UNBLOCKED: Final = ("", NOT_STARTED)
HOW_TO_GO_ON: Final = "; once that is corrected, a person continues with the service clear_errors"


class DmeAdapter(CellNode):
    """Passes orders to the driver, and publishes what the driver hears; a person clears errors."""

    def __init__(self) -> None:
        super().__init__("dme_adapter")

    def configure(self) -> None:
        """Prepare the session with the machine, which begins with the first activation."""
        announced_plan.load_method(self)
        settings = self.settings("dme", DmeSettings)
        self._joint = self.settings("cell", CellSettings).joint or "table"
        self._plan: Plan | None = None
        self._early: tuple[str | None, Command] | None = None
        self._run: str | None = None
        self._served: str | None = None
        self._looks, self._loading, self._orders = 0, False, OrderPairing()
        self._table = self.create_publisher(JointState, names.JOINT_STATES, STREAM)
        self._points = self.create_publisher(ProbePoint, names.PROBE_POINT, EVENT)
        self._limit_s = 20.0 * settings.reply_timeout_s + settings.motion_timeout_s
        self._driver = Driver(
            settings, self._tell_table, self._tell_point, self._complain, self.now_ns
        )
        self._stop = EmergencyStop(
            self, self.settings("safety", SafetySettings), "the machine is stopped", self._halt
        )
        announced_plan.PlanSubscription(self, self._take_plan)
        self.every(WATCH_PERIOD_S, self._watch)

    def deactivated(self) -> None:
        """Stop the machine; its session stays."""
        self._drop("the adapter was deactivated in the middle of a step")

    def begin_stop(self) -> None:
        """Stop what moves and end the session."""
        self._driver.stop()

    def stopped(self) -> bool:
        """Return whether the session is closed."""
        return not self._driver.alive

    def _begin(self) -> None:
        """Obey in a session that begins now.

        It may home, so after a stop a person has to allow it.
        """
        why = self._stop.check_stop()
        self._driver.begin(why and f"{NOT_STARTED}: emergency stop: {why}")
        self._orders = self.take_orders(self._obey)
        self.offer(Trigger, "clear_errors", self._clear)

    def _take_plan(self, message: CalibrationPlan) -> None:
        """Take the plan, which says which ball is touched how often."""
        self._follow_planner()
        early, self._early = self._early, None
        self._plan, self._run, self._loading = None, unique_run_name(message), True
        self._orders.clear()
        self.health.beat()
        try:
            self._plan = announced_plan.calibration_from_message(message).plan
        finally:
            self._loading = False
        if early is not None and early[0] == self._run:
            self._obey(early[1])

    def _obey(self, command: Command) -> None:
        if self._stop.refuses(command.step):
            return
        run = self._planners_run()
        if self._plan is None or run not in (None, self._run):
            self._early = (run, command)  # of a plan that comes later, on another topic
        else:
            self._driver.order(command, self._plan.step(command.step))

    async def _clear(
        self, _request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        """Continue after an error: the caller has seen why the machine stopped."""
        if self._stop.why:
            response.message = f"the emergency stop is on: {self._stop.why}"
            return response
        try:
            response.message = await self.answer_of(self._driver.clear(), self._limit_s)
            response.success = True
        except (DmeError, FutureTimeout) as error:
            response.message = str(error) or f"no answer within {self._limit_s:g} s"
        return response

    def _watch(self) -> None:
        """Begin when no other adapter runs; then follow the planner, and show what blocks."""
        if self._looks < LOOKS_FIRST and not self.health.refused:
            self._looks += 1
            if self._looks == LOOKS_FIRST:
                self._begin()
        self._follow_planner()
        blocked = self._driver.client.blocked
        set_warning(self.health, BLOCKED, None if blocked in UNBLOCKED else blocked + HOW_TO_GO_ON)

    def _planners_run(self) -> str | None:
        """Return for which run of a plan the planner works; None: for none, or unknown."""
        if PLANNER in self.health.lost:
            return None
        return self.health.values(PLANNER).get(RUN)

    def _follow_planner(self) -> None:
        """Drop the plan and its orders when its calibration has ended."""
        run = self._planners_run()
        if self._served not in (None, run):
            self._plan = None
            self._drop("the calibration ended in the middle of a step")
        self._served = run

    def _node_lost(self, name: str) -> None:
        """Stop the machine when the planner for which it moves is lost."""
        if name == PLANNER:
            self._drop("the planner was lost in the middle of a step")

    def _halt(self, why: str) -> None:
        """Stop the machine in an emergency stop; a person clears its errors afterwards."""
        self._drop(f"emergency stop: {why}")

    def _drop(self, why: str) -> None:
        """Forget all orders, and stop the machine when it carries one out."""
        self._served = self._early = None
        self._orders.clear()
        self._driver.forget()
        if self._driver.busy:
            self._abort(why)

    def _abort(self, why: str) -> None:
        """Stop the machine, and say why."""
        self._complain(why)
        self._driver.abort(why)

    def _tell_table(self, sample: TableSample) -> None:
        self._table.publish(conversions.table_message(sample, self._joint))

    def _tell_point(self, sample: ProbeSample) -> None:
        self._points.publish(conversions.probe_message(sample, conversions.MACHINE))

    def _complain(self, text: str) -> None:
        self.get_logger().error(text)

    def _report(self) -> tuple[NodeState, dict[str, Any]]:
        driver = self._driver
        values = {
            "server": f"{driver.client.settings.host}:{driver.client.settings.port}",
            "version": driver.client.version or "not asked",
            "refused": driver.refused,
            "warnings": driver.warnings,
        }
        return LOADING if self._loading else driver.state, values


def main() -> None:
    """Run the adapter."""
    run_node(DmeAdapter)


if __name__ == "__main__":
    main()
