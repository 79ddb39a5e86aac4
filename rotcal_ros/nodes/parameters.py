"""ROS parameters declared from settings: typed, with description, unit and range.

A settings dataclass of a configuration's group ``plan`` becomes parameters ``plan.<setting>``.
"""

from __future__ import annotations

import dataclasses
import sys
import types
import typing
from collections.abc import Iterator
from typing import Any, Final, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import ParameterUninitializedException
from rclpy.node import Node
from rclpy.parameter import Parameter

from rotcal_ros.settings import SettingInfo, load, to_mapping

T = TypeVar("T")

_TYPES: Final = {
    bool: (Parameter.Type.BOOL, Parameter.Type.BOOL_ARRAY),
    int: (Parameter.Type.INTEGER, Parameter.Type.INTEGER_ARRAY),
    float: (Parameter.Type.DOUBLE, Parameter.Type.DOUBLE_ARRAY),
    str: (Parameter.Type.STRING, Parameter.Type.STRING_ARRAY),
}


def declare_settings(node: Node, group: str, cls: type[T], *, read_only: bool = True) -> T:
    """Declare the settings ``cls`` as parameters ``group.*`` and return their values.

    Overrides are checked by settings.load first, so that a wrong one gets the same
    ConfigurationError text as in ``rotcal run``; it also takes 1 for 1.0.
    """
    given: dict[str, Any] = {}
    for name, _, info in _walk(cls):
        loose = ParameterDescriptor(description=info.description, dynamic_typing=True)
        value = node.declare_parameter(f"{group}.{name}", None, loose).value
        node.undeclare_parameter(f"{group}.{name}")
        if value is not None:
            _put(given, name, value)
    settings = load(cls, given, f"{node.get_name()}: parameters {group}")
    for name, hint, info in _walk(cls):
        node.declare_parameter(
            f"{group}.{name}",
            _default(_get(settings, name), hint),
            _descriptor(info, hint, read_only),
            ignore_override=True,
        )
    return settings


def read_settings(node: Node, group: str, cls: type[T]) -> T:
    """Return the present values of parameters that :func:`declare_settings` declared."""
    values: dict[str, Any] = {}
    for name, _, _ in _walk(cls):
        try:
            value = node.get_parameter(f"{group}.{name}").value
        except ParameterUninitializedException:
            value = None
        if value is not None:
            _put(values, name, list(value) if not isinstance(value, str | int | float) else value)
    return load(cls, values, f"{node.get_name()}: parameters {group}")


def settings_mapping(node: Node, group: str, cls: type[Any]) -> dict[str, Any]:
    """Return the present values as a group of a configuration, for its text."""
    return to_mapping(read_settings(node, group, cls))


def _walk(cls: type[Any], prefix: str = "") -> Iterator[tuple[str, Any, SettingInfo]]:
    """Yield (dotted name, type hint, info) of every setting of ``cls``, groups flattened."""
    hints = typing.get_type_hints(cls)
    for field in dataclasses.fields(cls):
        if dataclasses.is_dataclass(hints[field.name]):
            yield from _walk(hints[field.name], f"{prefix}{field.name}.")
        else:
            yield prefix + field.name, hints[field.name], field.metadata["setting"]


def _element(hint: Any) -> tuple[type, bool]:
    """Return the scalar type of a hint and whether it is a list of them."""
    if typing.get_origin(hint) in (types.UnionType, typing.Union):
        hint = next(h for h in typing.get_args(hint) if h is not type(None))
    if typing.get_origin(hint) is tuple:
        return typing.get_args(hint)[0], True
    return hint, False


def _default(value: Any, hint: Any) -> Any:
    """Return what gives a parameter its type as well: a value, or a mere type for none.

    rclpy takes an empty list for one of bytes, so that it counts as none.
    """
    scalar, is_list = _element(hint)
    if value is None or value == ():
        return _TYPES[scalar][is_list]
    return list(value) if isinstance(value, tuple) else value


def _descriptor(info: SettingInfo, hint: Any, read_only: bool) -> ParameterDescriptor:
    """Describe a setting; ROS knows ranges of scalars only, all else is said in words."""
    scalar, is_list = _element(hint)
    descriptor = ParameterDescriptor(description=info.description, read_only=read_only)
    words = []
    if info.choices:
        words.append(f"one of: {', '.join(info.choices)}")
    low, high = info.minimum, info.maximum
    if low is not None or high is not None:
        if is_list or scalar not in (int, float):
            words.append(f"every value from {low} to {high}")
        elif scalar is float:
            limits = (-sys.float_info.max, sys.float_info.max)
            descriptor.floating_point_range = [FloatingPointRange(**_limits(info, limits))]
        else:
            integers = _limits(info, (-(2**63), 2**63 - 1))
            descriptor.integer_range = [IntegerRange(**{k: int(v) for k, v in integers.items()})]
    descriptor.additional_constraints = "; ".join(words)
    return descriptor


def _limits(info: SettingInfo, open_ends: tuple[float, float]) -> dict[str, float]:
    low, high = open_ends
    return {
        "from_value": low if info.minimum is None else info.minimum,
        "to_value": high if info.maximum is None else info.maximum,
    }


def _put(mapping: dict[str, Any], dotted: str, value: Any) -> None:
    *groups, name = dotted.split(".")
    for group in groups:
        mapping = mapping.setdefault(group, {})
    mapping[name] = value


def _get(settings: Any, dotted: str) -> Any:
    for name in dotted.split("."):
        settings = getattr(settings, name)
    return settings
