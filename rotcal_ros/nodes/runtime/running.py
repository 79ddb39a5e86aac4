"""Running a node until it has to end: by SIGINT, SIGTERM or the loss of its supervisor.

Long work in a thread, while the node goes on.
"""

from __future__ import annotations

import math
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Final, NoReturn, TypeVar

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.signals import SignalHandlerOptions
from threadpoolctl import threadpool_limits

from rotcal_ros.foundation.errors import ConfigurationError, RotcalError
from rotcal_ros.foundation.machine_load import Patience
from rotcal_ros.foundation.middleware import ROS_DEFAULT_RANGE, explain_start_failure, middleware
from rotcal_ros.nodes.runtime.cell_node import CellNode, until
from rotcal_ros.nodes.runtime.memory import end_without_memory
from rotcal_ros.nodes.runtime.timers_and_events import wake_after_jumps

SUPERVISOR_VARIABLE: Final = "ROTCAL_SUPERVISOR"
"""Environment variable: process id of a supervisor that the node must not outlive."""
STOP_TIMEOUT_S: Final = 20.0
_TURN_S: Final = 0.2
_AWAKE_S: Final = 0.01


def run(make: Callable[[], CellNode], default_range: str = ROS_DEFAULT_RANGE) -> NoReturn:
    """Make a node and spin it until it has to end; exit with the exit code of the process.

    ``default_range`` is the discovery range where the user has not set one.
    """
    leave_with(lambda: _spin(make), default_range)


def leave_with(work: Callable[[], None], default_range: str = ROS_DEFAULT_RANGE) -> NoReturn:
    """Do the work of a process and exit; an error of rotcal is one line and its exit code."""
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
    """Let this process use the transport of the nodes; what the user has set stays."""
    os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)
    os.environ |= middleware(os.environ, default_range)


def use_single_thread() -> None:
    """Limit linear algebra to one thread: with more threads the last bits of sums differ."""
    os.environ["OMP_NUM_THREADS"] = "1"  # of what is loaded later
    threadpool_limits(1, "blas")


@contextmanager
def default_context() -> Iterator[None]:
    """Keep ROS's default context up, without its signals: Jazzy's ``rclpy.init`` cannot."""
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
    """Lets messages gather as long as a node likes, after all that had gathered before.

    A turn costs as much for one message as for many.
    """

    def __init__(self) -> None:
        self._taken_s = 0.0

    def take(self, node: CellNode) -> None:
        """Rest for a moment, if the node was awake for long enough."""
        if time.monotonic() < self._taken_s + _AWAKE_S:
            return
        if not node.health.sim.used:
            time.sleep(node.gather_s())
        self._taken_s = time.monotonic()


def _spin(make: Callable[[], CellNode]) -> None:
    """Spin a node; the first signal lets it finish (close its bag, end its goal).

    The middleware stays up meanwhile, which the handlers of rclpy itself would not allow.
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
            while not (end or node.over()):
                executor.spin_once(timeout_sec=_TURN_S)
                rest.take(node)
            if node.configured:
                _finish(node, executor)
            node.health.leave()
        executor.shutdown(timeout_sec=1.0)
        refused = node.health.refused
        node.destroy_node()
    if refused:
        raise ConfigurationError(refused)


def _finish(node: CellNode, executor: SingleThreadedExecutor) -> None:
    """Let a node end its work, for a limited time."""
    node.begin_stop()
    patience = Patience(STOP_TIMEOUT_S)
    while not node.stopped():
        if patience.is_over():
            return
        executor.spin_once(timeout_sec=_TURN_S)


T = TypeVar("T")


async def done_aside(work: Callable[..., T], *arguments: object) -> T:
    """Return what ``work`` returns, or raise what it raises; it has a thread of its own."""
    with ThreadPoolExecutor(max_workers=1) as aside:
        found = aside.submit(work, *arguments)
        await until(found.done, math.inf)
        return found.result()
