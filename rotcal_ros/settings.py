"""Settings: typed, documented and range-checked fields of frozen dataclasses.

One declaration serves everybody: the YAML reader checks against it, the ROS nodes declare their
parameters from it (description, unit, range), and the documentation lists it.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass
from operator import attrgetter
from typing import Any, TypeVar

from rotcal_ros.errors import ConfigurationError

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class SettingInfo:
    """What a setting means: ``description`` with the unit, and its inclusive range.

    ``choices`` of a setting that is a Literal are those of its type.
    """

    description: str
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()


def setting(
    default: Any = MISSING,
    *,
    doc: str,
    minimum: float | None = None,
    maximum: float | None = None,
    choices: Sequence[str] = (),
) -> Any:
    """Declare a field of a settings dataclass.

    ``doc`` names the unit. Without a default the setting is required. A list setting is a
    tuple; its range holds for every element.
    """
    info = SettingInfo(doc, minimum, maximum, tuple(choices))
    metadata = {"setting": info}
    if default is MISSING:
        return dataclasses.field(metadata=metadata, kw_only=True)
    return dataclasses.field(default=default, metadata=metadata, kw_only=True)


def group(cls: type[Any]) -> Any:
    """Declare a nested group of settings, all at their defaults unless given."""
    return dataclasses.field(default_factory=cls, kw_only=True)


def load(cls: type[T], values: Mapping[str, Any] | None, where: str) -> T:
    """Build the settings dataclass ``cls`` from a nested mapping.

    ``where`` names the place in error texts, e.g. ``demo.yaml: plan``. Raises
    ConfigurationError for unknown names (with the nearest known one), missing required
    settings, wrong types and values out of range.
    """
    values = {} if values is None else values
    if not isinstance(values, Mapping):
        raise ConfigurationError(f"{where}: expected a group of settings, found {values!r}")
    hints = typing.get_type_hints(cls)
    fields = {f.name: f for f in dataclasses.fields(cls)}  # type: ignore[arg-type]
    for name in values:
        if name not in fields:
            near = difflib.get_close_matches(str(name), fields, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else f"; known: {', '.join(fields)}"
            raise ConfigurationError(f"{where}: unknown setting {name!r}{hint}")
    loaded: dict[str, Any] = {}
    for name, field in fields.items():
        if name in values:
            place = f"{where}.{name}"
            hint_type = hints[name]
            if dataclasses.is_dataclass(hint_type):
                loaded[name] = load(typing.cast(type, hint_type), values[name], place)
            else:
                loaded[name] = _checked(values[name], hint_type, _info(field, hint_type), place)
        elif field.default is MISSING and field.default_factory is MISSING:
            raise ConfigurationError(
                f"{where}: setting {name!r} is missing ({field.metadata['setting'].description})"
            )
    return cls(**loaded)


def to_mapping(settings: Any) -> dict[str, Any]:
    """Return the nested mapping that :func:`load` turns into an equal object."""
    return {
        f.name: to_mapping(value) if dataclasses.is_dataclass(value) else _plain(value)
        for f in dataclasses.fields(settings)
        for value in [getattr(settings, f.name)]
    }


def declared(cls: type[Any], prefix: str = "") -> Iterator[tuple[str, Any, SettingInfo]]:
    """Yield (dotted name, type hint, info) of every setting of a class, groups flattened."""
    hints = typing.get_type_hints(cls)
    for field in dataclasses.fields(cls):
        hint = hints[field.name]
        if dataclasses.is_dataclass(hint):
            yield from declared(typing.cast(type, hint), f"{prefix}{field.name}.")
        else:
            yield prefix + field.name, hint, _info(field, hint)


def walk(settings: Any) -> Iterator[tuple[str, Any, SettingInfo]]:
    """Yield (dotted name, value, info) of every setting, groups flattened."""
    for name, _, info in declared(type(settings)):
        yield name, attrgetter(name)(settings), info


def scalar_of(hint: Any) -> tuple[Any, bool]:
    """Return the type of a setting's values (str for a Literal), and whether it is a list."""
    present = _present(hint)
    is_list = typing.get_origin(present) is tuple
    kind = typing.get_args(present)[0] if is_list else present
    return str if typing.get_origin(kind) is typing.Literal else kind, is_list


def _present(hint: Any) -> Any:
    """Return the type of a setting that is not None."""
    if typing.get_origin(hint) in (types.UnionType, typing.Union):
        return next(h for h in typing.get_args(hint) if h is not type(None))
    return hint


def _info(field: dataclasses.Field[Any], hint: Any) -> SettingInfo:
    """Return what a field means; a Literal brings its own choices."""
    info: SettingInfo = field.metadata["setting"]
    present = _present(hint)
    if typing.get_origin(present) is typing.Literal:
        return dataclasses.replace(info, choices=typing.get_args(present))
    return info


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def _checked(value: Any, hint: Any, info: SettingInfo, place: str) -> Any:
    """Return ``value`` as the hinted type, or raise with place, finding and expectation."""
    if value is None and type(None) in typing.get_args(hint):
        return None
    kind, is_list = scalar_of(hint)
    if not is_list:
        return _scalar(value, kind, info, place)
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise ConfigurationError(f"{place}: expected a list, found {value!r}")
    arguments = typing.get_args(_present(hint))
    if Ellipsis not in arguments and len(value) != len(arguments):
        raise ConfigurationError(
            f"{place}: expected {len(arguments)} values, found {len(value)}: {value!r}"
        )
    return tuple(_scalar(v, kind, info, f"{place}[{i}]") for i, v in enumerate(value))


def _scalar(value: Any, kind: Any, info: SettingInfo, place: str) -> Any:
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    fits: bool = isinstance(value, kind) and not (kind is int and isinstance(value, bool))
    if not fits:
        raise ConfigurationError(
            f"{place}: expected {kind.__name__} ({info.description}), found {value!r}"
        )
    if kind is float and not math.isfinite(value):
        raise ConfigurationError(f"{place}: expected a finite number, found {value!r}")
    low, high = info.minimum, info.maximum
    if (low is not None and value < low) or (high is not None and value > high):
        bounds = f"{'-inf' if low is None else low} to {'inf' if high is None else high}"
        raise ConfigurationError(
            f"{place}: {value!r} is out of range {bounds} ({info.description})"
        )
    if info.choices and value not in info.choices:
        raise ConfigurationError(f"{place}: {value!r} is none of {', '.join(info.choices)}")
    return value
