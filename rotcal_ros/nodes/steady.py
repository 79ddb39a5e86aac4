"""What a node does by the clock, whatever becomes of the system's: timers and waking up.

rclpy's timers run by the clock of the node, which is the system's: set back by an hour, they are
still for an hour.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from threading import Thread
from typing import Any, Final

from rclpy.clock import Clock, ClockType
from rclpy.executors import Executor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

from rotcal_ros.clock_jumps import ClockWatch

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
