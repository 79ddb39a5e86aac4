"""Frozen dataclasses from plain data of a file, every value checked against its type.

It is for files that we have written and read again: they may have been cut, edited or exchanged.
Settings that people write are a matter of :mod:`rotcal_ros.foundation.settings`.
"""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Mapping
from enum import Enum
from functools import cache
from typing import Any, Final, TypeVar

from rotcal_ros.foundation.language import Phrase, phrase

T = TypeVar("T")

_LARGEST: Final = 1 << 63
"""Whole numbers fit into 64 bits everywhere."""


def record(kind: type[T], data: Any, where: str = "") -> T:
    """Return ``data`` as an object of the dataclass ``kind``.

    Lists become tuples; numbers that need not be whole become floats. Raises ValueError, with the
    place below ``where``, for a missing or unknown entry and for a value of another type.

    >>> from rotcal_ros.foundation.results import Rejection
    >>> record(Rejection, {"index": 3, "why": "slipped"})
    Rejection(index=3, why='slipped')
    >>> record(Rejection, {"index": "3", "why": "slipped"}, "rejected[0]")
    Traceback (most recent call last):
    ...
    ValueError: rejected[0].index: expected int, found '3'
    """
    if not isinstance(data, Mapping):
        raise _unexpected(where, "a group of entries", data)
    fields, hints = _declared(typing.cast(Any, kind))
    unknown = [name for name in data if name not in fields]
    if unknown:
        raise ValueError(f"{_place(where, unknown[0])}: there is no such entry")
    values = {name: _value(hints[name], v, _place(where, name)) for name, v in data.items()}
    for name, required in fields.items():
        if required and name not in values:
            raise ValueError(f"{_place(where, name)}: the entry is missing")
    return kind(**values)


@cache
def _declared(kind: type[Any]) -> tuple[dict[str, bool], dict[str, Any]]:
    """Return the fields, whether they have to be given, and their types."""
    missing = dataclasses.MISSING
    fields = {
        field.name: field.default is missing and field.default_factory is missing
        for field in dataclasses.fields(kind)
        if field.init
    }
    return fields, typing.get_type_hints(kind)


def _value(hint: Any, value: Any, where: str) -> Any:
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if hint is Any:
        return value
    if origin in (types.UnionType, typing.Union):
        return _optional(arguments, value, where)
    if origin is typing.Literal:
        return _one_of(arguments, value, where)
    if origin is tuple:
        return _values(arguments, value, where)
    if origin is Mapping:
        if not isinstance(value, Mapping):
            raise _unexpected(where, "a group of entries", value)
        return {key: _value(arguments[1], v, _place(where, key)) for key, v in value.items()}
    return _plain(hint, value, where)


def _plain(kind: type, value: Any, where: str) -> Any:
    """Return a value whose type has no arguments."""
    if dataclasses.is_dataclass(kind):
        return value if isinstance(value, kind) else record(kind, value, where)
    if kind is Phrase:
        return phrase(_scalar(str, value, where))
    if issubclass(kind, Enum):
        if not isinstance(value, bool) and any(value == member.value for member in kind):
            return kind(value)
        raise _unexpected(where, " or ".join(str(member.value) for member in kind), value)
    return _scalar(kind, value, where)


def _optional(arguments: tuple[Any, ...], value: Any, where: str) -> Any:
    if value is None and types.NoneType in arguments:
        return None
    (kind,) = (argument for argument in arguments if argument is not types.NoneType)
    return _value(kind, value, where)


def _one_of(words: tuple[Any, ...], value: Any, where: str) -> Any:
    if isinstance(value, str) and value in words:
        return value
    raise _unexpected(where, " or ".join(map(repr, words)), value)


def _values(arguments: tuple[Any, ...], value: Any, where: str) -> tuple[Any, ...]:
    if not isinstance(value, list | tuple):
        raise _unexpected(where, "a list", value)
    if Ellipsis in arguments:
        arguments = (arguments[0],) * len(value)
    if len(arguments) != len(value):
        raise _unexpected(where, f"{len(arguments)} values", value)
    pairs = enumerate(zip(arguments, value, strict=True))
    return tuple(_value(hint, inner, f"{where}[{i}]") for i, (hint, inner) in pairs)


def _scalar(kind: type, value: Any, where: str) -> Any:
    whole = isinstance(value, int) and not isinstance(value, bool)
    if whole and abs(value) > _LARGEST:
        raise _unexpected(where, "a number of at most 64 bits", value)
    if kind is float and whole:
        return float(value)
    if not isinstance(value, kind) or (kind is int and not whole):
        raise _unexpected(where, kind.__name__, value)
    return value


def _place(where: str, name: Any) -> str:
    return f"{where}.{name}" if where else str(name)


def _unexpected(where: str, expected: str, value: Any) -> ValueError:
    shown = (
        "a whole number" if isinstance(value, int) and abs(value) > _LARGEST else f"{value!r:.60}"
    )
    return ValueError(f"{where or 'the whole'}: expected {expected}, found {shown}")
