"""A node that is spun by hand, for programs that are more than a node."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Final

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from rotcal_ros.nodes.runtime.timers_and_events import wake_after_jumps

_TURN_S: Final = 0.1


class Peer:
    """A node in a context of its own, which is a DDS participant of its own.

    ``args`` are arguments of ROS's command line.
    """

    def __init__(self, name: str, namespace: str = "", args: Sequence[str] = ()) -> None:
        self._context = Context()
        rclpy.init(
            args=[*args], context=self._context, signal_handler_options=SignalHandlerOptions.NO
        )
        self.node = Node(name, namespace=namespace, context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        wake_after_jumps(self._executor)

    def work_until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Handle what comes in until ``condition``; False after the time-out."""
        deadline = time.monotonic() + timeout_s
        while not condition():
            left = deadline - time.monotonic()
            self._executor.spin_once(timeout_sec=max(0.0, min(left, _TURN_S)))
            if left <= 0.0:
                return condition()
        return True

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()
