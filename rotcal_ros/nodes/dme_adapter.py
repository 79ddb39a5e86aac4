"""A measuring machine with a rotary table behind I++ DME: takes orders, tells points and feedback.

What the machine is told and what it answers is the matter of :mod:`rotcal_ros.dme.driver`, whose
thread may wait; this node only passes on.
"""

from __future__ import annotations

from concurrent.futures import TimeoutError as FutureTimeout
from typing import Any, Final

from rotcal_msgs.msg import CalibrationPlan, ProbePoint
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from rotcal_ros.bags import names
from rotcal_ros.dme.driver import Driver
from rotcal_ros.dme.faults import DmeError
from rotcal_ros.dme.settings import DmeSettings
from rotcal_ros.nodes import conversions
from rotcal_ros.nodes.cell_node import CellNode
from rotcal_ros.nodes.health import CALIBRATING
from rotcal_ros.nodes.plans import calibration_of
from rotcal_ros.nodes.qos import EVENT, LATCHED, STREAM
from rotcal_ros.nodes.roll_call import LOADING
from rotcal_ros.nodes.running import run
from rotcal_ros.observations import Command, ProbeSample, TableSample
from rotcal_ros.planning.cell_settings import CellSettings
from rotcal_ros.planning.plan import Plan

WATCH_PERIOD_S: Final = 0.1
PLANNER: Final = "planner"


class DmeAdapter(CellNode):
    """Passes orders to the driver, and publishes what the driver hears; a person clears errors."""

    def __init__(self) -> None:
        super().__init__("dme_adapter")
        settings = self.settings("dme", DmeSettings)
        self._joint = self.settings("cell", CellSettings).joint or "table"
        self._plan: Plan | None = None
        self._early: Command | None = None
        self._loading = self._calibrating = False
        self._table = self.create_publisher(JointState, names.JOINT_STATES, STREAM)
        self._points = self.create_publisher(ProbePoint, names.PROBE_POINT, EVENT)
        self._limit_s = 20.0 * settings.reply_timeout_s + settings.motion_timeout_s
        self._driver = Driver(
            settings, self._tell_table, self._tell_point, self._complain, self.now_ns
        )
        self._driver.begin()
        self.listen(CalibrationPlan, names.PLAN, self._take_plan, LATCHED)
        self.take_orders(self._obey)
        self.create_service(Trigger, "clear_errors", self._clear)
        self.every(WATCH_PERIOD_S, self._watch)

    def begin_stop(self) -> None:
        """Stop what moves and end the session."""
        self._driver.stop()

    def stopped(self) -> bool:
        """Return whether the session is closed."""
        return not self._driver.alive

    def _take_plan(self, message: CalibrationPlan) -> None:
        """Take the plan: it says which ball is touched how often."""
        self._plan, self._loading = None, True
        self.health.beat()
        try:
            self._plan = calibration_of(message).plan
        finally:
            self._loading = False
        early, self._early = self._early, None
        if early is not None:
            self._obey(early)

    def _obey(self, command: Command) -> None:
        if self._plan is None:
            self._early = command  # of a plan that is on its way
        else:
            self._driver.order(command, self._plan.step(command.step))

    async def _clear(
        self, _request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        """Go on after an error: whoever calls this has seen why the machine stopped."""
        try:
            response.message = await self.answer_of(self._driver.clear(), self._limit_s)
            response.success = True
        except (DmeError, FutureTimeout) as error:
            response.message = str(error) or f"no answer within {self._limit_s:g} s"
        return response

    def _watch(self) -> None:
        """Stop the machine when the calibration ends in the middle of a step."""
        calibrating = self.health.state(PLANNER).startswith(CALIBRATING)
        if self._calibrating and not calibrating and self._driver.busy:
            self._abort("the calibration ended in the middle of a step")
        self._calibrating = calibrating
        self.health.concerns.pop("dme", None)
        if self._driver.client.blocked:
            self.health.concerns["dme"] = self._driver.client.blocked

    def _node_lost(self, name: str) -> None:
        """Stop the machine when nobody is left who knows what it is moving for."""
        if name == PLANNER and self._driver.busy:
            self._abort("the planner fell silent in the middle of a step")

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

    def _report(self) -> tuple[str, dict[str, Any]]:
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
    run(DmeAdapter)


if __name__ == "__main__":
    main()
