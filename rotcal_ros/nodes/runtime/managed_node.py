"""The states and parameters of a managed node of ROS.

A settings dataclass of a configuration's group ``plan`` becomes parameters ``plan.<setting>``:
typed, with description, unit and range.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Set
from operator import attrgetter
from types import MappingProxyType
from typing import Any, Final, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter

from rotcal_ros.foundation.errors import ConfigurationError, RotcalError
from rotcal_ros.foundation.node_state import NodeState, State, Why
from rotcal_ros.foundation.settings import Declaration, declarations, load
from rotcal_ros.nodes.runtime.timers_and_subscriptions import (
    connect_subscriptions,
    handle_events,
    steady_timer,
    with_polled_events,
)


def node_entities(node: Node) -> Iterator[Any]:
    """Yield all publishers, subscriptions, clients, services, timers and actions of a node.

    A subscription stands as its callback, for which it may be made anew.
    """
    yield from node.waitables
    yield from node.timers
    yield from (each.callback for each in node.subscriptions)
    yield from node.services
    yield from node.clients
    yield from node.publishers


def destroy_entities(node: Node, kept: Set[Any]) -> None:
    """Destroy all entities but those ``kept``; an entity that belongs to another goes with it."""
    ways = (
        (node.timers, node.destroy_timer),
        (node.subscriptions, node.destroy_subscription),
        (node.services, node.destroy_service),
        (node.clients, node.destroy_client),
        (node.publishers, node.destroy_publisher),
    )
    for present, destroy_one in ways:
        for entity in [e for e in present if not {e, getattr(e, "callback", e)} & kept]:
            destroy_one(entity)
    for action in [e for e in node.waitables if e not in kept]:
        action.destroy()


NOT_ACTIVE: Final = (State.INACTIVE, State.UNCONFIGURED)
WIND_UP_S: Final = 1.0
"""Longest wait of a clean-up: transitions run in the executor, which stands still meanwhile."""
_POLL_S: Final = 0.02
EVENTS_PERIOD_S: Final = 0.1
"""Period at which events of the middleware are polled."""
SUCCESS: Final = TransitionCallbackReturn.SUCCESS
FAILURE: Final = TransitionCallbackReturn.FAILURE


def inactive_node_hints(health: Any, names: Iterable[str]) -> list[str]:
    """Return which of these nodes are not active, and how to activate them."""
    idle = (name for name in names if health.state(name) in NOT_ACTIVE)
    return [f"node {name} is {health.describe(name)}" for name in idle]


class ManagedNode(LifecycleNode):
    """A node that makes what it needs in :meth:`configure` and works while it is active.

    The parameter ``autostart`` configures and activates it at its start. ``shut_down``: it has to
    end.
    """

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        steady_timer(self, EVENTS_PERIOD_S, self._attend)
        self.configured = self.active = self.shut_down = False
        self._starting = self._ending = False
        self._outside: frozenset[Any] = frozenset()
        self._failure: Exception | None = None
        self._autostart = self.parameter(
            "autostart", True, "configure and activate at the start; else wait for transitions"
        )

    def _attend(self) -> None:
        handle_events(self)
        connect_subscriptions(self)

    def create_subscription(self, *arguments: Any, **options: Any) -> Any:
        """Create one whose events are polled."""
        return with_polled_events(super().create_subscription(*arguments, **options))

    def create_publisher(self, *arguments: Any, **options: Any) -> Any:
        """Create one whose events are polled."""
        return with_polled_events(super().create_publisher(*arguments, **options))

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
                    f"{', '.join(fixed)}: fixed when node {self.get_name()} starts; restart it "
                    "with the value, or give it in the configuration"
                )
            self.judge_parameters({p.name: p.value for p in parameter_list})
        except ConfigurationError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return super().set_parameters_atomically(parameter_list)

    def judge_parameters(self, changes: Mapping[str, Any]) -> None:
        """Raise ConfigurationError if parameters cannot take these values (name -> value)."""

    def autostart(self) -> None:
        """Configure and activate, unless told not to; an error on the way is raised."""
        if not self._autostart:
            self.get_logger().info(f"autostart is false: {self.inactivity().describe()}")
            return
        self._starting = True
        for trigger in (self.trigger_configure, self.trigger_activate):
            if trigger() != SUCCESS and self._failure is not None:
                raise self._failure
        self._starting = False

    def inactivity(self) -> NodeState:
        """Return the state of a node that is not active, and how to activate it."""
        name = self.get_fully_qualified_name()
        if self.configured:
            return NodeState.of(State.INACTIVE, Why.TO_ACTIVATE, name)
        return NodeState.of(State.UNCONFIGURED, Why.TO_CONFIGURE, name)

    def configure(self) -> None:
        """Make what the node needs; an exception leaves it unconfigured."""

    def activated(self) -> None:
        """Begin to work."""

    def deactivated(self) -> None:
        """Stop working: give up running work, and keep what was made."""

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
        self._outside, self._ending = frozenset(node_entities(self)), False
        self.configured = self._did("configure", self.configure)
        if not self.configured:
            destroy_entities(self, self._outside)
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
        """Destroy all that :meth:`configure` made; FAILURE while something is still ending."""
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
        destroy_entities(self, self._outside)
        return self._entered(True)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the process in good order, like SIGINT."""
        self.shut_down = True
        return SUCCESS

    def _entered(self, success: bool) -> TransitionCallbackReturn:
        """Return how a transition ended; the others are told at once."""
        return SUCCESS if success else FAILURE

    def _did(self, what: str, work: Callable[[], None]) -> bool:
        """Do a part of a transition; return whether it succeeded. A failure is logged."""
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


