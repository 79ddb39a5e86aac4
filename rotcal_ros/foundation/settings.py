"""Settings: typed, documented and range-checked fields of frozen dataclasses.

One declaration serves everybody: the YAML reader checks against it, the ROS nodes declare their
parameters from it (description, unit, range), and the page of settings is made of it.

What was a setting once and is a constant now stays in its class with the reason, as
``NAME: ClassVar[Annotated[float, "why"]] = 6.0``: a file that states this value is still read.
"""

from __future__ import annotations

import dataclasses
import math
import re
import types
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass
from functools import cache, partial
from typing import Annotated, Any, ClassVar, Final, TypeVar

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.plugins import name_hint
from rotcal_ros.foundation.url_secrets import find_secrets
from rotcal_ros.foundation.url_secrets import secret_error_text as secret_found

T = TypeVar("T")

_EXPONENT = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+")
"""A number as people write it; without a point or an exponent's sign YAML 1.1 reads a text."""
_NO_TEXT = re.compile("[\0\ud800-\udfff]")
"""Characters that no message of ROS and no file in UTF-8 can hold."""
_LARGEST = 1 << 63
_hints: Callable[[Any], dict[str, Any]] = cache(typing.get_type_hints)
"""Types of the fields of a class; to find them out takes longer than to check the values."""
_ROS_NAME = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")


@dataclass(frozen=True, slots=True)
class SettingInfo:
    """What a setting means: ``description`` with the unit, and its inclusive range.

    ``first``: to measure a real table, somebody has to state it or at least look at it.
    ``expert``: it needs no change in ordinary use.
    """

    description: str
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    first: bool = False
    expert: bool = False

    @property
    def named_choices(self) -> tuple[str, ...]:
        """The choices for people; an empty one stands for none of them."""
        return tuple(filter(None, self.choices))


@dataclass(frozen=True, slots=True)
class Declaration:
    """One setting as it was declared: ``name`` is dotted below its group.

    ``kind`` is the type of a value, or of the elements of a list (``is_list``); a fixed ``length``
    of a list is None if any number will do. ``default`` is MISSING for a required setting.
    """

    name: str
    kind: type
    is_list: bool
    length: int | None
    optional: bool
    default: Any
    info: SettingInfo


@dataclass(frozen=True, slots=True)
class Constant:
    """What a setting of earlier versions always is now, and why nobody has to state it."""

    value: Any
    reason: str


def setting(
    default: Any = MISSING,
    *,
    doc: str,
    minimum: float | None = None,
    maximum: float | None = None,
    choices: Sequence[str] = (),
    first: bool = False,
    expert: bool = False,
) -> Any:
    """Declare a field of a settings dataclass.

    ``doc`` is one sentence; the unit stands before its first comma. Without a default the setting
    is required. A list setting is a tuple; its range holds for every element. The choices of a
    Literal are those of its type. ``first`` marks the few settings of a method that have to be
    stated to measure a real table: they are shown before all others. ``expert`` marks what needs
    no change in ordinary use, such as thresholds, waits and rates: it is shown on request.
    """
    metadata = {"setting": SettingInfo(doc, minimum, maximum, tuple(choices), first, expert)}
    if default is MISSING:
        return dataclasses.field(metadata=metadata, kw_only=True)
    return dataclasses.field(default=default, metadata=metadata, kw_only=True)


expert: Final = partial(setting, expert=True)
"""Declare a setting that needs no change in ordinary use."""


def group(cls: type[Any], *, expert: bool = False) -> Any:
    """Declare a nested group of settings, all with their defaults unless given.

    ``expert``: all of them are for experts.
    """
    return dataclasses.field(default_factory=cls, kw_only=True, metadata={"expert": expert})


def add_nested_groups(classes: Mapping[str, type[Any]]) -> Callable[[type[T]], type[T]]:
    """Give a settings dataclass nested groups that are known only when it is loaded, by name.

    They are for experts.
    """

    def extended(cls: type[T]) -> type[T]:
        fields = [(name, nested, group(nested, expert=True)) for name, nested in classes.items()]
        found = dataclasses.make_dataclass(cls.__name__, fields, bases=(cls,), frozen=True)
        found.__module__, found.__doc__ = cls.__module__, cls.__doc__
        return found

    return extended


