"""The base class of all nodes of a cell."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable, Generator
from concurrent.futures import Future
from inspect import isawaitable
from types import coroutine
from typing import Any, Final, TypeVar

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSProfile
from rotcal_msgs.msg import ProbeTarget, TableAngle

from rotcal_ros.bags import names
from rotcal_ros.capture.messages import OrderPairing
from rotcal_ros.foundation.errors import RotcalError
from rotcal_ros.foundation.machine_load import WaitBudget
from rotcal_ros.foundation.node_state import NodeState
from rotcal_ros.foundation.observations import Command
from rotcal_ros.nodes.runtime.accepted_publishers import AcceptedPublishers
from rotcal_ros.nodes.runtime.beat_values import remapped_topic_values
from rotcal_ros.nodes.runtime.health import Health, Values
from rotcal_ros.nodes.runtime.managed_node import ManagedNode, declare_settings, given_parameters
from rotcal_ros.nodes.runtime.qos import EVENT
from rotcal_ros.nodes.runtime.timers_and_subscriptions import (
    Batch,
    DrainedSubscription,
    steady_timer,
)
from rotcal_ros.planning.settings import HealthSettings

T = TypeVar("T")

IDLE_S: Final = 0.1
"""While nothing is measured, messages are collected for this time and handled together."""
_QUIET: Final = frozenset({"recorder", "solver"})
"""Nodes that do not log ignored publishers: capture and planner already do."""


@coroutine
def _next_turn() -> Generator[None, None, None]:
    """Return to the executor until its next event.

    A coroutine of rclpy that yields None is resumed in the executor's next turn. There is one at
    least every BEAT_PERIOD_S, by the heartbeat's timer, so time-outs are noticed too.
    """
    yield


async def wait_for_condition(
    condition: Callable[[], bool],
    timeout_s: float,
    check: Callable[[], None] | None = None,
    pausing: Callable[[], bool] = lambda: False,
) -> bool:
    """Wait until ``condition``; return False after ``timeout_s``. ``check`` may raise to give up.

    The time does not count while ``pausing`` is true (a slow node is waited for), nor while this
    process stands still.
    """
    budget = WaitBudget(timeout_s)
    while not condition():
        if check is not None:
            check()
        if budget.is_over(pausing=pausing()):
            return False
        await _next_turn()
    return True


class NotActiveError(RotcalError):
    """A node that is not active was asked for something."""


class CellNode(ManagedNode, ABC):
    """A node of the cell; ``given`` holds the parameters it was started with, in groups.

    Subscriptions, timers and services made by :meth:`listen`, :meth:`every` and
    :meth:`offer` work only while the node is active. A latched message that comes earlier waits
    until then, since its publisher will not send it again. The node beats in every state.
    """

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self.given = given_parameters(self)
        self._latched: dict[Callable[[Any], None], Any] = {}
        self._ignored_topics: set[str] = set()
        self._answering = 0
        self._answers = MutuallyExclusiveCallbackGroup()
        self._names: Values = remapped_topic_values(self.get_namespace(), self.resolve_topic_name)
        self.accepted = AcceptedPublishers(self, quiet=name in _QUIET)
        settings = self.settings("health", HealthSettings)
        self.health = Health(self, self._beat_values, self._missed, settings=settings)

    def settings(self, group: str, cls: type[T], *, read_only: bool = True) -> T:
        """Declare a group of settings as parameters and return their values."""
        return declare_settings(self, self.given, group, cls, read_only=read_only)

    def listen(
        self,
        kind: type,
        topic: str,
        handle: Callable[[Any], None],
        qos: QoSProfile | int,
        *,
        judged: bool = False,
    ) -> None:
        """Subscribe to a topic; an exception in ``handle`` is counted and logged.

        ``judged``: while a goal runs, only messages of the publishers of the run are handled.
        """
        handle = self.health.guarded(handle)
        latched = getattr(qos, "durability", None) == DurabilityPolicy.TRANSIENT_LOCAL

        def take(batch: Batch) -> None:
            for message, info in batch:
                if judged and not self.accepted.accepts(self.resolve_topic_name(topic), info):
                    continue
                if self.active:
                    handle(message)
                elif latched:
                    self._latched[handle] = message
                elif topic not in self._ignored_topics:
                    self._ignored_topics.add(topic)
                    self.get_logger().warning(f"{topic} is ignored: {self.not_active_error()}")

        DrainedSubscription(self, kind, topic, qos, take)

    def every(self, period_s: float, work: Callable[[], None]) -> None:
        """Do ``work`` regularly; an exception in it is counted and logged."""
        work = self.health.guarded(work)
        steady_timer(self, period_s, lambda: work() if self.active else None)

    def offer(
        self, kind: type, name: str, handle: Callable[[Any, Any], Any], *, always: bool = False
    ) -> None:
        """Offer a service; a ``message`` in its response says why a request was refused.

        ``always``: it is not refused while the node is inactive. A slow answer holds up other
        services, but neither subscriptions nor the beat.
        """

        async def answer(request: Any, response: Any) -> Any:
            if not (self.active or always):
                response.message = str(self.not_active_error())
                return response
            self._answering += 1
            try:
                answered = handle(request, response)
                return await answered if isawaitable(answered) else answered
            finally:
                self._answering -= 1

        self.create_service(kind, name, answer, callback_group=self._answers)

    def begin(self, work: Callable[..., Awaitable[None]], *arguments: Any) -> None:
        """Run a coroutine in the executor; it is given up when the node is cleaned up."""

        async def do() -> None:
            try:
                await work(*arguments)
            except rclpy_implementation.InvalidHandle:
                self.get_logger().info(f"given up: {work.__name__.strip('_')}")
            except Exception as error:
                self.health.note_error(work.__name__, error)

        self.executor.create_task(do)

    def take_orders(self, obey: Callable[[Command], None]) -> OrderPairing:
        """Call ``obey`` with every complete order; return the waiting halves (table, probe)."""
        orders = OrderPairing()

        def listen(kind: type, topic: str, take: Callable[[Any], Command | None]) -> None:
            def handle(message: Any) -> None:
                if (command := take(message)) is not None:
                    obey(command)

            self.listen(kind, topic, handle, EVENT, judged=True)

        listen(TableAngle, names.TABLE_ANGLE, orders.table_angle)
        listen(ProbeTarget, names.PROBE_TARGET, orders.probe_target)
        return orders

    def batch_period_s(self) -> float:
        """Return for how many seconds messages are collected, to be handled in one turn."""
        return 0.0

    def idle_batch_period_s(self) -> float:
        """Return :meth:`batch_period_s` of a node that works in calibrations only."""
        return 0.0 if self.health.is_calibrating() else IDLE_S

    def not_active_error(self) -> NotActiveError:
        """Return the error of a request to this node while it is not active."""
        return NotActiveError(f"node {self.get_name()} is {self.inactivity().describe()}")

    def has_ended(self) -> bool:
        """Return whether the node has to end: shut down, finished, or second of its name."""
        done = self.configured and self.finished()
        return self.shut_down or done or bool(self.health.refused)

    def at_rest(self) -> bool:
        """Return whether nothing is under way that a clean-up would break."""
        return self._answering == 0 and self.stopped()

    def now_ns(self) -> int:
        """Return the time of the node's clock."""
        return self.get_clock().now().nanoseconds

    async def answer_of(self, future: Future[T], timeout_s: float) -> T:
        """Return the result of work in a thread; the executor goes on meanwhile."""
        future.add_done_callback(lambda _: self.executor.wake())
        await wait_for_condition(future.done, timeout_s)
        return future.result(timeout=0.0)

    @abstractmethod
    def _report(self) -> tuple[NodeState, Values]:
        """Return the state and values of the node; called for every beat."""

    def _node_lost(self, name: str) -> None:
        """Handle the loss of another node."""

    def _beat_values(self) -> tuple[NodeState, Values]:
        """Return state and values of a beat: the report, and topics with other names."""
        state, values = self._report() if self.configured else (self.inactivity(), {})
        known = {**self._names, **self.accepted.values(), **values}
        return state if self.active else self.inactivity(), known

    def _missed(self, name: str) -> None:
        if self.configured:
            self._node_lost(name)

    def _entered(self, success: bool) -> TransitionCallbackReturn:
        """Handle the latched messages that waited for the node to be active, and beat."""
        if self.active:
            for handle, message in self._latched.items():
                handle(message)
        if self.active or not self.configured:
            self._latched.clear()
        self._ignored_topics.clear()
        self.health.beat()
        return super()._entered(success)