T = TypeVar("T")

OF_ROS: Final = ("use_sim_time", "start_type_description_service", "qos_overrides")
"""Parameters (or first parts of their names) that ROS itself gives every node."""
_TYPES: Final = {
    bool: (Parameter.Type.BOOL, Parameter.Type.BOOL_ARRAY),
    int: (Parameter.Type.INTEGER, Parameter.Type.INTEGER_ARRAY),
    float: (Parameter.Type.DOUBLE, Parameter.Type.DOUBLE_ARRAY),
    str: (Parameter.Type.STRING, Parameter.Type.STRING_ARRAY),
}
_LARGEST: Final = sys.float_info.max
_RANGES: Final[dict[type, Any]] = {
    float: ("floating_point_range", FloatingPointRange, -_LARGEST, _LARGEST),
    int: ("integer_range", IntegerRange, -(2**63), 2**63 - 1),
}
"""Field of the descriptor, its message, and the ends of an open range."""


def given_parameters(node: Node) -> dict[str, Any]:
    """Return the parameters that a node was given at its start, as nested groups."""
    # rclpy has no other way to see what is not declared yet; an empty list has no value there.
    given = {
        name: [] if parameter.value is None else parameter.value
        for name, parameter in node._parameter_overrides.items()
        if name.partition(".")[0] not in OF_ROS
    }
    return _nested(given)


def declare_settings(
    node: Node, given: Mapping[str, Any], group: str, cls: type[T], *, read_only: bool = True
) -> T:
    """Declare the settings ``cls`` as parameters ``group.*`` and return their values.

    What was ``given`` is checked by settings.load, so that a wrong or misspelt one raises the same
    ConfigurationError as in ``rotcal run``; it also takes 1 for 1.0. An optional setting without a
    value is not declared: a parameter without a value keeps ``ros2 param dump`` from showing any.
    """
    settings = load(cls, given.get(group), f"{node.get_name()}: parameters {group}")
    for declared in declarations(cls):
        value = attrgetter(declared.name)(settings)
        if value is not None and not node.has_parameter(f"{group}.{declared.name}"):
            _declare(node, f"{group}.{declared.name}", value, declared, read_only)
    return settings


def read_settings(
    node: Node, group: str, cls: type[T], changes: Mapping[str, Any] = MappingProxyType({})
) -> T:
    """Return the present values of parameters that :func:`declare_settings` declared.

    ``changes`` is parameter name -> new value. Raises ConfigurationError if these settings exclude
    each other.
    """
    values = {}
    for declared in declarations(cls):
        name = f"{group}.{declared.name}"
        value = changes[name] if name in changes else node.get_parameter_or(name).value
        if declared.is_list and not (declared.optional and value is None):
            value = list(value or ())
        values[declared.name] = value
    return load(cls, _nested(values), f"{node.get_name()}: parameters {group}")


def _nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested groups from dotted names, without those that are None."""
    found: dict[str, Any] = {}
    for dotted, value in values.items():
        *groups, name = dotted.split(".")
        place = found
        for group in groups:
            place = place.setdefault(group, {})
        if value is not None:
            place[name] = value
    return found


def _declare(node: Node, name: str, value: Any, declared: Declaration, read_only: bool) -> None:
    """Declare one setting; rclpy takes an empty list for one of bytes, so it is told the type."""
    descriptor = _descriptor(declared, read_only)
    if value != ():
        given = list(value) if declared.is_list else value
        node.declare_parameter(name, given, descriptor, ignore_override=True)
        return
    kind = _TYPES[declared.kind][True]
    node.declare_parameter(name, kind, _descriptor(declared, False), ignore_override=True)
    node.set_parameters([Parameter(name, kind, [])])
    descriptor.type = kind.value
    node.set_descriptor(name, descriptor)


def _descriptor(declared: Declaration, read_only: bool) -> ParameterDescriptor:
    """Describe a setting; ROS knows ranges of scalars only, others go into the description."""
    info = declared.info
    descriptor = ParameterDescriptor(description=info.description, read_only=read_only)
    words = []
    if info.choices:
        words.append(f"one of: {', '.join(info.named_choices)}")
    low, high = info.minimum, info.maximum
    if low is not None or high is not None:
        if declared.is_list or declared.kind not in _RANGES:
            words.append(f"every value from {low} to {high}")
        else:
            field, kind, lowest, highest = _RANGES[declared.kind]
            lowest = lowest if low is None else declared.kind(low)
            highest = highest if high is None else declared.kind(high)
            setattr(descriptor, field, [kind(from_value=lowest, to_value=highest)])
    descriptor.additional_constraints = "; ".join(words)
    return descriptor
