"""Running a node until it is told to end: by SIGINT, SIGTERM or the loss of its supervisor."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from types import FrameType
from typing import Final, Protocol

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from rotcal_ros.errors import RotcalError
from rotcal_ros.middleware import ROS_DEFAULT_RANGE, middleware

SUPERVISOR_VARIABLE: Final = "ROTCAL_SUPERVISOR"
"""Environment variable: process id of a supervisor that the node must not outlive."""
STOP_TIMEOUT_S: Final = 20.0
_TURN_S: Final = 0.2


class EndingNode(Protocol):
    """What a node offers so that it can be ended in good order; an rclpy Node besides."""

    def begin_stop(self) -> None:
        """Begin to end: give up running work, close files."""

    def stopped(self) -> bool:
        """Return whether nothing is left to do."""


def run_node(make: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Make a node and spin it until it is to end; return the exit code of the process.

    The first signal lets the node finish (close its bag, end its goal). The middleware stays up
    meanwhile, which the handlers of rclpy itself would not allow.
    """
    os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)
    os.environ |= middleware(os.environ, ROS_DEFAULT_RANGE)
    told = _Told()
    try:
        with rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO):
            node = make()
            executor = SingleThreadedExecutor()
            executor.add_node(node)
            with suppress(ExternalShutdownException):
                while not told.to_end() and not _finished(node):
                    executor.spin_once(timeout_sec=_TURN_S)
                _finish(node, executor)
            executor.shutdown(timeout_sec=1.0)
            node.destroy_node()
    except RotcalError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_code
    return 0


def _finished(node: Node) -> bool:
    """Return whether the node says that its work is done; most never do."""
    return hasattr(node, "finished") and bool(node.finished())


def _finish(node: Node, executor: SingleThreadedExecutor) -> None:
    """Let the node end its work, for a limited time."""
    if hasattr(node, "begin_stop"):
        node.begin_stop()
        deadline = time.monotonic() + STOP_TIMEOUT_S
        while not node.stopped() and time.monotonic() < deadline:
            executor.spin_once(timeout_sec=_TURN_S)


class _Told:
    """Whether the process was told to end."""

    def __init__(self) -> None:
        self._signalled = False
        supervisor = os.environ.get(SUPERVISOR_VARIABLE)
        self._supervisor = int(supervisor) if supervisor else None
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._note)

    def _note(self, _number: int, _frame: FrameType | None) -> None:
        self._signalled = True

    def to_end(self) -> bool:
        return self._signalled or (
            self._supervisor is not None and os.getppid() != self._supervisor
        )
