"""A joint of ros2_control as the table: orders become trajectories, its feedback the cell's.

Controllers may accept an order and not carry it out, so only the feedback of the joint shows
whether the table is where it was sent. What is impossible, or does not happen, is logged and shown
in the diagnostics.
"""

from __future__ import annotations

from typing import Any, Final

from rotcal_msgs.msg import TableAngle
from sensor_msgs.msg import JointState

from rotcal_ros.bags import names
from rotcal_ros.capture import messages
from rotcal_ros.capture.rejections import reason_kind
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.node_state import NodeState, State, Why
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.nodes.runtime import conversions
from rotcal_ros.nodes.runtime.beat_values import COMPLAINT, set_warning
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.runtime.emergency_stop import EmergencyStop
from rotcal_ros.nodes.runtime.health import PLANNER
from rotcal_ros.nodes.runtime.qos import EVENT, STREAM
from rotcal_ros.nodes.runtime.running import run_node
from rotcal_ros.nodes.runtime.timers_and_subscriptions import Batch, InstrumentSubscription
from rotcal_ros.nodes.table_adapter.joint_controllers import (
    JointController,
    PositionController,
    TrajectoryController,
    choose_interface,
)
from rotcal_ros.nodes.table_adapter.joint_watch import JointMonitor
from rotcal_ros.planning.approach import path_to, require_rest, stopping_path
from rotcal_ros.planning.settings import CellSettings, SafetySettings, TableAdapterSettings

LOOK_PERIOD_S: Final = 0.2
FRESH_S: Final = 1.0
"""The planner beats more often: after this time its latest beat is younger than the order."""


