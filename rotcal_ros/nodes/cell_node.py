"""What all nodes of a cell share: they beat, take their parameters, and end in good order."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator
from concurrent.futures import Future
from types import coroutine
from typing import Any, TypeVar

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rotcal_msgs.msg import ProbeTarget, TableAngle

from rotcal_ros.bags import names
from rotcal_ros.capture.orders import Orders
from rotcal_ros.nodes.health import Health, Values
from rotcal_ros.nodes.parameters import declare_settings, given_parameters
from rotcal_ros.nodes.qos import EVENT
from rotcal_ros.nodes.steady import steady_timer
from rotcal_ros.nodes.topic_names import other_names
from rotcal_ros.observations import Command

T = TypeVar("T")


@coroutine
def _next_turn() -> Generator[None, None, None]:
    """Let the executor work, until its next event.

    The heartbeat's timer bounds the pause, so that time-outs are noticed too.
    """
    yield


async def until(
    condition: Callable[[], bool], timeout_s: float, check: Callable[[], None] | None = None
) -> bool:
    """Wait until ``condition``; False after ``timeout_s``. ``check`` may raise to give up."""
    deadline = time.monotonic() + timeout_s
    while not condition():
        if check is not None:
            check()
        if time.monotonic() > deadline:
            return False
        await _next_turn()
    return True


class CellNode(Node, ABC):
    """A node of the cell. ``given`` holds the parameters it was started with, in groups."""

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self.given = given_parameters(self)
        self._names: Values = other_names(self.get_namespace(), self.resolve_topic_name)
        self.health = Health(self, self._told, self._node_lost)

    def settings(self, group: str, cls: type[T], *, read_only: bool = True) -> T:
        """Declare a group of settings as parameters and return their values."""
        return declare_settings(self, self.given, group, cls, read_only=read_only)

    def listen(
        self, kind: type, topic: str, handle: Callable[[Any], None], qos: QoSProfile
    ) -> None:
        """Subscribe to a topic; an exception in ``handle`` is counted and logged."""
        self.create_subscription(kind, topic, self.health.guarded(handle), qos)

    def every(self, period_s: float, work: Callable[[], None]) -> None:
        """Do ``work`` regularly; an exception in it is counted and logged."""
        steady_timer(self, period_s, self.health.guarded(work))

    def take_orders(self, obey: Callable[[Command], None]) -> Orders:
        """Call ``obey`` with every complete order; return what waits for its other half."""
        orders = Orders()

        def listen(kind: type, topic: str, take: Callable[[Any], Command | None]) -> None:
            def handle(message: Any) -> None:
                if (command := take(message)) is not None:
                    obey(command)

            self.listen(kind, topic, handle, EVENT)

        listen(TableAngle, names.TABLE_ANGLE, orders.table_angle)
        listen(ProbeTarget, names.PROBE_TARGET, orders.probe_target)
        return orders

    def now_ns(self) -> int:
        """Return the time of the node's clock."""
        nanoseconds: int = self.get_clock().now().nanoseconds
        return nanoseconds

    async def answer_of(self, future: Future[T], timeout_s: float) -> T:
        """Return what a thread of this node works out, and let the node beat meanwhile."""
        future.add_done_callback(lambda _: self.executor.wake())
        await until(future.done, timeout_s)
        return future.result(timeout=0.0)

    def begin_stop(self) -> None:
        """Begin to end: give up running work, close files."""

    def stopped(self) -> bool:
        """Return whether nothing is left to do before the end."""
        return True

    def finished(self) -> bool:
        """Return whether the work is done before the system asks the node to end."""
        return False

    def _told(self) -> tuple[str, Values]:
        """Return what every beat tells: the report, and which topics are called otherwise."""
        state, values = self._report()
        return state, {**self._names, **values}

    @abstractmethod
    def _report(self) -> tuple[str, Values]:
        """Return the state in words and values; asked for every beat."""

    def _node_lost(self, name: str) -> None:
        """Hear that another node fell silent."""
