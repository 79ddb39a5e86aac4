"""The machine beside a simulated table, with the instrument of a method."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Stamps
from rotcal_ros.foundation.errors import ControllerError
from rotcal_ros.foundation.observations import (
    Approach,
    Command,
    PointKind,
    ProbeSample,
    TracerSample,
)
from rotcal_ros.foundation.units import ARCSEC, NANOSECOND
from rotcal_ros.methods.simulation.air import SimulatedTemperature
from rotcal_ros.methods.simulation.noise import IndexedNoise
from rotcal_ros.methods.simulation.settings import AngleReaderSettings
from rotcal_ros.methods.simulation.table import ExternalTable, SimulatedTable

Table = SimulatedTable | ExternalTable
_NO_ORDER: Final = Command(0, 0, 0.0, Approach.UNKNOWN, PointKind.UNKNOWN, 0, (0.0, 0.0, 0.0))


class SimulatedInstrument(ABC):
    """The machine beside the table with what it carries, on the cell's clock (ns).

    ``frame`` is that of its points, ``streams_lengths`` says whether it delivers lengths besides.
    ``rest_ns`` is when the last ordered motion ends, ``pending`` the order that has not been
    reported yet. Reading k of a run depends on k and on the table, never on how time was cut.
    """

    frame = "machine"
    streams_lengths = False

    def __init__(self, start_ns: int) -> None:
        self.rest_ns = start_ns
        self.pending: Command | None = None
        self._sequence = 0

    @abstractmethod
    def order(self, now_ns: int, command: Command) -> None:
        """Carry out ``command``."""

    @abstractmethod
    def report(self, after_ns: int, now_ns: int, table_rest_ns: int) -> tuple[ProbeSample, ...]:
        """Return the points that fall in ``after_ns`` < t <= ``now_ns``."""

    def go(self, now_ns: int, place: Floats) -> bool:
        """Move in a straight line to ``place`` (3,), m; False: something stands in the way.

        Raises ControllerError where the instrument goes nowhere by itself.
        """
        raise ControllerError(f"{type(self).__name__} is not moved point by point")

    def touched(
        self, stamp_ns: int, surface: Floats, direction: Floats, search: tuple[float, float]
    ) -> Floats | None:
        """Return the centre (3,) of the tip that meets a surface on its way; None: it meets none.

        The tip comes against ``direction`` (3,), by which ``surface`` (3,) is left, from
        ``search[0]`` before the surface to ``search[1]`` behind it, m. Raises ControllerError
        where the instrument touches nothing.
        """
        raise ControllerError(f"{type(self).__name__} touches nothing")

    def positions(self, stamps: Stamps) -> Floats:
        """Return where it believes to be (n, 3), m: by itself the origin of its frame."""
        return np.zeros((len(stamps), 3))

    def unsolicited(self, now_ns: int) -> ProbeSample:
        """Return where it believes to be, as a point of kind UNKNOWN."""
        return self.point(now_ns, _NO_ORDER, self.positions(np.array([now_ns]))[0], 0.0)

    def lengths(self, now_ns: int) -> tuple[TracerSample, ...]:
        """Return the lengths since the call before; an instrument for points has none."""
        return ()

    def point(
        self,
        stamp_ns: int,
        order: Command,
        position: Floats,
        std: Floats | float,
        number: int = 0,
        tip_radius: float = 0.0,
    ) -> ProbeSample:
        """Return point ``number`` of an order: ``position`` (3,) with its deviation, m."""
        x, y, z = position.tolist()
        sx, sy, sz = np.broadcast_to(std, 3).tolist()
        self._sequence += 1
        return order.answered(
            stamp_ns, self._sequence - 1, (x, y, z), (sx, sy, sz), number, tip_radius
        )


class Series(NamedTuple):
    """How many readings answer an order, after which settling, and how long each takes."""

    n_readings: int
    settling_ns: int
    each_ns: int


class SeriesInstrument(SimulatedInstrument):
    """An instrument that answers every order with a series of readings, with the table at rest.

    One that stays where it is has nothing more to do to be ordered.
    """

    def __init__(self, start_ns: int) -> None:
        super().__init__(start_ns)
        self._answered = 0

    @abstractmethod
    def series(self, order: Command) -> Series:
        """Return how many readings an order asks for, and when."""

    @abstractmethod
    def reading(self, stamp_ns: int, order: Command, number: int) -> ProbeSample:
        """Return reading ``number`` of an order."""

    def order(self, now_ns: int, command: Command) -> None:
        """Begin to answer ``command``."""
        self.pending, self.rest_ns, self._answered = command, now_ns, 0

    def report(self, after_ns: int, now_ns: int, table_rest_ns: int) -> tuple[ProbeSample, ...]:
        """Return the points of the pending order that fall in ``after_ns`` < t <= ``now_ns``."""
        order, samples = self.pending, list[ProbeSample]()
        if order is None:
            return ()
        count, settling_ns, each_ns = self.series(order)
        ready_ns = max(self.rest_ns, table_rest_ns) + settling_ns
        for number in range(self._answered, count):
            stamp = max(ready_ns + (number + 1) * each_ns, after_ns + 1 + len(samples))
            if stamp > now_ns:
                break
            samples.append(self.reading(stamp, order, number))
        self._answered += len(samples)
        if self._answered == count:
            self.pending = None
        return tuple(samples)


class AngleReader(SeriesInstrument):
    """Stays where it is and reads one or two small angles, with noise, as far as it can.

    ``seed``: the ``noise_seed`` of the cell's settings; ``source``: its own stream of random
    numbers, see :class:`~.noise.NoiseSource`.
    """

    def __init__(self, own: AngleReaderSettings, seed: int, source: int, start_ns: int) -> None:
        super().__init__(start_ns)
        self.own, self._noise, self._read = own, IndexedNoise(seed, source), 0

    @abstractmethod
    def true_reading(self, stamp_ns: int, order: Command) -> Floats:
        """Return the true angles (2,), rad, without noise; the second is 0 where there is one."""

    def series(self, _order: Command) -> Series:
        """Return how often and how fast it reads."""
        settling_ns, each_ns = (
            round(time_s / NANOSECOND)
            for time_s in (self.own.settling_time_s, self.own.reading_time_s)
        )
        return Series(self.own.readings, settling_ns, each_ns)

    def reading(self, stamp_ns: int, order: Command, number: int) -> ProbeSample:
        """Return what it reads; beyond its range that is no number."""
        std = self.own.noise_arcsec * ARCSEC * np.array([1.0, 1.0, 0.0])
        noise = self.own.noise_arcsec * ARCSEC * self._noise.normal(2 * self._read, 2)
        self._read += 1
        seen = self.true_reading(stamp_ns, order)
        beyond = np.abs(seen).max() > self.own.range_arcsec * ARCSEC
        read = np.append(np.where(beyond, np.nan, seen) + noise, 0.0)
        return self.point(stamp_ns, order, read, std, number)


MakeInstrument = Callable[[Any, Table, SimulatedTemperature, int], SimulatedInstrument]
"""Makes the instrument of a method by its settings, beside a table, from ``start_ns`` on."""


class Ticks:
    """The stamps of a stream at a fixed rate, counted from the start."""

    def __init__(self, start_ns: int, rate_hz: float) -> None:
        self._start_ns, self._period_ns = start_ns, max(1, round(1.0 / (rate_hz * NANOSECOND)))
        self._next = 0

    def until(self, now_ns: int) -> tuple[int, Stamps]:
        """Return the number of the next tick and the stamps of all ticks up to ``now_ns``."""
        first = self._next
        self._next = max(first, (now_ns - self._start_ns) // self._period_ns + 1)
        numbers = np.arange(first, self._next, dtype=np.int64)
        return first, self._start_ns + numbers * self._period_ns
