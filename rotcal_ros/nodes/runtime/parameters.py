"""ROS parameters declared from settings: typed, with description, unit and range.

A settings dataclass of a configuration's group ``plan`` becomes parameters ``plan.<setting>``.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from operator import attrgetter
from types import MappingProxyType
from typing import Any, Final, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from rotcal_ros.foundation.settings import Declaration, declarations, load

T = TypeVar("T")

OF_ROS: Final = ("use_sim_time", "start_type_description_service", "qos_overrides")
"""Parameters, or the first parts of their names, that ROS itself gives to every node."""
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
    """Return what a node was given at its start, as nested groups."""
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

    What was ``given`` is checked by settings.load, so that a wrong or misspelt one gets the same
    ConfigurationError text as in ``rotcal run``; it also takes 1 for 1.0. An optional setting that
    has no value becomes no parameter: a listed one without value keeps ``ros2 param dump`` from
    showing any.
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

    ``changes`` is parameter name -> value of those that shall be changed. ConfigurationError when
    these settings cannot be together.
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
    """Return groups of groups from dotted names; what is None is left out."""
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
    """Describe a setting; ROS knows ranges of scalars only, all else goes into the description."""
    info = declared.info
    descriptor = ParameterDescriptor(description=info.description, read_only=read_only)
    words = []
    if info.choices:
        words.append(f"one of: {', '.join(info.choices)}")
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
