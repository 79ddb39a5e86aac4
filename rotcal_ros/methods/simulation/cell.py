"""The simulated cell: orders in, samples of all instruments out, in machine time."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

from rotcal_ros.foundation.observations import (
    Command,
    HumiditySample,
    PressureSample,
    ProbeSample,
    TableSample,
    TemperatureSample,
    TracerSample,
)
from rotcal_ros.foundation.units import NANOSECOND
from rotcal_ros.methods.simulation.air import SimulatedAir, SimulatedTemperature
from rotcal_ros.methods.simulation.instrument import MakeInstrument, Table, Ticks
from rotcal_ros.methods.simulation.settings import SimulationSettings
from rotcal_ros.methods.simulation.table import ExternalTable, SimulatedTable


@dataclass(frozen=True, slots=True)
class CellOutput:
    """What the instruments sent, each stream in the order of its stamps."""

    tracer: tuple[TracerSample, ...] = ()
    table: tuple[TableSample, ...] = ()
    probe: tuple[ProbeSample, ...] = ()
    temperature: tuple[TemperatureSample, ...] = ()
    air: tuple[PressureSample | HumiditySample, ...] = ()

    def later(self, by_ns: int) -> CellOutput:
        """Return the same with all stamps later by ``by_ns``."""
        streams = {f.name: getattr(self, f.name) for f in fields(self)}
        return CellOutput(
            **{
                name: tuple(replace(s, stamp_ns=s.stamp_ns + by_ns) for s in samples)
                for name, samples in streams.items()
            }
        )


class SimulatedCell:
    """Table, machine, its instrument and temperature on one clock (ns), started at ``start_ns``.

    The cell only moves on in :meth:`advance`. The samples depend on the settings and on the
    machine times of the orders, not on how the time between them is cut into pieces.
    """

    def __init__(
        self, settings: SimulationSettings, make_instrument: MakeInstrument, start_ns: int = 0
    ) -> None:
        self.settings, self.now_ns = settings, start_ns
        seed, table = settings.noise_seed, settings.table
        self._external = ExternalTable(table, start_ns) if table.external else None
        self.table: Table = self._external or SimulatedTable(table, seed, start_ns)
        self._temperature = SimulatedTemperature(settings.temperature, seed, start_ns)
        self._air = SimulatedAir(settings.air, self._temperature, seed, start_ns)
        self.instrument = make_instrument(settings, self.table, self._temperature, start_ns)
        self._table_ticks = Ticks(start_ns, table.feedback_rate_hz)
        self._temperature_ticks = Ticks(start_ns, settings.temperature.rate_hz)
        self._table_order: tuple[int, int] | None = None

    @property
    def busy(self) -> bool:
        """Whether something moves, settles, waits to be reported, or did a short while ago."""
        rest = max(self.table.rest_ns, self.instrument.rest_ns)
        hold = round(self.settings.hold_s / NANOSECOND)
        return self.instrument.pending is not None or self.now_ns < rest + hold

    def order_table(self, command: Command) -> None:
        """Turn the table to ``command.table_angle``, or past it."""
        if command.turn is None:
            self.table.order(self.now_ns, command.table_angle, command.approach)
        else:
            self.table.turn(self.now_ns, command.turn)
        self._table_order = (command.step, command.attempt)

    def follow_table(self, stamp_ns: int, angle: float) -> CellOutput:
        """Let time pass until ``stamp_ns``, when an external table stands at ``angle`` (rad).

        Time never gets ahead of what is known about the table, however late that comes.
        """
        if self._external is None or stamp_ns <= self.now_ns:
            return self.advance(0.0)
        self._external.follow(stamp_ns, angle)
        return self.advance((stamp_ns - self.now_ns) * NANOSECOND)

    def order_probe(self, command: Command) -> None:
        """Let the machine go to ``command.position`` and report its point or points."""
        self.instrument.order(self.now_ns, command)

    def stop(self) -> None:
        """Stop the table and forget the order of the probe, as a machine does in a stop."""
        self.table.stop(self.now_ns)
        self.instrument.pending = None

    def advance(self, duration_s: float) -> CellOutput:
        """Let ``duration_s`` of machine time pass and return the samples of it."""
        before, self.now_ns = self.now_ns, self.now_ns + round(duration_s / NANOSECOND)
        first, stamps = self._table_ticks.until(self.now_ns)
        number, seconds = self._temperature_ticks.until(self.now_ns)
        order, rest_ns = self.instrument.pending, 1 << 62  # far away: the table is not ordered yet
        if order is not None and self._table_order == (order.step, order.attempt):
            rest_ns = self.table.rest_ns
        return CellOutput(
            tracer=self.instrument.lengths(self.now_ns),
            table=self.table.feedback(first, stamps),
            probe=self.instrument.report(before, self.now_ns, rest_ns),
            temperature=self._temperature.readings(number, seconds),
            air=self._air.readings(number, seconds),
        )

    def unsolicited_point(self) -> ProbeSample:
        """Return a point of kind UNKNOWN, without an order: where the probe stands now."""
        return self.instrument.unsolicited(self.now_ns)
