"""The states of a managed node of ROS, and what happens on the way between them."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from typing import Any, Final

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter

from rotcal_ros.foundation.errors import ConfigurationError, RotcalError
from rotcal_ros.foundation.node_state import NodeState, State, Why
from rotcal_ros.nodes.runtime.timers_and_events import (
    handle_events,
    steady_timer,
    with_unwaited_events,
)


def entities(node: Node) -> Iterator[Any]:
    """Yield all publishers, subscriptions, clients, services, timers and actions of a node."""
    yield from node.waitables
    yield from node.timers
    yield from node.subscriptions
    yield from node.services
    yield from node.clients
    yield from node.publishers


def destroy(node: Node, kept: Collection[Any]) -> None:
    """Destroy all entities but those ``kept``; what belongs to another one goes with that."""
    ways = (
        (node.timers, node.destroy_timer),
        (node.subscriptions, node.destroy_subscription),
        (node.services, node.destroy_service),
        (node.clients, node.destroy_client),
        (node.publishers, node.destroy_publisher),
    )
    for present, destroy_one in ways:
        for entity in [e for e in present if e not in kept]:
            destroy_one(entity)
    for action in [e for e in node.waitables if e not in kept]:
        action.destroy()


NOT_ACTIVE: Final = (State.INACTIVE, State.UNCONFIGURED)
WIND_UP_S: Final = 1.0
"""Longest wait of a clean-up; the node does not beat meanwhile."""
_POLL_S: Final = 0.02
EVENTS_PERIOD_S: Final = 0.1
"""Interval at which a node looks for events of the middleware."""
SUCCESS: Final = TransitionCallbackReturn.SUCCESS
FAILURE: Final = TransitionCallbackReturn.FAILURE


def not_active(health: Any, names: Iterable[str]) -> list[str]:
    """Return which of the other nodes are not active, and how that ends."""
    idle = (name for name in names if health.state(name) in NOT_ACTIVE)
    return [f"node {name} is {health.in_words(name)}" for name in idle]


class ManagedNode(LifecycleNode):
    """A node that makes what it needs in :meth:`configure` and works while it is active.

    ``autostart`` (parameter) takes it through both at its start. ``shut_down``: it has to end.
    """

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        steady_timer(self, EVENTS_PERIOD_S, lambda: handle_events(self))
        self.configured = self.active = self.shut_down = False
        self._starting = self._ending = False
        self._outside: frozenset[Any] = frozenset()
        self._failure: Exception | None = None
        self._autostart = self.parameter(
            "autostart", True, "configure and activate at the start; else wait for transitions"
        )

    def create_subscription(self, *arguments: Any, **options: Any) -> Any:
        """Make one whose events are handled now and then."""
        return with_unwaited_events(super().create_subscription(*arguments, **options))

    def create_publisher(self, *arguments: Any, **options: Any) -> Any:
        """Make one whose events are handled now and then."""
        return with_unwaited_events(super().create_publisher(*arguments, **options))

    def parameter(
        self, name: str, default: Any, description: str, *, read_only: bool = True
    ) -> Any:
        """Declare a parameter, once, and return its value."""
        if not self.has_parameter(name):
            descriptor = ParameterDescriptor(description=description, read_only=read_only)
            self.declare_parameter(name, default, descriptor)
        return self.get_parameter(name).value

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set parameters, all or none; a rejection says why, and what to do."""
        try:
            if fixed := [p.name for p in parameter_list if self._is_fixed(p.name)]:
                raise ConfigurationError(
                    f"{', '.join(fixed)}: taken when node {self.get_name()} starts and the same "
                    "until it ends; restart it with the value, or give it in the configuration"
                )
            self.judge_parameters({p.name: p.value for p in parameter_list})
        except ConfigurationError as error:
            return SetParametersResult(successful=False, reason=str(error))
        result: SetParametersResult = super().set_parameters_atomically(parameter_list)
        return result

    def judge_parameters(self, changes: Mapping[str, Any]) -> None:
        """Raise ConfigurationError where parameters cannot take values, name -> value."""

    def autostart(self) -> None:
        """Configure and activate, unless told not to; raise what makes that impossible."""
        if not self._autostart:
            self.get_logger().info(f"autostart is false: {self.inactivity().in_words()}")
            return
        self._starting = True
        for trigger in (self.trigger_configure, self.trigger_activate):
            if trigger() != SUCCESS and self._failure is not None:
                raise self._failure
        self._starting = False

    def inactivity(self) -> NodeState:
        """Return which state the node is in while it is not active, and how that ends."""
        name = self.get_fully_qualified_name()
        if self.configured:
            return NodeState.of(State.INACTIVE, Why.TO_ACTIVATE, name)
        return NodeState.of(State.UNCONFIGURED, Why.TO_CONFIGURE, name)

    def configure(self) -> None:
        """Make what the node needs; what is raised leaves it unconfigured."""

    def activated(self) -> None:
        """Begin to work."""

    def deactivated(self) -> None:
        """Stop working: give up what is going on, and keep what was made."""

    def begin_stop(self) -> None:
        """Begin to end: give up running work, close files."""
        self.deactivated()

    def stopped(self) -> bool:
        """Return whether nothing is left to do before the end."""
        return True

    def at_rest(self) -> bool:
        """Return whether nothing is under way that a clean-up would break."""
        return self.stopped()

    def finished(self) -> bool:
        """Return whether the work is done before the system asks the node to end."""
        return False

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Make what is needed; after a failure nothing is left."""
        self._outside, self._ending = frozenset(entities(self)), False
        self.configured = self._did("configure", self.configure)
        if not self.configured:
            destroy(self, self._outside)
        return self._entered(self.configured)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Work from now on."""
        if self._ending:
            self.get_logger().error("cannot activate: a clean-up was begun; clean up again")
            return FAILURE
        self.active = True
        self.active = self._did("activate", self.activated)
        return self._entered(self.active)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop working, whatever fails."""
        self.active = False
        self._did("deactivate", self.deactivated)
        return self._entered(True)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Give back all that :meth:`configure` made; FAILURE while something is still ending."""
        if not self._ending:
            self._ending = True
            self._did("clean up", self.begin_stop)
        deadline = time.monotonic() + WIND_UP_S
        while not self.at_rest():
            if time.monotonic() > deadline:
                self.get_logger().error("cannot clean up yet: work is still ending; try again")
                return FAILURE
            time.sleep(_POLL_S)
        self.configured = False
        destroy(self, self._outside)
        return self._entered(True)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the process in good order, like SIGINT."""
        self.shut_down = True
        return SUCCESS

    def _entered(self, success: bool) -> TransitionCallbackReturn:
        """Return how a transition ended; the others are told at once."""
        return SUCCESS if success else FAILURE

    def _did(self, what: str, work: Callable[[], None]) -> bool:
        """Return whether a part of a transition could be done; the console says why not."""
        self._failure = None
        try:
            work()
        except Exception as error:
            self._failure = error
            kind = "" if isinstance(error, RotcalError) else f"{type(error).__name__}: "
            if not self._starting:
                self.get_logger().error(f"cannot {what}: {kind}{error}")
        return self._failure is None

    def _is_fixed(self, name: str) -> bool:
        return self.has_parameter(name) and self.describe_parameter(name).read_only
