"""The thread that drives an instrument: connects, reads or measures, and reconnects when lost.

A place is measured while the table stands at the ordered angle. Before its driver connects, a
check of a cell says what the plug-in provides.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from math import isfinite, isnan
from threading import Event, Thread
from typing import Final

from rotcal_ros.bags import names
from rotcal_ros.foundation.errors import ConfigurationError, RotcalError
from rotcal_ros.foundation.node_state import NodeState, State, Why
from rotcal_ros.foundation.observations import (
    Command,
    LengthStatus,
    ProbeSample,
    TableSample,
    TracerSample,
)
from rotcal_ros.foundation.plugins import INSTRUMENTS, load
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.methods.check_lines import CheckLine, DriverCheck
from rotcal_ros.nodes.instrument_driver.instrument import (
    Instrument,
    InstrumentError,
    Length,
    Make,
    Place,
    Tracer,
    Tracker,
)
from rotcal_ros.nodes.instrument_driver.settings import InstrumentSettings
from rotcal_ros.planning.table_feedback import is_near

READ_TIMEOUT_S: Final = 0.1
PATIENCE_S: Final = 10.0
"""An order may wait this long for the table before a person is told why."""


def make_instrument(settings: InstrumentSettings) -> Instrument:
    """Return the instrument that the settings name; ConfigurationError when there is none."""
    make: Make = load(INSTRUMENTS, settings.plugin, "instrument (instrument.plugin)")
    options = settings.by_name()
    try:
        instrument = make(settings.address, options)
    except RotcalError:
        raise
    except Exception as error:  # of somebody else's code
        raise ConfigurationError(
            f"instrument.plugin: {settings.plugin} cannot be made: {type(error).__name__}: "
            f"{error}; check instrument.address and instrument.options, or mend the plug-in"
        ) from error
    if not isinstance(instrument, Tracer | Tracker):
        raise ConfigurationError(
            f"instrument.plugin: {settings.plugin} makes neither a Tracer nor a Tracker: "
            "derive it from one of rotcal_ros.nodes.instrument_driver.instrument"
        )
    return instrument


@dataclass(frozen=True)
class DriverCallbacks:
    """Functions that get what the driver finds; its thread calls them."""

    length: Callable[[TracerSample], None]
    place: Callable[[ProbeSample], None]
    complain: Callable[[str], None]


READING: Final = NodeState.of(State.WORKING, Why.READING)


class InstrumentDriver:
    """Drives one instrument from :meth:`begin` to :meth:`stop`.

    ``why_not(order)`` says why a place may not be measured now (the table is not at rest), None:
    it may. ``state`` says what is being done, ``trouble`` why no readings come (None: they do),
    ``waits`` what an order waits for longer than usual, if any; ``connections`` counts.
    """

    def __init__(
        self,
        instrument: Instrument,
        settings: InstrumentSettings,
        listeners: DriverCallbacks,
        why_not: Callable[[Command], str | None] = lambda _: None,
        now_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self.state = NodeState.of(State.PREPARING, Why.STARTING)
        self.trouble: str | None = None
        self.waits: str | None = None
        self.connections = 0
        self._instrument, self._settings, self._tell = instrument, settings, listeners
        self._tracer = instrument if isinstance(instrument, Tracer) else None
        self._tracker = instrument if isinstance(instrument, Tracker) else None
        self._why_not, self._now_ns = why_not, now_ns
        self._order: Command | None = None
        self._ordered_s = 0.0
        self._lengths = self._places = 0
        self._end = Event()
        self._thread = Thread(target=self._work, name="instrument", daemon=True)

    @property
    def alive(self) -> bool:
        """Whether the thread still works."""
        return self._thread.is_alive()

    def begin(self) -> None:
        """Connect, and measure from now on."""
        self._thread.start()

    def stop(self) -> None:
        """End after the present reading or measurement, and release the instrument."""
        self._end.set()

    def order(self, command: Command) -> None:
        """Measure the place of ``command`` as soon as possible; it replaces a waiting order."""
        self._order, self._ordered_s = command, time.monotonic()

    def forget(self) -> None:
        """Drop the order that waits."""
        self._order = None

    def _work(self) -> None:
        """Begin anew after every error, for as long as it takes: instruments come back."""
        while not self._end.is_set():
            try:
                self.state = NodeState.of(State.PREPARING, Why.CONNECTING)
                self._instrument.connect()
                self.connections += 1
                self.state, self.trouble = READING, None
                self._serve()
            except Exception as error:  # whatever a foreign plug-in does, people hear of it
                self._note(error)
            with suppress(Exception):
                self._instrument.close()
            self._end.wait(self._settings.reconnect_s)
        self.state = NodeState.of(State.WAITING, Why.CLOSED)

    def _note(self, error: Exception) -> None:
        """Report what went wrong, once for each kind; later readings begin at another zero."""
        known = isinstance(error, InstrumentError | OSError)
        words = str(error) if known else f"error of the plug-in: {type(error).__name__}: {error}"
        text = f"instrument {self._settings.plugin} at {self._settings.address}: {words}"
        if text != self.trouble:
            self._tell.complain(f"{text}; tried again every {self._settings.reconnect_s:g} s")
        if self.state == READING and self._tracer is not None:
            self._pass_on(Length(0.0, valid=False))
        self.state, self.trouble = NodeState.of(State.FAILED, Why.CONNECTION_LOST), text

    def _serve(self) -> None:
        heard_s = time.monotonic()
        while not self._end.is_set():
            before_s = time.monotonic()
            self._measure()
            heard_s += time.monotonic() - before_s  # nothing was read meanwhile: no silence
            if self._tracer is None:
                self._end.wait(READ_TIMEOUT_S / 10)
                continue
            readings = self._tracer.read(READ_TIMEOUT_S)
            for reading in readings:
                self._pass_on(reading)
            now_s = time.monotonic()
            heard_s = now_s if readings else heard_s
            if now_s - heard_s > self._settings.silence_s:
                raise InstrumentError(
                    f"no reading for {self._settings.silence_s:g} s: make sure that the "
                    "instrument measures, or raise instrument.silence_s"
                )

    def _pass_on(self, reading: Length) -> None:
        whole = reading.valid and isfinite(reading.length)
        status = LengthStatus.OK if reading.stable else LengthStatus.UNSTABLE
        self._tell.length(
            TracerSample(
                stamp_ns=self._now_ns() if reading.stamp_ns is None else reading.stamp_ns,
                sequence=self._lengths,
                length=reading.length if whole else 0.0,
                length_std=reading.std,
                status=status if whole else LengthStatus.BEAM_BROKEN,
            )
        )
        self._lengths += 1

    def _measure(self) -> None:
        """Measure the ordered place, if allowed.

        A missing reflector is reported and ends nothing.
        """
        order = self._order
        why = None if order is None else self._why_not(order)
        late = time.monotonic() - self._ordered_s > PATIENCE_S
        waits = f"step {order.step} is not measured: {why}" if order and why else None
        self.waits = waits if late else None
        if order is None or why is not None or self._tracker is None:
            return
        self._order = None
        try:
            place = self._tracker.measure(order.position, self._settings.measure_timeout_s)
        except InstrumentError as error:
            self._tell.complain(f"step {order.step}, attempt {order.attempt}: {error}")
            return
        self._tell.place(self._sample(order, place))

    def _sample(self, order: Command, place: Place) -> ProbeSample:
        self._places += 1
        stamp_ns = self._now_ns() if place.stamp_ns is None else place.stamp_ns
        return order.answered(stamp_ns, self._places - 1, place.position, place.std)


class TableRestDetector:
    """Hears the feedback; the table is at rest after ``settle_s`` in position and slow enough.

    ``tolerance_arcsec`` and ``speed_deg_s`` are those of the capture, which checks again.
    """

    def __init__(self, tolerance_arcsec: float, speed_deg_s: float, settle_s: float) -> None:
        self._tolerance = tolerance_arcsec * ARCSEC
        self._speed = speed_deg_s * DEGREE
        self._settle_ns = round(settle_s * 1e9)
        self._since: TableSample | None = None
        self._latest: TableSample | None = None

    def receive(self, sample: TableSample) -> None:
        """Take a feedback."""
        rests = abs(sample.velocity) <= self._speed
        if not rests or self._since is None or self._off(sample, self._since.angle):
            self._since = sample if rests else None
        self._latest = sample

    def forget(self) -> None:
        """Forget everything: another feedback begins."""
        self._since = self._latest = None

    def why_not(self, order: Command) -> str | None:
        """Return why the table does not rest where ``order`` sent it; None: it does."""
        since, latest = self._since, self._latest
        if latest is None:
            return "no feedback of the table has come"
        if isnan(latest.velocity):
            return "the feedback reports no velocity"
        if since is None:
            return "the table moves"
        if self._off(latest, order.table_angle):
            here, there = latest.angle / DEGREE, order.table_angle / DEGREE
            return f"the table rests at {here:.4f}° and is ordered to {there:.4f}°"
        settled = latest.stamp_ns - since.stamp_ns >= self._settle_ns
        return None if settled else "the table has just come to rest"

    def _off(self, sample: TableSample, angle: float) -> bool:
        return not is_near(sample.angle, angle, self._tolerance)


def provided_roles(settings: InstrumentSettings) -> tuple[str, ...]:
    """Return what the plug-in provides; nothing where it cannot be made, which its line says."""
    try:
        instrument = make_instrument(settings)
    except RotcalError:
        return ()
    lengths = (names.TRACER_LENGTH,) if isinstance(instrument, Tracer) else ()
    places = (names.PROBE_POINT, names.PROBE_TARGET) if isinstance(instrument, Tracker) else ()
    return lengths + places


def check_line(settings: InstrumentSettings, here: bool, _simulated: bool) -> CheckLine:
    """Return a line on the plug-in; only its driver may connect, since that may move something."""
    title = f"plug-in {settings.plugin}, {settings.address or 'no address'}"
    if here:
        found = f"{title}: node instrument_driver is here"
        return CheckLine("instrument", "plug-in", "note", found)
    try:
        instrument = make_instrument(settings)
    except RotcalError as error:
        todo = "group instrument of the configuration; rotcal settings instrument"
        return CheckLine("instrument", "plug-in", "missing", str(error), todo)
    does = {Tracer: "measures lengths", Tracker: "finds reflectors"}
    found = " and ".join(words for kind, words in does.items() if isinstance(instrument, kind))
    todo = "rotcal run will show whether it answers"
    return CheckLine("instrument", "plug-in", "open", f"{title}: {found}", todo)


CHECK = DriverCheck(provided_roles, check_line)