def load(cls: type[T], values: Mapping[str, Any] | None, where: str) -> T:
    """Build the settings dataclass ``cls`` from a nested mapping.

    ``where`` names the place in error texts, e.g. ``demo.yaml: plan``. Raises
    ConfigurationError for unknown names (with the nearest known one), missing required
    settings, wrong types, values out of range, URLs that carry a secret, and for a constant that
    is stated with another value.
    """
    values = {} if values is None else values
    for place in find_secrets(values, where):
        raise ConfigurationError(secret_found(place))
    if not isinstance(values, Mapping):
        raise ConfigurationError(
            f"{where}: expected a group of settings, found {values!r:.80}: "
            "put its settings below it, indented, as NAME: VALUE"
        )
    hints = _hints(cls)
    fields = {f.name: f for f in dataclasses.fields(cls)}  # type: ignore[arg-type]
    if not values.keys() <= fields.keys():
        _check_others(cls, values, fields, where)
    loaded: dict[str, Any] = {}
    for name, field in fields.items():
        if name in values:
            place, hint = f"{where}.{name}", hints[name]
            if dataclasses.is_dataclass(hint):
                loaded[name] = load(typing.cast(type, hint), values[name], place)
            else:
                loaded[name] = checked_value(values[name], _declaration(field, hint), place)
        elif field.default is MISSING and field.default_factory is MISSING:
            what = "a group of settings" if dataclasses.is_dataclass(hints[name]) else ""
            what = what or field.metadata["setting"].description
            raise ConfigurationError(f"{where}: setting {name!r} is missing ({what}): add it")
    try:
        return cls(**loaded)
    except ConfigurationError as error:  # settings that do not go together
        raise ConfigurationError(f"{where}: {error}") from error


def _check_others(
    cls: type[Any], values: Mapping[str, Any], fields: Mapping[str, Any], where: str
) -> None:
    """Raise ConfigurationError unless what is no setting is a constant, with its value."""
    fixed = constants(cls)
    for name in (n for n in values if n not in fields):
        if name not in fixed:
            hint = name_hint(str(name), fields)
            raise ConfigurationError(f"{where}: unknown setting {name!r:.80}{hint}")
        _check_constant(values[name], fixed[name], f"{where}.{name}")


def settings_from_changes(
    cls: type[T], group: str, changes: Sequence[str], parsed: Callable[[str, str], Any]
) -> T:
    """Return the settings of a ``group`` with ``group.name=value`` changes and nothing else.

    Of a setting that is a text a value is that text; else ``parsed`` reads it, given the text and
    its place. Raises ConfigurationError for changes of other groups.
    """
    texts = {d.name for d in declarations(cls) if d.kind is str and not d.is_list}
    values: dict[str, Any] = {}
    for change in changes:
        place, equals, value = change.partition("=")
        first, dot, name = place.partition(".")
        if first != group or not dot or not equals:
            raise ConfigurationError(f"--set {change}: expected {group}.NAME=VALUE")
        found: Any = value if name in texts else parsed(value, f"--set {change}")
        if isinstance(found, list):
            found = [*(values.get(name) or ()), *found]  # columns of several options add up
        values[name] = found
    return load(cls, values, f"--set: {group}")


def to_mapping(settings: Any) -> dict[str, Any]:
    """Return the nested mapping that :func:`load` turns into an equal object."""
    return {
        f.name: to_mapping(value) if dataclasses.is_dataclass(value) else _plain(value)
        for f in dataclasses.fields(settings)
        for value in [getattr(settings, f.name)]
    }


def declarations(cls: type[Any], prefix: str = "") -> Iterator[Declaration]:
    """Yield every setting that ``cls`` declares, nested groups flattened."""
    hints = _hints(cls)
    for field in dataclasses.fields(cls):
        if dataclasses.is_dataclass(hints[field.name]):
            nested = declarations(hints[field.name], f"{prefix}{field.name}.")
            yield from map(_for_experts, nested) if field.metadata.get("expert") else nested
        else:
            yield _declaration(field, hints[field.name], prefix)


def constants(cls: type[Any]) -> dict[str, Constant]:
    """Return what ``cls`` declared as a setting in earlier versions, by name."""
    found = {}
    for name, hint in typing.get_type_hints(cls, include_extras=True).items():
        inner = typing.get_args(hint)[0] if typing.get_origin(hint) is ClassVar else None
        if typing.get_origin(inner) is Annotated:
            found[name] = Constant(getattr(cls, name), typing.get_args(inner)[1])
    return found


