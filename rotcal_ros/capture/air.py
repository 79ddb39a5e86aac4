"""The air that belongs to an attempt: temperature, pressure and humidity, if expected.

Which reading belongs to an attempt depends on the stamps alone, never on the time of arrival.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from rotcal_ros.capture.settings import CaptureSettings
from rotcal_ros.capture.streams import Stream
from rotcal_ros.foundation.observations import HumiditySample, PressureSample, TemperatureSample
from rotcal_ros.foundation.units import NANOSECOND

AirSample = TemperatureSample | PressureSample | HumiditySample


@dataclass(frozen=True, slots=True)
class Quantity:
    """A slow quantity: ``name`` of its stream, ``column`` that holds it in its samples."""

    name: str
    column: str

    def expected(self, settings: CaptureSettings) -> bool:
        """Return whether an observation holds this quantity and waits for it."""
        return bool(getattr(settings, f"{self.name}_expected"))


QUANTITIES: Final[Mapping[type[AirSample], Quantity]] = {
    TemperatureSample: Quantity("temperature", "temperature_c"),
    PressureSample: Quantity("pressure", "pressure_pa"),
    HumiditySample: Quantity("humidity", "humidity"),
}
"""The quantities of the air, by the class of their samples; observations have these columns."""


@dataclass(frozen=True, slots=True)
class ObservedAir:
    """The air of an observation; None: not known."""

    temperature_c: float | None = None
    pressure_pa: float | None = None
    humidity: float | None = None


@dataclass(frozen=True, slots=True)
class AwaitedQuantity:
    """A quantity whose ``stream`` has not come to ``stamp_ns`` yet."""

    quantity: Quantity
    stream: Stream
    stamp_ns: int


class AirStreams:
    """One stream of one column for each quantity, by name."""

    def __init__(self, clock_tolerance_ns: int) -> None:
        self._tolerance_ns = clock_tolerance_ns
        self.by_name = {q.name: Stream(1, clock_tolerance_ns) for q in QUANTITIES.values()}
        self._belated: Sequence[tuple[int, int]] = ()

    def reset(self, belated: Sequence[tuple[int, int]], *, follows: bool) -> None:
        """Forget the readings from before a clock was set back; the counts stay.

        Readings stamped within ``belated`` may be from before that and are left out, by their
        stamp alone, so that it does not matter when they arrive. Readings stamped by the new clock
        stay: all of them if a second stream ``follows`` the first, else those that came after the
        latest.
        """
        self._belated = belated
        for name, stream in self.by_name.items():
            stays = stream.samples() if follows else stream.take_behind()
            self.by_name[name] = anew = Stream(1, self._tolerance_ns)
            anew.counts = stream.counts
            anew.take_over([sample for sample in stays if not self._is_belated(sample[0])])

    def _is_belated(self, stamp_ns: int) -> bool:
        return any(first <= stamp_ns <= last for first, last in self._belated)

    def stage(self, sample: AirSample) -> bool:
        """Take a sample; return whether a decision may be due."""
        quantity = QUANTITIES[type(sample)]
        stream, value = self.by_name[quantity.name], getattr(sample, quantity.column)
        if value != value or abs(value) == float("inf"):
            stream.counts.received += 1
            stream.counts.non_finite += 1
            return False
        if self._is_belated(sample.stamp_ns):
            stream.counts.received += 1
            stream.counts.foreign_clock += 1
            return False
        return stream.stage(sample.stamp_ns, (value,))

    def missing(
        self, begin_ns: int, since_ns: int | None, settings: CaptureSettings
    ) -> Iterator[AwaitedQuantity]:
        """Yield what to wait for before :meth:`at` is final."""
        wanted = _wanted(begin_ns, since_ns, settings)
        for quantity in QUANTITIES.values():
            stream = self.by_name[quantity.name]
            if quantity.expected(settings) and not stream.is_complete_until(wanted):
                yield AwaitedQuantity(quantity, stream, wanted)

    def at(self, begin_ns: int, since_ns: int | None, settings: CaptureSettings) -> ObservedAir:
        """Return the air of an attempt that began at ``begin_ns``.

        Each quantity is the last reading stamped ``temperature_lag_s`` or more before the probe
        reached its target, else the first one of the calibration (from ``since_ns`` on): a choice
        that later readings do not change.
        """
        wanted = _wanted(begin_ns, since_ns, settings)
        expected = (q for q in QUANTITIES.values() if q.expected(settings))
        return ObservedAir(
            **{
                q.column: _reading(self.by_name[q.name], wanted, since_ns, settings)
                for q in expected
            }
        )


def _wanted(begin_ns: int, since_ns: int | None, settings: CaptureSettings) -> int:
    """Return the stamp at which an attempt that began at ``begin_ns`` reads the air."""
    wanted = begin_ns - round(settings.temperature_lag_s / NANOSECOND)
    return wanted if since_ns is None else max(wanted, since_ns)


def _reading(
    stream: Stream, wanted: int, since_ns: int | None, settings: CaptureSettings
) -> float | None:
    if not stream.is_complete_until(wanted):
        return None
    row = max(stream.index(wanted + 1) - 1, stream.index(since_ns or 0))
    if abs(int(stream.stamps[row]) - wanted) > round(settings.clock_tolerance_s / NANOSECOND):
        return None
    return float(stream.values[row, 0])
