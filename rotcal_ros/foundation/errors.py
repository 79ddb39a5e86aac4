"""The errors of rotcal: one small family.

The text of every error says what was found, where (file, station, ball, row), what was
expected, and what to do.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from rotcal_ros.foundation.escapes import printable, shortened
from rotcal_ros.foundation.url_secrets import mask_secrets

LONGEST: Final = 2000
"""Longest error in characters; a longer one loses its middle."""


@dataclass(frozen=True, slots=True)
class Question:
    """What only a person can decide: a ``setting`` and its values, each with what it would mean.

    Where a value is a unit, ``answers`` are the likely ones. ``found`` says what leaves it open,
    ``also`` are the other questions that are open whatever the answer is.
    """

    setting: str
    answers: tuple[tuple[str, str], ...]
    found: str = ""
    also: tuple[Question, ...] = ()


class RotcalError(Exception):
    """Base of all errors that rotcal raises on purpose.

    ``exit_code`` is the exit code of the command line (see docs/conventions.md).

    >>> import rotcal_ros as rc
    >>> try:
    ...     rc.read_bag("no_such_bag")
    ... except rc.RotcalError as error:
    ...     print(error.exit_code)
    2
    """

    exit_code = 2

    def __init__(self, text: str = "", log: str = "", question: Question | None = None) -> None:
        """Set ``text``; ``log`` has further lines, such as a list or what another process said.

        Whatever names from elsewhere are in it, the text is one line of visible characters, and
        without the secrets of URLs.
        ``question``: an answer to it would mend the error.
        """
        super().__init__(shortened(printable(mask_secrets(text)), LONGEST))
        self.log = mask_secrets(log)
        self.question = question


class ConfigurationError(RotcalError):
    """A configuration, set-up or parameter is missing, misspelt or out of range."""


class PlanError(RotcalError):
    """A measuring plan is impossible or does not fit the data."""


class BagError(RotcalError):
    """A bag or table cannot be read or written."""


class DataError(RotcalError):
    """The data are contradictory, implausible or too few."""

    exit_code = 3


class UndecidedError(DataError):
    """A table can be understood in several ways: nothing is done until a person says which.

    ``found`` is the text without the option that answers it.
    """

    exit_code = 2

    def __init__(
        self, found: str = "", advice: str = "", log: str = "", question: Question | None = None
    ) -> None:
        """Set what was ``found`` and the ``advice``; the rest as of RotcalError."""
        super().__init__(f"{found}: {advice}" if advice else found, log, question)
        self.found = found


class GeometryError(DataError):
    """Points do not determine the wanted plane, circle, sphere or transform."""


class ObservabilityError(DataError):
    """The geometry cannot determine what was asked for; the text names the weak direction."""


class ControllerError(RotcalError):
    """A controller does not answer, is in use, or holds something else than it should."""