def all_constants(cls: type[Any], prefix: str = "") -> Iterator[tuple[str, Constant]]:
    """Yield (dotted name, constant) of ``cls`` and of its nested groups."""
    yield from ((f"{prefix}{name}", constant) for name, constant in constants(cls).items())
    for name, hint in _hints(cls).items():
        if dataclasses.is_dataclass(hint):
            yield from all_constants(typing.cast(type, hint), f"{prefix}{name}.")


def _check_constant(value: Any, constant: Constant, place: str) -> None:
    number = float(value) if isinstance(value, str) and _EXPONENT.fullmatch(value) else value
    if number != constant.value:
        raise ConfigurationError(
            f"{place}: {value!r:.80} is stated, but this is no longer a setting: it is always "
            f"{constant.value!r} ({constant.reason}); leave it out"
        )


def _declaration(field: dataclasses.Field[Any], hint: Any, prefix: str = "") -> Declaration:
    """Return what the field of a settings dataclass declares."""
    info: SettingInfo = field.metadata["setting"]
    optional = typing.get_origin(hint) in (types.UnionType, typing.Union)
    if optional:
        hint = next(h for h in typing.get_args(hint) if h is not types.NoneType)
    length, is_list = None, typing.get_origin(hint) is tuple
    if is_list:
        arguments = typing.get_args(hint)
        hint, length = arguments[0], None if Ellipsis in arguments else len(arguments)
    if typing.get_origin(hint) is typing.Literal:
        info = dataclasses.replace(info, choices=typing.get_args(hint))
        hint = str
    return Declaration(prefix + field.name, hint, is_list, length, optional, field.default, info)


def _for_experts(declared: Declaration) -> Declaration:
    return dataclasses.replace(declared, info=dataclasses.replace(declared.info, expert=True))


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def checked_value(value: Any, declared: Declaration, place: str) -> Any:
    """Return ``value`` as the declared type.

    Raises ConfigurationError with ``place``, what was found there and what was expected.
    """
    if declared.optional and value is None:
        return None
    if not declared.is_list:
        return _scalar(value, declared, place)
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise ConfigurationError(
            f"{place}: expected a list, found {value!r:.80}: put it in brackets, as [1, 2]"
        )
    if declared.length is None and _are_points(value):
        value = [number for point in value for number in point]
    if declared.length not in (None, len(value)):
        raise ConfigurationError(
            f"{place}: expected {declared.length} values, found {len(value)}: {value!r:.80}"
        )
    return tuple(_scalar(v, declared, f"{place}[{i}]") for i, v in enumerate(value))


def _are_points(values: Sequence[Any]) -> bool:
    """Return whether a list holds lists of one length, such as points as x, y, z."""
    lengths = {len(value) if isinstance(value, list | tuple) else None for value in values}
    return len(lengths) == 1 and None not in lengths


def _scalar(value: Any, declared: Declaration, place: str) -> Any:
    kind, info = declared.kind, declared.info
    if isinstance(value, int) and abs(value) > _LARGEST:
        raise ConfigurationError(
            f"{place}: a number of more than 64 bits ({info.description}): give a smaller one"
        )
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if kind is float and isinstance(value, str) and _EXPONENT.fullmatch(value):
        value = float(value)
    fits = isinstance(value, kind) and not (kind is int and isinstance(value, bool))
    if not fits:
        raise ConfigurationError(
            f"{place}: expected {kind.__name__} ({info.description}), found {value!r:.80}"
        )
    if kind is str and _NO_TEXT.search(value):
        raise ConfigurationError(
            f"{place}: {value!r:.60} is not valid text: it holds a NUL or an unpaired surrogate; "
            "write it again"
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
        known = info.named_choices
        hint = name_hint(str(value), known)
        raise ConfigurationError(f"{place}: {value!r:.80} is none of {', '.join(known)}{hint}")
    return value


def check_ros_name(name: str, what: str) -> str:
    """Return ``name`` if it is valid for a topic or namespace of ROS, such as ``/cell/tracer``.

    Else raise ConfigurationError with ``what`` it names.
    """
    if not _ROS_NAME.fullmatch(name):
        raise ConfigurationError(
            f"{what}: {name!r} is not a name in ROS: expected words of letters, digits and "
            "underscores that do not begin with a digit, with '/' between them"
        )
    return name
