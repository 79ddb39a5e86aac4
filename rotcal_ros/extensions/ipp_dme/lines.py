"""The lines of I++ DME: tags, commands, responses, and how bytes become lines.

Source: I++ DME 1.4.3, 6.1.1 (characters), 6.2 (tags, layout, lengths).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum
from itertools import count
from typing import Final

from rotcal_ros.extensions.ipp_dme.faults import DmeFault, ProtocolError
from rotcal_ros.extensions.ipp_dme.grammar import Call, Word, parse_call, written

LONGEST: Final = 65_536
"""Characters of a line, its end included."""
UNASKED: Final = "E0000"
"""The tag of an unasked report of a server."""
END: Final = b"\r\n"
_TAG: Final = re.compile(r"(?!00000)\d{5}|E(?!0000)\d{4}")
_RESPONSE: Final = re.compile(r"(\d{5}|E\d{4}) ([&%#!])(?: (.*))?")


class Kind(Enum):
    """What a response line says."""

    ACCEPTED = "&"
    DONE = "%"
    DATA = "#"
    ERROR = "!"


@dataclass(frozen=True, slots=True)
class ResponseLine:
    """A line of a server; ``text`` holds its data or its error."""

    tag: str
    kind: Kind
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
    cause, text = written(fault.cause), written(fault.text)
    words = f"Error({fault.severity}, {fault.number:04d}, {cause}, {text})"
    return ResponseLine(tag, Kind.ERROR, words)


def parse_response(line: str) -> ResponseLine:
    """Return the response that a line is; ProtocolError when it is none."""
    found = _RESPONSE.fullmatch(line)
    if found is None:
        raise ProtocolError(f"the server sent a line that is not I++ DME: {line!r:.200}")
    return ResponseLine(found[1], Kind(found[2]), found[3] or "")


def is_tag(text: str) -> bool:
    """Return whether a client may begin a command with ``text``."""
    return _TAG.fullmatch(text) is not None


class Tags:
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
