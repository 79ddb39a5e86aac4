"""What can go wrong with a DME server: its numbered errors, and our own.

Source: I++ DME 1.4.3, 8.1 (severities) and 8.2 (numbers); VDMA 8722 keeps both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
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
