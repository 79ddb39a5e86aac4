"""I++ DME on the wire: errors by number, calls with their values, lines with their tags.

Source: I++ DME 1.4.3, which VDMA 8722 keeps: severities 8.1, numbers of errors 8.2, calls 6.1.4.2,
characters 6.1.1, tags, layout and lengths 6.2. Calls may be nested
(``SetProp(Tool.PtMeasPar.Speed(100))``). What is read may come from anybody: its length is bounded
by the line, its depth here.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum, IntEnum
from itertools import count
from typing import Final

from rotcal_ros.foundation.errors import RotcalError


class Severity(IntEnum):
    """How bad an error is; from ERROR on the server obeys nothing until ClearAllErrors()."""

    INFO = 0
    WARNING = 1
    ERROR = 2
    USER = 3
    FATAL = 9


KNOWN: Final[Mapping[int, tuple[Severity, str]]] = {
    1: (Severity.ERROR, "Illegal tag"),
    2: (Severity.ERROR, "No space at pos. 6"),
    6: (Severity.ERROR, "Transaction aborted (Use ClearAllErrors To Continue)"),
    7: (Severity.USER, "Illegal character"),
    8: (Severity.USER, "Protocol error"),
    500: (Severity.USER, "Emergency stop"),
    501: (Severity.USER, "Unsupported command"),
    502: (Severity.USER, "Incorrect arguments"),
    503: (Severity.FATAL, "Controller communications failure"),
    504: (Severity.WARNING, "Argument out of range"),
    505: (Severity.USER, "Argument not recognized"),
    506: (Severity.USER, "Argument not supported"),
    507: (Severity.USER, "Illegal command"),
    508: (Severity.USER, "Bad context"),
    509: (Severity.USER, "Bad argument"),
    510: (Severity.USER, "Bad property"),
    511: (Severity.USER, "Error processing method"),
    512: (Severity.WARNING, "No daemons are active"),
    513: (Severity.ERROR, "Daemon does not exist"),
    514: (Severity.ERROR, "Use ClearAllErrors to continue"),
    515: (Severity.ERROR, "Daemon already exists"),
    1000: (Severity.USER, "Machine in error state"),
    1001: (Severity.ERROR, "Illegal touch"),
    1002: (Severity.FATAL, "Axis does not exist"),
    1003: (Severity.ERROR, "No touch"),
    1005: (Severity.USER, "Error during home"),
    1006: (Severity.ERROR, "Surface not found"),
    1008: (Severity.USER, "Target position out of machine volume"),
    1009: (Severity.USER, "Air pressure out of range"),
    1010: (Severity.ERROR, "Vector has no norm"),
    1011: (Severity.ERROR, "Unable to move"),
    1500: (Severity.USER, "Failed to re-seat head"),
    1501: (Severity.USER, "Probe not armed"),
    1502: (Severity.USER, "Tool not found"),
    1503: (Severity.USER, "Tool not defined"),
    2000: (Severity.USER, "Tool not calibrated"),
    2001: (Severity.ERROR, "Head error excessive force"),
    2002: (Severity.USER, "Type of probe does not allow this operation"),
    2500: (Severity.USER, "Machine limit encountered [Move Out Of Limits]"),
    2501: (Severity.USER, "Axis not active"),
    2502: (Severity.USER, "Axis position error"),
    2503: (Severity.FATAL, "Scale read head failure"),
    2504: (Severity.USER, "Collision"),
    2505: (Severity.ERROR, "Specified angle out of range"),
    2506: (Severity.ERROR, "Part not aligned"),
}
"""Errors that the specification numbers: severity unless the server says another one, and text."""


@dataclass(frozen=True, slots=True)
class DmeFault:
    """An error as a server reports it: ``cause`` is the method that found it."""

    severity: int
    number: int
    cause: str
    text: str

    @classmethod
    def known(cls, number: int, cause: str) -> DmeFault:
        """Return the error of the specification with this number."""
        severity, text = KNOWN[number]
        return cls(int(severity), number, cause, text)

    @property
    def stops(self) -> bool:
        """Whether the server obeys nothing until somebody clears its errors."""
        return self.severity >= Severity.ERROR

    def __str__(self) -> str:
        return f"error {self.number:04d} of {self.cause}, severity {self.severity}: {self.text}"


class DmeError(RotcalError):
    """A DME server cannot be used; the text names the command."""


class RefusedError(DmeError):
    """The server answered a command with errors: ``faults``, at least one of which stops it."""

    def __init__(self, text: str, faults: tuple[DmeFault, ...]) -> None:
        super().__init__(text)
        self.faults = faults


class AnswerMissingError(DmeError):
    """A command was not answered in time."""


class ConnectionLostError(DmeError):
    """There is no connection (any more)."""


class ProtocolError(DmeError):
    """The received data are not I++ DME."""


class NotClearedError(DmeError):
    """Something went wrong before, and no person has cleared it yet."""


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
    """A name that represents itself, such as ``MachineCsy`` or the event tag ``E0553``."""

    name: str

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True)
class Call:
    """A name with arguments: a method, or a property with its value."""

    name: str
    arguments: tuple[Value, ...] = ()

    def __str__(self) -> str:
        return f"{self.name}({', '.join(map(format_value, self.arguments))})"

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


def make_call(name: str, *arguments: Value) -> Call:
    """Return a call; its whole numbers may be given as integers."""
    return Call(name, tuple(float(a) if isinstance(a, int) else a for a in arguments))


def format_value(value: Value) -> str:
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


LONGEST: Final = 65_536
"""Characters of a line, its end included."""
UNASKED: Final = "E0000"
"""The tag of an unasked report of a server."""
END: Final = b"\r\n"
_TAG: Final = re.compile(r"(?!00000)\d{5}|E(?!0000)\d{4}")
_RESPONSE: Final = re.compile(r"(\d{5}|E\d{4}) ([&%#!])(?: (.*))?")


class ResponseKind(Enum):
    """What a response line says."""

    ACCEPTED = "&"
    DONE = "%"
    DATA = "#"
    ERROR = "!"


@dataclass(frozen=True, slots=True)
class ResponseLine:
    """A line of a server; ``text`` holds its data or its error."""

    tag: str
    kind: ResponseKind
    text: str = ""

    def __str__(self) -> str:
        return f"{self.tag} {self.kind.value}" + (f" {self.text}" if self.text else "")

    def fault(self) -> DmeFault:
        """Return the error of an ERROR line; ProtocolError when it is none."""
        found = parse_call(self.text)
        match found.arguments:
            case (float(severity), float(number), Word() | Call() | str() as cause, str(text)):
                where = cause if isinstance(cause, str) else str(cause)
                return DmeFault(int(severity), int(number), where, text)
        raise ProtocolError(
            f"expected Error(severity, number, cause, text), found {self.text!r:.200}"
        )


@dataclass(frozen=True, slots=True)
class CommandLine:
    """A line of a client."""

    tag: str
    call: Call

    def __str__(self) -> str:
        return f"{self.tag} {self.call}"


def error_line(tag: str, fault: DmeFault) -> ResponseLine:
    """Return the line that reports ``fault``."""
    cause, text = format_value(fault.cause), format_value(fault.text)
    words = f"Error({fault.severity}, {fault.number:04d}, {cause}, {text})"
    return ResponseLine(tag, ResponseKind.ERROR, words)


def parse_response(line: str) -> ResponseLine:
    """Return the response that a line is; ProtocolError when it is none."""
    found = _RESPONSE.fullmatch(line)
    if found is None:
        raise ProtocolError(
            f"the server sent a line that is not I++ DME: {line!r:.200}; check dme.port"
        )
    return ResponseLine(found[1], ResponseKind(found[2]), found[3] or "")


def is_tag(text: str) -> bool:
    """Return whether a client may begin a command with ``text``."""
    return _TAG.fullmatch(text) is not None


class TagCounter:
    """Tags for commands and for events, each counting up and beginning again."""

    def __init__(self) -> None:
        self._commands, self._events = count(), count()

    def command(self) -> str:
        """Return the next of 00001 to 99999."""
        return f"{next(self._commands) % 99_999 + 1:05d}"

    def event(self) -> str:
        """Return the next of E0001 to E9999."""
        return f"E{next(self._events) % 9_999 + 1:04d}"


class LineBuffer:
    """Cuts a stream of bytes into lines; what is not a whole line yet stays in ``rest``."""

    def __init__(self) -> None:
        self.rest = b""

    def feed(self, received: bytes) -> list[str]:
        """Return the lines that are complete now, without their ends.

        Raises ProtocolError for a line that is too long or has other characters than ASCII
        32 to 126.
        """
        *lines, self.rest = (self.rest + received).split(END)
        longest = max((len(line) for line in (*lines, self.rest)), default=0)
        if longest + len(END) > LONGEST:
            raise ProtocolError(f"a line is longer than {LONGEST} characters")
        return [_ascii(line) for line in lines]


def _ascii(line: bytes) -> str:
    if not re.fullmatch(rb"[ -~]*", line):
        raise ProtocolError(f"a line has characters that I++ DME does not allow: {line!r:.120}")
    return line.decode("ascii")
