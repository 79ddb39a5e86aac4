"""What a tracer or tracker of another package has to do, whatever protocol it speaks.

An entry point of the group ``rotcal_ros.instruments`` names a function that makes one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from rotcal_ros.foundation.errors import RotcalError
from rotcal_ros.planning.plan import Point


class InstrumentError(RotcalError):
    """An instrument cannot be reached, is lost, or cannot measure; the text is for people."""


@dataclass(frozen=True, slots=True)
class Length:
    """One reading of a tracer, m, longer the farther the reflector is; any constant zero.

    ``std`` is its standard deviation, 0: unknown. ``valid`` is false while the beam is broken, and
    for the first reading after a loss of the zero: later lengths count from another one.
    ``stable`` is false for a reading that is not to be used, while the zero holds. ``stamp_ns`` is
    when it was true, in ns since 1970; None: when it was read.
    """

    length: float
    std: float = 0.0
    valid: bool = True
    stamp_ns: int | None = None
    stable: bool = True


@dataclass(frozen=True, slots=True)
class Place:
    """One measured place x y z, m, with standard deviations (0: unknown); stamp as for a Length.

    It is in the frame of the instrument, which is right-handed.
    """

    position: Point
    std: Point = (0.0, 0.0, 0.0)
    stamp_ns: int | None = None


class Instrument(ABC):
    """A connection to one instrument; one thread calls all of it.

    It implements :class:`Tracer`, :class:`Tracker`, or both, for what it measures. A
    connection that is lost raises OSError from whatever is called, or InstrumentError from all but
    :meth:`Tracker.measure`; then :meth:`close` and, after a while, :meth:`connect` follow.
    """

    @abstractmethod
    def connect(self) -> None:
        """Connect and make ready to measure; InstrumentError says what a person has to do."""

    @abstractmethod
    def close(self) -> None:
        """Close the connection, if there is one; called after every error too."""


class Tracer(Instrument):
    """An instrument that measures lengths."""

    @abstractmethod
    def read(self, timeout_s: float) -> Sequence[Length]:
        """Return the lengths that came since the last call, oldest first, or wait for one.

        None within ``timeout_s`` is an empty sequence. A slow or single-shot instrument takes
        one reading here.
        """


class Tracker(Instrument):
    """An instrument that finds where a reflector is."""

    @abstractmethod
    def measure(self, near: Point, timeout_s: float) -> Place:
        """Measure the reflector ``near`` a nominal place (m, machine frame), once.

        Raises InstrumentError if there is none, which ends the attempt, not the connection.
        """


Make = Callable[[str, Mapping[str, str]], Instrument]
"""The function that an entry point names: makes an instrument from address and options.

It does not connect yet; ConfigurationError for settings that it cannot use."""
