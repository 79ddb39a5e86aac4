"""Timers, subscriptions and events of nodes: independent of the system clock, and quick.

rclpy's own timers follow the system clock: when it is set back by an hour, they stand still for an
hour.

An executor takes one message per wait, which limits a node to some 2,700 messages per second;
emptying the subscription inside the callback takes several times more without a loss.

The cost of each wait grows with the number of things that are waited for. rclpy adds two or more
event handlers (such as for lost messages) for every publisher and subscription, which is most of
the cost of a node with many topics: here they are polled by a timer instead.

Sometimes the middleware never connects two ends that it knows, but does connect new ones: who does
not hear what is sent subscribes anew.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from inspect import Signature
from threading import Thread
from typing import Any, Final

from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import EventHandler
from rclpy.executors import Executor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import QoSProfile

from rotcal_ros.foundation.clock_jumps import ClockWatch
from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.nodes.runtime.qos import adapted_qos

UNHEARD_S: Final = 5.0
"""How long what is sent may fail to arrive before a node subscribes anew."""
_LOOK_S: Final = 0.1
_NO_ARGUMENTS: Final = Signature()


def steady_timer(node: Node, period_s: float, work: Callable[[], Any]) -> Any:
    """Do ``work`` regularly, by the monotonic clock; return the timer.

    At every turn rclpy asks for the signature of what it calls, which takes longer than most work.
    """

    def turn() -> Any:
        return work()

    turn.__signature__ = _NO_ARGUMENTS  # type: ignore[attr-defined]
    return node.create_timer(period_s, turn, clock=Clock(clock_type=ClockType.STEADY_TIME))


def wake_after_jumps(executor: Executor) -> None:
    """Wake an executor when the system clock has jumped.

    The middleware may wait for a time of the system clock: set back, it would wait for hours.
    """

    def watch() -> None:
        clock = ClockWatch()
        while executor.context.ok():
            time.sleep(_LOOK_S)
            if clock.poll() is not None:
                with suppress(rclpy_implementation.InvalidHandle):  # it was shut down meanwhile
                    executor.wake()

    Thread(target=watch, name="clock watch", daemon=True).start()


class PolledCallbackGroup(CallbackGroup):
    """A callback group whose entities no executor waits for: a timer polls them.

    An executor leaves an entity out of its wait set if the group says that it cannot be executed.
    """

    def can_execute(self, entity: Any) -> bool:
        """Return False, so that the executor waits for none."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Return False: no execution begins."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Do nothing: no execution has begun."""


UNWAITED: Final = PolledCallbackGroup()


def with_polled_events(entity: Any) -> Any:
    """Return a publisher or subscription whose events :func:`handle_events` polls."""
    for handler in entity.event_handlers:
        handler.callback_group = UNWAITED
    return entity


def handle_events(node: Node) -> None:
    """Call the handlers of all events since the last call; the middleware counts meanwhile."""
    for handler in [each for each in node.waitables if isinstance(each, EventHandler)]:
        handler._ready_to_take_data = True  # else set by a wait of the executor
        event = handler.take_data()
        if event is not None and event.total_count_change:
            handler.callback(event)


LIMIT: Final = 1000
"""Most messages that one callback takes, so that no topic starves the others."""

GRAPH_PERIOD_S: Final = 0.1
"""Period at which the graph is searched for new publishers."""

Batch = Sequence[tuple[Any, Any]]
"""Pairs of a message (or its serialised bytes) and rclpy's message info."""


def received_ns(info: Any) -> int:
    """Return when a message arrived, in ns since 1970."""
    return int(info["received_timestamp"] or time.time_ns())


def sent_ns(info: Any) -> int:
    """Return when a message was sent, or when it arrived if the middleware does not say that.

    The time of sending is the same for every listener, and in the bag.
    """
    return int(info["source_timestamp"]) or received_ns(info)


class ResubscribeBackoff:
    """Says when to subscribe anew where something is not heard: less and less often."""

    def __init__(self, now_s: float) -> None:
        self._well_s, self._wait_s = now_s, UNHEARD_S

    def is_due(self, deaf: bool, now_s: float) -> bool:
        """Return whether it is time to; look regularly, by a clock of seconds."""
        if not deaf:
            self._well_s, self._wait_s = now_s, UNHEARD_S
        elif now_s - self._well_s > load_scaled_timeout(self._wait_s):
            self._wait_s *= 2.0
            return True
        return False


class DrainedSubscription:
    """A subscription whose ``handle`` gets all waiting messages at once, in order."""

    def __init__(
        self,
        node: Node,
        message_type: type,
        topic: str,
        qos: QoSProfile | int,
        handle: Callable[[Batch], None],
        *,
        raw: bool = False,
        event_callbacks: Any = None,
        group: PolledCallbackGroup | None = None,
    ) -> None:
        self._node, self._handle, self._type, self._raw = node, handle, message_type, raw
        self._make = partial(
            node.create_subscription, message_type, topic, self._on_message, qos, raw=raw,
            event_callbacks=event_callbacks, callback_group=group,
        )  # fmt: skip
        self._backoff = ResubscribeBackoff(time.monotonic())
        self.subscription = self._make()

    def anew(self) -> None:
        """Replace the subscription by a new one."""
        self._node.destroy_subscription(self.subscription)
        self.subscription = self._make()

    def connect(self) -> None:
        """Subscribe anew if for long no publisher has been connected although there is one."""
        topic, now_s = self.subscription.topic_name, time.monotonic()
        alone = self.subscription.get_publisher_count() == 0
        if self._backoff.is_due(alone and self._node.count_publishers(topic) > 0, now_s):
            self._node.get_logger().info(f"{topic} is published but not received; resubscribing")
            self.anew()

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
                # rclpy itself takes one message per turn; this empties the queue in one turn.
                pair = handle.take_message(self._type, self._raw)
                if pair is None:
                    return
                batch.append(pair)


def connect_subscriptions(node: Node) -> None:
    """Let every :class:`DrainedSubscription` of a node look whether it is connected."""
    owners = [getattr(each.callback, "__self__", None) for each in node.subscriptions]
    for owner in owners:
        if isinstance(owner, DrainedSubscription):
            owner.connect()


class InstrumentSubscription:
    """Subscribes once there is a publisher, with a quality of service that matches it.

    It is reliable if the publisher is: best effort would match every publisher, but lose readings
    of a fast one. ``message_type`` may be a function that chooses one of the publishers' types.
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
        """Subscribe to another topic; return False if it is the same one."""
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
