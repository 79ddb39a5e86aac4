"""The emergency stop: every node that orders or carries out motion subscribes to it itself.

This is no safety function in the sense of ISO 13849: messages may come late or never.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool

from rotcal_ros.nodes.runtime.beat_values import EMERGENCY, set_warning
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.runtime.qos import EVENT, VIEW
from rotcal_ros.nodes.runtime.timers_and_subscriptions import (
    Batch,
    DrainedSubscription,
    steady_timer,
)
from rotcal_ros.planning.emergency_stop import StopSources
from rotcal_ros.planning.settings import SafetySettings

LOOK_PERIOD_S: Final = 0.1
DEPTH: Final = 100
LATCHED_EVENT: Final = QoSProfile(
    depth=DEPTH,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""Deep enough that a latched stop is not lost when its release comes in the same turn."""


class EmergencyStop:
    """Whether safety stops the cell.

    ``why`` says why nothing may be ordered now; None: it may. ``latched`` keeps the reason of the
    last stop until :meth:`forget`, however short the stop was; ``count`` is how many stops began.
    ``begin`` is called with the reason when a stop begins; ``effect`` tells people what this node
    does meanwhile. A stop is heard in every state of the node; silence of the topic counts as a
    stop only while the node is active.
    """

    def __init__(
        self,
        node: CellNode,
        settings: SafetySettings,
        effect: str,
        begin: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._node, self._effect, self._begin = node, effect, begin
        topic = settings.emergency_stop and node.resolve_topic_name(settings.emergency_stop)
        self._sources = StopSources(settings, topic, time.monotonic())
        self._looked_s = time.monotonic()
        self.why: str | None = None
        self.latched: str | None = None
        self.count = 0
        self._heard: list[DrainedSubscription] = []
        self._topic, self._profiles = topic, list[QoSProfile]()
        set_warning(node.health, EMERGENCY, None)
        if topic:
            self._subscribe(VIEW)
        if settings.stop_on_diagnostics:
            self._drain(DiagnosticArray, "/diagnostics", EVENT, self._diagnose)
        node.every(LOOK_PERIOD_S, self._look)
        steady_timer(node, LOOK_PERIOD_S, node.health.guarded(self._attend))

    def check_stop(self) -> str | None:
        """Return :attr:`latched`, after handling the messages that wait."""
        for heard in self._heard:
            heard.drain()
        return self.latched

    def refuses(self, step: int) -> bool:
        """Return whether the order of a ``step`` is refused, and say so on the console."""
        self.check_stop()
        if self.why:
            self._node.get_logger().warning(f"step {step}: refused in an emergency stop")
        return bool(self.why)

    def forget(self) -> None:
        """Forget earlier stops; a stop that lasts stays."""
        self.latched = self.why

    def _subscribe(self, qos: QoSProfile) -> None:
        """Listen with a further quality of service, unless that is done."""
        if qos not in self._profiles:
            self._profiles.append(qos)
            self._drain(Bool, self._topic, qos, self._hear)

    def _drain(
        self, kind: type, topic: str, qos: QoSProfile, handle: Callable[[Batch], None]
    ) -> None:
        handle = self._node.health.guarded(handle)
        self._heard.append(DrainedSubscription(self._node, kind, topic, qos, handle))

    def _attend(self) -> None:
        """Listen as reliably as all publishers allow: best effort may lose messages."""
        for info in self._node.get_publishers_info_by_topic(self._topic) if self._topic else ():
            offered = info.qos_profile
            if offered.reliability == ReliabilityPolicy.RELIABLE:
                latched = offered.durability == DurabilityPolicy.TRANSIENT_LOCAL
                self._subscribe(LATCHED_EVENT if latched else EVENT)

    def _hear(self, batch: Batch) -> None:
        for message, _ in batch:
            self._sources.receive(message.data, time.monotonic())
            self._judge()

    def _diagnose(self, batch: Batch) -> None:
        for message, _ in batch:
            for status in message.status:
                level = int.from_bytes(status.level, "little")
                self._sources.diagnose(status.name, level, status.message, time.monotonic())
                self._judge()

    def _look(self) -> None:
        """Check for silence after handling what waits: this node itself may have stood still."""
        self.check_stop()
        self._looked_s = time.monotonic()
        self._judge()

    def _judge(self) -> None:
        """Begin or end a stop by what was heard; silence is judged at the latest look."""
        before, self.why = self.why, "; ".join(self._sources.reasons(self._looked_s)) or None
        if self.why and not before:
            self.latched, self.count = self.why, self.count + 1
            self._node.get_logger().error(f"emergency stop: {self.why}; {self._effect}")
            self._begin(self.why)
        if before and not self.why:
            text = f"the emergency stop is over, it was: {before}; nothing moves by itself"
            self._node.get_logger().warning(text)
        if self.why != before:
            set_warning(self._node.health, EMERGENCY, self.why and f"{self.why}; {self._effect}")