class TableAdapter(CellNode):
    """Sends the newest order, once it knows where the joint stands, and passes feedback on."""

    def __init__(self) -> None:
        super().__init__("table_adapter")

    def configure(self) -> None:
        """Subscribe to the joint's feedback, and offer to move it."""
        self._settings = self.settings("table_adapter", TableAdapterSettings)
        self._joint = self.settings("cell", CellSettings).joint
        if not self._joint:
            raise ConfigurationError(
                "table_adapter: cell.joint is not set; name the joint of the table, as in "
                f"{self._settings.feedback}"
            )
        self._watch = JointMonitor(self._settings)
        self._controller = _joint_controller(self, self._settings, self._joint)
        self._stop = EmergencyStop(
            self, self.settings("safety", SafetySettings), "the table is held", self._halt
        )
        self._waiting: TableAngle | None = None
        self._waiting_s = 0.0
        self._refused: str | None = None
        self._kind: str | None = None
        self._held = False
        self._others: tuple[str, ...] = ()
        self._state = NodeState.of(State.WAITING, Why.NO_FEEDBACK)
        self._feedback = self.create_publisher(JointState, names.JOINT_STATES, STREAM)
        heard = self.resolve_topic_name(self._settings.feedback)
        self._passes_on = self._feedback.topic_name != heard
        InstrumentSubscription(
            self, JointState, self._settings.feedback, self.health.guarded(self._hear)
        )
        self.listen(TableAngle, names.TABLE_ANGLE, self._obey, EVENT)
        self.every(LOOK_PERIOD_S, self._look)

    def deactivated(self) -> None:
        """Command nothing more, not even in an emergency stop."""
        self._waiting = None
        self._controller.forget()
        self._watch.leave()

    def _obey(self, message: TableAngle) -> None:
        """Take an order; it replaces one that is being carried out."""
        if self._stop.refuses(message.step):
            return
        self._waiting, self._waiting_s, self._refused = message, self.health.awake.now_s(), None
        self._held = False
        self._send()

    def _halt(self, _why: str) -> None:
        """Forget the waiting order, and bring a joint that moves by another one to rest."""
        self._waiting, self._state = None, NodeState.of(State.WAITING, Why.NO_ORDER)
        if not self._watch.under_way(now_s := self.health.awake.now_s()):
            return
        sent = self._controller.setpoint() or self._watch.motion(now_s)
        self._held = sent is not None
        if sent is None:
            self._watch.leave()
            how = f"its position is not known; {self._controller.halt()}"
            self.get_logger().error(f"the table cannot be held: {how}")
            return
        way = stopping_path(*sent, self._settings)
        self._controller.send(way)
        self._watch.begin(way, now_s)

    def _send(self) -> None:
        """Send the waiting order as soon as it is known where the joint stands and who listens."""
        order, here = self._waiting, self._watch.here(self.health.awake.now_s())
        if order is None or here is None or self._watch.doubt() or not self._controller.heard():
            return
        self._waiting = None
        self._state = NodeState.of(State.WORKING, Why.ORDERED, order.step, order.attempt)
        begin, _ = self._controller.setpoint() or (here, 0.0)
        try:
            require_rest(order.turn_speed)
            way = path_to(order.angle, Approach(order.approach), begin, self._settings)
        except DataError as error:
            self._refused = str(error)
            return
        self._controller.send(way)
        self._watch.begin(way, self.health.awake.now_s())

    def _forget(self) -> None:
        """Forget an order that waits when its calibration has ended: it must not move later."""
        old = self.health.awake.now_s() > self._waiting_s + FRESH_S
        lost = PLANNER in self.health.lost
        ended = lost or (PLANNER in self.health.others and not self.health.is_calibrating())
        if self._waiting is not None and old and ended:
            self._waiting = None
            self.get_logger().warning("an order was dropped: its calibration has ended")

    def _hear(self, batch: Batch) -> None:
        for message, _ in batch:
            sample = messages.table_sample(message, self._joint)
            if sample is None:
                self._others = tuple(message.name)
                continue
            feedback = self._watch.receive(sample, self.health.awake.now_s())
            if feedback is not None and self._passes_on:
                self._feedback.publish(conversions.table_message(feedback, self._joint))
        self._send()

    def _look(self) -> None:
        """Send what waited for a listener, and check for faults."""
        self._forget()
        self._send()
        if text := self._wrong():
            if reason_kind(text) != self._kind:
                self.get_logger().error(text)
            self._kind = reason_kind(text)
        elif self._watch.arrived():
            self._kind = None
        if text or self._held or self._watch.arrived():
            set_warning(self.health, COMPLAINT, text)

    def _wrong(self) -> str | None:
        """Return what is wrong with the table; None: nothing, or it was stopped."""
        if self._refused:
            return self._refused
        if self._watch.latest is None and self._others:
            return (
                f"no joint {self._joint!r} in {self._settings.feedback}, which has "
                f"{', '.join(self._others)}: name one of these in cell.joint"
            )
        if self._waiting is not None:
            return self._why_waiting()
        report = self._controller.report()
        text = None if self._held else self._watch.current_fault(self.health.awake.now_s())
        if report.trouble and (self._held or not self._watch.arrived()):
            text = report.trouble
        if text and report.done:
            text += ", and the controller calls this succeeded"
        return f"joint {self._joint!r} of {self._settings.controller}: {text}" if text else None

    def _why_waiting(self) -> str | None:
        """Return why an order is not sent; None while discovery may still be going on."""
        if doubt := self._watch.doubt():
            return doubt
        if self.health.awake.now_s() <= self._waiting_s + self._settings.silence_s:
            return None
        if self._watch.latest is None:
            return f"no node publishes {self._settings.feedback}: nothing can be moved"
        if not self._controller.heard():
            return (
                f"no node listens to {self._settings.controller}: is the controller active, and "
                "does it take what table_adapter.interface says?"
            )
        return None

    def _report(self) -> tuple[NodeState, dict[str, Any]]:
        latest = self._watch.latest
        angle = {} if latest is None else {"angle_deg": f"{latest.angle / DEGREE:.5f}"}
        held = self._held and self._stop.why
        return NodeState.of(State.FAILED, Why.HELD) if held else self._state, angle


def _joint_controller(
    node: CellNode, settings: TableAdapterSettings, joint: str
) -> JointController:
    """Return the controller that the settings name; errors as :func:`choose_interface`."""
    interface = choose_interface(settings)
    if interface == "goals":
        from rotcal_ros.nodes.table_adapter.joint_goals import GoalController

        return GoalController(node, settings.controller, joint)
    kind = PositionController if interface == "positions" else TrajectoryController
    return kind(node, settings.controller, joint)


def main() -> None:
    """Run the adapter."""
    run_node(TableAdapter)


if __name__ == "__main__":
    main()
