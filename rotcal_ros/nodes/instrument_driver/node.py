"""An instrument by plug-in, as a node: publishes its lengths, or its positions.

What a plug-in has to do is in ``instrument`` beside this file; ``driver`` runs it in a thread.
"""

from __future__ import annotations

from typing import Any

from rotcal_msgs.msg import ProbePoint, TracerLength

from rotcal_ros.bags import names
from rotcal_ros.capture.instruments.interpreter import Interpreter
from rotcal_ros.capture.settings import CaptureSettings
from rotcal_ros.foundation.node_state import NodeState
from rotcal_ros.foundation.observations import Command, ProbeSample, TracerSample
from rotcal_ros.nodes.capture.instrument_streams import InstrumentTopics
from rotcal_ros.nodes.instrument_driver.driver import (
    DriverCallbacks,
    InstrumentDriver,
    TableRestDetector,
    make_instrument,
)
from rotcal_ros.nodes.instrument_driver.instrument import InstrumentError, Tracer, Tracker
from rotcal_ros.nodes.instrument_driver.settings import InstrumentSettings
from rotcal_ros.nodes.runtime import conversions
from rotcal_ros.nodes.runtime.beat_values import COMPLAINT, set_warning
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.runtime.qos import EVENT, STREAM
from rotcal_ros.nodes.runtime.running import run_node
from rotcal_ros.nodes.runtime.timers_and_subscriptions import Batch, sent_ns
from rotcal_ros.planning.settings import CellSettings


class TableFeedbackSubscription:
    """Passes the feedback of ``joint`` to ``rest``; topic, type and units as for the capture."""

    def __init__(self, node: CellNode, joint: str, rest: TableRestDetector) -> None:
        self._joint, self._rest = joint, rest
        self._topics = InstrumentTopics(node, self._switched)
        self._interpreter = Interpreter(self._topics.settings, joint)
        self._topics.listen(names.JOINT_STATES, node.health.guarded(self.receive))

    def why_not(self, order: Command) -> str | None:
        """Return why the table does not rest where ``order`` sent it; None: it does."""
        if refused := self._topics.refused.get(names.JOINT_STATES):
            return refused
        why = self._rest.why_not(order)
        joint = self._joint and f", joint {self._joint}"
        return why and f"{why} ({self._topics.name(names.JOINT_STATES)}{joint})"

    def receive(self, type_name: str, batch: Batch) -> None:
        """Take messages of a type."""
        sent = [(message, sent_ns(info)) for message, info in batch]
        for sample in self._interpreter.records(names.JOINT_STATES, type_name, sent):
            self._rest.receive(sample)

    def _switched(self, _role: str) -> None:
        self._interpreter = Interpreter(self._topics.settings, self._joint)
        self._rest.forget()


LOOK_PERIOD_S = 0.2


class InstrumentDriverNode(CellNode):
    """Gives the driver of one instrument its orders and feedback, and publishes its readings."""

    def __init__(self) -> None:
        super().__init__("instrument_driver")

    def configure(self) -> None:
        """Find the plug-in; the node talks to the instrument while it is active."""
        self._settings = self.settings("instrument", InstrumentSettings)
        rest = self.settings("capture", CaptureSettings)
        joint = self.settings("cell", CellSettings).joint
        self._table: TableFeedbackSubscription | None = None
        self._instrument = make_instrument(self._settings)
        if isinstance(self._instrument, Tracer):
            self._lengths = self.create_publisher(TracerLength, names.TRACER_LENGTH, STREAM)
        self._driver = self._new_driver()
        if isinstance(self._instrument, Tracker):
            self._places = self.create_publisher(ProbePoint, names.PROBE_POINT, EVENT)
            self.take_orders(lambda command: self._driver.order(command))
            tolerance, speed = rest.position_tolerance_arcsec, rest.velocity_tolerance_deg_s
            table_rest = TableRestDetector(tolerance, speed, rest.settle_time_s)
            self._table = TableFeedbackSubscription(self, joint, table_rest)
        self.every(LOOK_PERIOD_S, self._look)

    def activated(self) -> None:
        """Connect, and measure from now on."""
        if self._driver.alive:
            raise InstrumentError("the instrument is still being closed; try again")
        self._driver = self._new_driver()
        self._driver.begin()

    def deactivated(self) -> None:
        """Release the instrument."""
        self._driver.stop()

    def stopped(self) -> bool:
        """Return whether the connection is closed."""
        return not self._driver.alive

    def _new_driver(self) -> InstrumentDriver:
        listeners = DriverCallbacks(self._tell_length, self._tell_place, self._complain)
        return InstrumentDriver(
            self._instrument, self._settings, listeners, self._why_not, self.now_ns
        )

    def _why_not(self, order: Command) -> str | None:
        """Return why the place of ``order`` may not be measured now; None: it may."""
        return None if self._table is None else self._table.why_not(order)

    def _node_lost(self, name: str) -> None:
        """Drop the order of a planner that is lost."""
        if name == "planner":
            self._driver.forget()

    def _look(self) -> None:
        trouble = self._driver.trouble
        set_warning(self.health, COMPLAINT, trouble or self._driver.waits, alarm=bool(trouble))

    def _tell_length(self, sample: TracerSample) -> None:
        self._lengths.publish(conversions.tracer_message(sample))

    def _tell_place(self, sample: ProbeSample) -> None:
        self._places.publish(conversions.probe_message(sample, conversions.TRACER))

    def _complain(self, text: str) -> None:
        self.get_logger().error(text)

    def _report(self) -> tuple[NodeState, dict[str, Any]]:
        return self._driver.state, {"connections": self._driver.connections}


def main() -> None:
    """Run the driver."""
    run_node(InstrumentDriverNode)


if __name__ == "__main__":
    main()
