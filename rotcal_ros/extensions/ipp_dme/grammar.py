"""The words of I++ DME: calls, numbers, texts; reading and writing.

Source: I++ DME 1.4.3, 6.1.4.2. Calls may be nested (``SetProp(Tool.PtMeasPar.Speed(100))``). What
is read may come from anybody: its length is bounded by the line, its depth here.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from rotcal_ros.extensions.ipp_dme.faults import ProtocolError

DEEPEST: Final = 8
"""Calls inside calls; the specification has three."""
LARGEST: Final = 1e6
"""mm or deg that are written: together with nine places the 16 digits of a number."""
_TOKEN: Final = re.compile(
    r'"(?P<text>[^"]*)"'
    r"|(?P<number>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?)(?![\w.])"
    r"|(?P<name>[A-Za-z][A-Za-z0-9_]*(?:\.[A-Za-z][A-Za-z0-9_]*)*)"
    r"|(?P<sign>[(),])"
)


@dataclass(frozen=True, slots=True)
class Word:
    """A name that stands for itself, such as ``MachineCsy`` or the event tag ``E0553``."""

    name: str

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True)
class Call:
    """A name with arguments: a method, or a property with its value."""

    name: str
    arguments: tuple[Value, ...] = ()

    def __str__(self) -> str:
        return f"{self.name}({', '.join(map(written, self.arguments))})"

    def numbers(self) -> tuple[float, ...]:
        """Return the arguments; ProtocolError unless all of them are numbers."""
        found = tuple(a for a in self.arguments if isinstance(a, float))
        if len(found) != len(self.arguments):
            raise ProtocolError(f"expected numbers only, found {self!s:.200}")
        return found

    def number(self) -> float:
        """Return the only argument; ProtocolError unless it is one number."""
        found = self.numbers()
        if len(found) != 1:
            raise ProtocolError(f"expected one number, found {self!s:.200}")
        return found[0]


Value = float | str | Word | Call
"""A number, a text in quotes, a word, a call."""


def call(name: str, *arguments: Value) -> Call:
    """Return a call; its whole numbers may be given as integers."""
    return Call(name, tuple(float(a) if isinstance(a, int) else a for a in arguments))


def written(value: Value) -> str:
    """Return the text of a value for the wire; ProtocolError if there is none."""
    if isinstance(value, float):
        if not abs(value) <= LARGEST:
            raise ProtocolError(f"{value:g} mm or deg cannot be meant (at most {LARGEST:g})")
        text = f"{value:.9f}".rstrip("0").rstrip(".")
        return "0" if text == "-0" else text
    if isinstance(value, str):
        if not re.fullmatch(r"[ !#-~]*", value):
            raise ProtocolError(f"{value!r:.80} has characters that I++ DME does not allow")
        return f'"{value}"'
    return str(value)


def parse_call(text: str) -> Call:
    """Return the one call that ``text`` is; ProtocolError when it is anything else."""
    values = parse_values(text)
    if len(values) != 1 or not isinstance(values[0], Call):
        raise ProtocolError(f"expected one call such as GoTo(X(1)), found {text!r:.200}")
    return values[0]


def parse_values(text: str) -> tuple[Value, ...]:
    """Return the values in ``text``, between commas; one pair of parentheses may stand around."""
    reader = _Reader(text)
    values = reader.list_in_parentheses(0) if reader.next_is("(") else reader.values(0)
    reader.finish()
    return values


def calls_by_name(values: Iterable[Value]) -> dict[str, Call]:
    """Return the calls among ``values``."""
    return {value.name: value for value in values if isinstance(value, Call)}


class _Reader:
    """Reads values from a text, from left to right."""

    def __init__(self, text: str) -> None:
        self._text, self._at = text, 0

    def next_is(self, sign: str) -> bool:
        self._skip()
        return self._text.startswith(sign, self._at)

    def finish(self) -> None:
        """Raise ProtocolError unless all was read."""
        self._skip()
        if self._at < len(self._text):
            raise self._wrong("the end")

    def values(self, depth: int) -> tuple[Value, ...]:
        found = [self._value(depth)]
        while self.next_is(","):
            self._at += 1
            found.append(self._value(depth))
        return tuple(found)

    def list_in_parentheses(self, depth: int) -> tuple[Value, ...]:
        if depth >= DEEPEST:
            raise ProtocolError(f"more than {DEEPEST} calls inside each other")
        self._at += 1
        found = () if self.next_is(")") else self.values(depth + 1)
        if not self.next_is(")"):
            raise self._wrong("a comma or a closing parenthesis")
        self._at += 1
        return found

    def _value(self, depth: int) -> Value:
        self._skip()
        token = _TOKEN.match(self._text, self._at)
        if token is None or token["sign"]:
            raise self._wrong("a number, a text in quotes or a name")
        self._at = token.end()
        if token["text"] is not None:
            return token["text"]
        if token["number"] is not None:
            number = float(token["number"])
            if abs(number) == float("inf"):
                raise ProtocolError(f"the number {token['number']:.40} is too large")
            return number
        if self.next_is("("):
            return Call(token["name"], self.list_in_parentheses(depth))
        return Word(token["name"])

    def _skip(self) -> None:
        while self._text.startswith(" ", self._at):
            self._at += 1

    def _wrong(self, expected: str) -> ProtocolError:
        rest = self._text[self._at : self._at + 40]
        found = repr(rest) if rest else "the end"
        return ProtocolError(f"expected {expected} in {self._text!r:.120}, found {found}")
