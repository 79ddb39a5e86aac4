"""Taking everything that a subscription holds, not one message per turn of the executor.

An executor takes one message per wait, which limits a node to some 2,700 messages per second.
Emptying the subscription inside the callback takes several times more without a loss.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, Final

from rclpy.node import Node
from rclpy.qos import QoSProfile

from rotcal_ros.nodes.runtime.qos import adapted_qos
from rotcal_ros.nodes.runtime.timers_and_events import Unwaited, steady_timer

LIMIT: Final = 1000
"""Messages taken in one callback at most, so that no topic starves the others."""

GRAPH_PERIOD_S: Final = 0.1
"""How often the graph is searched for new publishers."""

Batch = Sequence[tuple[Any, Any]]
"""Pairs of a message (or its serialised bytes) and rclpy's message info."""


def received_ns(info: Any) -> int:
    """Return when a message arrived, in ns since 1970."""
    return int(info["received_timestamp"] or time.time_ns())


def sent_ns(info: Any) -> int:
    """Return when a message was sent; when it arrived where the middleware does not say that.

    It is the same for every listener, and in the bag.
    """
    return int(info["source_timestamp"]) or received_ns(info)


class DrainedSubscription:
    """A subscription whose ``handle`` gets all waiting messages at once, in their order."""

    def __init__(
        self,
        node: Node,
        message_type: type,
        topic: str,
        qos: QoSProfile,
        handle: Callable[[Batch], None],
        *,
        raw: bool = False,
        event_callbacks: Any = None,
        group: Unwaited | None = None,
    ) -> None:
        self._handle = handle
        self._type = message_type
        self._raw = raw
        self.subscription = node.create_subscription(
            message_type, topic, self._on_message, qos, raw=raw, event_callbacks=event_callbacks,
            callback_group=group,
        )  # fmt: skip

    def drain(self) -> None:
        """Handle what is waiting now."""
        batch: list[tuple[Any, Any]] = []
        self._take(batch)
        if batch:
            self._handle(batch)

    def _on_message(self, message: Any, info: Any) -> None:
        batch = [(message, info)]
        self._take(batch)
        self._handle(batch)

    def _take(self, batch: list[tuple[Any, Any]]) -> None:
        handle = self.subscription.handle
        with handle:
            while len(batch) < LIMIT:
                pair = handle.take_message(self._type, self._raw)
                if pair is None:
                    return
                batch.append(pair)


class InstrumentSubscription:
    """Subscribes once there is a publisher, to match its quality of service.

    Reliable where the instrument offers it: best effort would match every publisher, but lose
    readings of a fast one. ``message_type`` may choose by the names of the publishers' types.
    """

    def __init__(
        self,
        node: Node,
        message_type: type | Callable[[Sequence[str]], type | None],
        topic: str,
        handle: Callable[[Batch], None],
    ) -> None:
        self._node, self._type, self._handle = node, message_type, handle
        self.topic = topic
        self._drained: DrainedSubscription | None = None
        self._timer = steady_timer(node, GRAPH_PERIOD_S, self._look)

    def move(self, topic: str) -> bool:
        """Listen to another topic from now on; False where it is this one."""
        if self._node.resolve_topic_name(topic) == self._node.resolve_topic_name(self.topic):
            return False
        self.topic = topic
        if self._drained is not None:
            self._node.destroy_subscription(self._drained.subscription)
            self._drained = None
            self._timer = steady_timer(self._node, GRAPH_PERIOD_S, self._look)
        return True

    def _look(self) -> None:
        infos = self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(self.topic))
        kind = self._kind([info.topic_type for info in infos]) if infos else None
        if kind is not None:
            qos = adapted_qos([info.qos_profile for info in infos])
            self._drained = DrainedSubscription(self._node, kind, self.topic, qos, self._handle)
            self._node.destroy_timer(self._timer)

    def _kind(self, type_names: Sequence[str]) -> type | None:
        return self._type if isinstance(self._type, type) else self._type(type_names)
