"""The simulated cell: orders in, samples of all instruments out, in machine time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.observations import (
    Command,
    ProbeSample,
    TableSample,
    TemperatureSample,
    TracerSample,
)
from rotcal_ros.simulation.external_table import ExternalTable
from rotcal_ros.simulation.probe import SimulatedProbe
from rotcal_ros.simulation.settings import (
    TOUCH_PROBE,
    TRACER,
    TRACKER,
    SimulationSettings,
)
from rotcal_ros.simulation.table import SimulatedTable, truth
from rotcal_ros.simulation.temperature import SimulatedTemperature
from rotcal_ros.simulation.touch_probe import SimulatedTouchProbe
from rotcal_ros.simulation.tracer import SimulatedTracer
from rotcal_ros.simulation.tracker import SimulatedTracker
from rotcal_ros.units import DEGREE, NANOSECOND

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class CellOutput:
    """What the instruments said, each stream in the order of its stamps."""

    tracer: tuple[TracerSample, ...]
    table: tuple[TableSample, ...]
    probe: tuple[ProbeSample, ...]
    temperature: tuple[TemperatureSample, ...]


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


class Machine(Protocol):
    """The machine beside the table, whatever it carries; see SimulatedProbe."""

    rest_ns: int

    @property
    def pending(self) -> Command | None:
        """The order that has not been reported yet."""

    def order(self, now_ns: int, command: Command) -> None:
        """Carry out ``command``."""

    def report(self, after_ns: int, now_ns: int, table_rest_ns: int) -> tuple[ProbeSample, ...]:
        """Return the points that fall in ``after_ns`` < t <= ``now_ns``."""

    def unasked(self, now_ns: int) -> ProbeSample:
        """Return where it believes to be, as a point of kind UNKNOWN."""


class SimulatedCell:
    """Table, machine, its instrument and temperature on one clock (ns), started at ``start_ns``.

    The cell only moves on in :meth:`advance`. The samples depend on the settings and on the
    machine times of the orders, not on how the time between them is cut into pieces.
    """

    def __init__(self, settings: SimulationSettings, start_ns: int = 0) -> None:
        self.settings, self.now_ns = settings, start_ns
        seed = settings.seed
        self._external = (
            ExternalTable(settings.table, start_ns) if settings.table.external else None
        )
        self._table = self._external or SimulatedTable(settings.table, seed, start_ns)
        self._reflector = SimulatedProbe(settings.probe, seed, start_ns)
        self._machine = self._make_machine(start_ns)
        self.has_tracer = settings.instrument == TRACER
        self._tracer = SimulatedTracer(settings.tracer, settings.faults, seed, start_ns)
        self._temperature = SimulatedTemperature(settings.temperature, seed, start_ns)
        self._tracer_ticks = Ticks(start_ns, settings.tracer.rate_hz)
        self._table_ticks = Ticks(start_ns, settings.table.feedback_rate_hz)
        self._temperature_ticks = Ticks(start_ns, settings.temperature.rate_hz)
        self._table_order: tuple[int, int] | None = None

    @property
    def busy(self) -> bool:
        """Whether something moves, settles, waits to be reported, or did a short while ago."""
        rest = max(self._table.rest_ns, self._machine.rest_ns)
        hold = round(self.settings.hold_s / NANOSECOND)
        return self._machine.pending is not None or self.now_ns < rest + hold

    def order_table(self, command: Command) -> None:
        """Turn the table to ``command.table_angle``."""
        self._table.order(self.now_ns, command.table_angle, command.approach)
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
        self._machine.order(self.now_ns, command)

    def advance(self, duration_s: float) -> CellOutput:
        """Let ``duration_s`` of machine time pass and return the samples of it."""
        before, self.now_ns = self.now_ns, self.now_ns + round(duration_s / NANOSECOND)
        first, stamps = self._table_ticks.until(self.now_ns)
        number, seconds = self._temperature_ticks.until(self.now_ns)
        return CellOutput(
            tracer=self._read_tracer(),
            table=self._table.feedback(first, stamps),
            probe=self._machine.report(before, self.now_ns, self._table_rest_ns()),
            temperature=self._temperature.readings(number, seconds),
        )

    def unasked_point(self) -> ProbeSample:
        """Return a point of kind UNKNOWN that nobody ordered: where the probe stands now."""
        return self._machine.unasked(self.now_ns)

    def truth(self, angles: Sequence[float] | Floats) -> dict[str, Floats]:
        """Return the injected deviations at ``angles`` (rad); ECC relative to the first one."""
        return dict(truth(self.settings.table, np.asarray(angles, dtype=np.float64)))

    def truth_dict(self, angles: Sequence[float] | Floats) -> dict[str, Any]:
        """Return the truth in the form of ``result.json`` (SI)."""
        return {
            "schema": 1,
            "angles_rad": [float(angle) for angle in angles],
            "deviations": {name: v.tolist() for name, v in self.truth(angles).items()},
        }

    def distances(self, stamps: Stamps) -> Floats:
        """Return the true distances (n,) from the tracer to the reflector, m."""
        rotation, translation = self._table.poses(stamps)
        station = rotation @ np.array(self.settings.tracer.mount_m) + translation
        distances: Floats = np.linalg.norm(self._reflector.positions(stamps) - station, axis=1)
        return distances

    def _make_machine(self, start_ns: int) -> Machine:
        settings, seed = self.settings, self.settings.seed
        if settings.instrument == TRACKER:
            return SimulatedTracker(settings.tracker, settings.mirror, self._table, seed, start_ns)
        if settings.instrument == TOUCH_PROBE:
            return SimulatedTouchProbe(
                settings.touch_probe, settings.plate, self._table, seed, start_ns
            )
        return self._reflector

    def _read_tracer(self) -> tuple[TracerSample, ...]:
        if not self.has_tracer:
            return ()
        first, stamps = self._tracer_ticks.until(self.now_ns)
        if not len(stamps):
            return ()
        distances = self.distances(stamps)
        drifts = self._temperature.length_change(stamps, distances)
        angles_deg = self._table.angles(stamps) / DEGREE
        broken = self._tracer.blocked(angles_deg, self._reflector.target)
        return self._tracer.readings(first, stamps, distances, drifts, broken.astype(float))

    def _table_rest_ns(self) -> int:
        """Return when the table is at rest for the probe's order; far away: not ordered yet."""
        order = self._machine.pending
        if order is not None and self._table_order == (order.step, order.attempt):
            return self._table.rest_ns
        return 1 << 62
