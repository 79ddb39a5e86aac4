"""Runs the process of a node until SIGINT, SIGTERM or the end of its supervisor.

It also holds a node for programs that spin it themselves, long work in a thread, and lines of
JSON.
"""

from __future__ import annotations

import json
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, Final, NoReturn, TypeVar

import rclpy
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from threadpoolctl import threadpool_limits

from rotcal_ros.foundation.errors import ConfigurationError, RotcalError
from rotcal_ros.foundation.machine_load import WaitBudget, end_without_memory
from rotcal_ros.foundation.middleware import ROS_DEFAULT_RANGE, explain_start_failure, middleware
from rotcal_ros.nodes.runtime.cell_node import CellNode, wait_for_condition
from rotcal_ros.nodes.runtime.timers_and_subscriptions import wake_after_jumps

SUPERVISOR_VARIABLE: Final = "ROTCAL_SUPERVISOR"
"""Environment variable: process id of a supervisor that the node must not outlive."""
STOP_TIMEOUT_S: Final = 20.0
_TURN_S: Final = 0.2
_AWAKE_S: Final = 0.01
_PEER_TURN_S: Final = 0.1
T = TypeVar("T")


def run_node(make: Callable[[], CellNode], default_range: str = ROS_DEFAULT_RANGE) -> NoReturn:
    """Make a node, spin it until it has to end, and exit.

    ``default_range`` is the discovery range unless the user has set one.
    """
    run_and_exit(lambda: _spin(make), default_range)


def run_and_exit(work: Callable[[], None], default_range: str = ROS_DEFAULT_RANGE) -> NoReturn:
    """Do the work of a process and exit; a RotcalError becomes one line and its exit code."""
    use_middleware(default_range)
    use_single_thread()
    try:
        work()
    except RotcalError as error:
        sys.stderr.write(f"{error}\n")
        sys.exit(error.exit_code)
    except rclpy_implementation.RCLError as error:
        try:
            explain_start_failure(os.environ, str(error))
        except ConfigurationError as cause:
            sys.stderr.write(f"{cause}\n")
            sys.exit(cause.exit_code)
        raise
    except MemoryError as error:
        end_without_memory(error, "executor")
    sys.exit(0)


def use_middleware(default_range: str = ROS_DEFAULT_RANGE) -> None:
    """Let this process use the transport of the nodes, unless the user has set another."""
    os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)
    os.environ |= middleware(os.environ, default_range)


def use_single_thread() -> None:
    """Limit linear algebra to one thread: with more threads the last bits of sums differ."""
    os.environ["OMP_NUM_THREADS"] = "1"  # of what is loaded later
    threadpool_limits(1, "blas")


@contextmanager
def default_context() -> Iterator[None]:
    """Init and shut down rclpy's default context: in Jazzy rclpy.init is no context manager."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        yield
    finally:
        rclpy.try_shutdown()


class EndRequest:
    """Whether the process has to end; takes SIGINT and SIGTERM from now on."""

    def __init__(self) -> None:
        self._signalled = False
        supervisor = os.environ.get(SUPERVISOR_VARIABLE)
        self._supervisor = int(supervisor) if supervisor else None
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._note)

    def __bool__(self) -> bool:
        return self._signalled or (
            self._supervisor is not None and os.getppid() != self._supervisor
        )

    def _note(self, _number: int, _frame: FrameType | None) -> None:
        self._signalled = True


class _Rest:
    """Pauses between turns of the executor, so that messages collect.

    A turn costs as much for one message as for many. With ``use_sim_time`` there is no pause.
    """

    def __init__(self) -> None:
        self._taken_s = 0.0

    def take(self, node: CellNode) -> None:
        """Pause for as long as the node asks, if it has been awake for long enough."""
        if time.monotonic() < self._taken_s + _AWAKE_S:
            return
        if not node.health.sim.used:
            time.sleep(node.batch_period_s())
        self._taken_s = time.monotonic()


def _spin(make: Callable[[], CellNode]) -> None:
    """Spin a node; the first signal lets it finish its work (close its bag, end its goal).

    rclpy's own signal handlers would shut the middleware down at once; here it stays up.
    """
    end = EndRequest()
    with default_context():
        node = make()
        node.autostart()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        wake_after_jumps(executor)
        rest = _Rest()
        with suppress(ExternalShutdownException):
            while not (end or node.has_ended()):
                executor.spin_once(timeout_sec=_TURN_S)
                rest.take(node)
            if node.configured:
                _finish(node, executor)
            node.health.leave()
        executor.shutdown(timeout_sec=1.0)
        refused = node.health.refused
        node.destroy_node()
    if refused:
        raise refused


def _finish(node: CellNode, executor: SingleThreadedExecutor) -> None:
    """Let a node end its work, for a limited time."""
    node.begin_stop()
    budget = WaitBudget(STOP_TIMEOUT_S)
    while not node.stopped():
        if budget.is_over():
            return
        executor.spin_once(timeout_sec=_TURN_S)


async def run_in_thread(work: Callable[..., T], *arguments: object) -> T:
    """Run ``work`` in a thread of its own; return what it returns or raise what it raises."""
    with ThreadPoolExecutor(max_workers=1) as aside:
        found = aside.submit(work, *arguments)
        await wait_for_condition(found.done, math.inf)
        return found.result()


def print_event(event: str, **values: Any) -> None:
    """Print one line, even if its reader is gone."""
    with suppress(BrokenPipeError):
        sys.stdout.write(json.dumps({"event": event, **values}) + "\n")
        sys.stdout.flush()


class PeerNode:
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
        """Handle incoming messages until ``condition``; False after the time-out."""
        deadline = time.monotonic() + timeout_s
        while not condition():
            left = deadline - time.monotonic()
            self._executor.spin_once(timeout_sec=max(0.0, min(left, _PEER_TURN_S)))
            if left <= 0.0:
                return condition()
        return True

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()
