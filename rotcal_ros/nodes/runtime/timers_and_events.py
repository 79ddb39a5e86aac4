"""Timers and wake-ups of a node that do not depend on the system clock, and events it polls.

rclpy's timers run on the clock of the node, which is the system's: when that is set back by an
hour, they stand still for an hour.

A turn of an executor costs in proportion to the number of things that it waits for.

rclpy gives every publisher and subscription two or more event handlers, such as for lost messages,
and adds them to every wait set: that is most of the cost of a node with many topics.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from threading import Thread
from typing import Any, Final

from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import EventHandler
from rclpy.executors import Executor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

from rotcal_ros.foundation.clock_jumps import ClockWatch

_LOOK_S: Final = 0.1


def steady_timer(node: Node, period_s: float, work: Callable[[], Any]) -> Any:
    """Do ``work`` regularly, by the monotonic clock; return the timer."""
    return node.create_timer(period_s, work, clock=Clock(clock_type=ClockType.STEADY_TIME))


def wake_after_jumps(executor: Executor) -> None:
    """Wake an executor when the system clock has jumped.

    A middleware may wait until a time of the system clock, which moves away when that is set back.
    """

    def watch() -> None:
        clock = ClockWatch()
        while executor.context.ok():
            time.sleep(_LOOK_S)
            if clock.look() is not None:
                with suppress(rclpy_implementation.InvalidHandle):  # it was shut down meanwhile
                    executor.wake()

    Thread(target=watch, name="clock watch", daemon=True).start()


class Unwaited(CallbackGroup):
    """Entities that no executor waits for: they are polled regularly."""

    def can_execute(self, entity: Any) -> bool:
        """Return that no entity is executed in a turn."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Return that no execution begins."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Do nothing: no execution has begun."""


UNWAITED: Final = Unwaited()


def with_unwaited_events(entity: Any) -> Any:
    """Return a publisher or subscription whose events :func:`handle_events` looks for."""
    for handler in entity.event_handlers:
        handler.callback_group = UNWAITED
    return entity


def handle_events(node: Node) -> None:
    """Call the handlers of the events since the last call; the middleware keeps them."""
    for handler in [each for each in node.waitables if isinstance(each, EventHandler)]:
        handler._ready_to_take_data = True
        event = handler.take_data()
        if event is not None and event.total_count_change:
            handler.callback(event)
