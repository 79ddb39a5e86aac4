"""Messages of an instrument, of whatever type, become records in SI by the common clock.

The same code reads live messages and bags. Bare numbers have no status, sequence or velocity:
these follow from the numbers themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from math import isfinite, pi, remainder
from operator import attrgetter
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.bags import names
from rotcal_ros.bags.settings import TopicSettings
from rotcal_ros.capture import messages
from rotcal_ros.capture.instruments.conventions import Conventions, NumericFields
from rotcal_ros.capture.instruments.steps import Position
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.observations import (
    HumiditySample,
    LengthStatus,
    PressureSample,
    TableSample,
    TemperatureSample,
    TracerSample,
)
from rotcal_ros.planning.table_feedback import TableSpeed

Sent = tuple[Any, int]
"""A message, and when it was sent (ns)."""
FAST: Final = (names.TRACER_LENGTH, names.JOINT_STATES)
"""Roles with many messages per second."""
_AIR: Final[Mapping[str, Callable[[int, str, float], Any]]] = {
    names.TEMPERATURE: TemperatureSample,
    names.AIR_PRESSURE: PressureSample,
    names.RELATIVE_HUMIDITY: HumiditySample,
}
_OWN: Final[Mapping[str, Callable[[Any], Any]]] = {
    names.TRACER_LENGTH: messages.tracer_sample,
    names.PROBE_POINT: messages.probe_sample,
    names.TEMPERATURE: messages.temperature_sample,
    names.AIR_PRESSURE: messages.pressure_sample,
    names.RELATIVE_HUMIDITY: messages.humidity_sample,
}


class Interpreter:
    """Reads the messages of the instruments of one cell, as ``settings`` describe them.

    ``joint`` names the table among joint states; empty: the first.
    """

    def __init__(self, settings: TopicSettings, joint: str = "") -> None:
        self.conventions, self.joint = Conventions(settings), joint
        self._plain = self.conventions.plain
        self._lengths, self._angles = BareLengths(settings), BareAngles(settings)

    def records(self, role: str, type_name: str, sent: Sequence[Sent]) -> list[Any]:
        """Return the records of messages of one topic, without those of other joints."""
        form = self.conventions.form(role, type_name)
        if form is not None and role in FAST:
            return self._fast(role, form, sent)
        records = (self.record(role, type_name, message, sent_ns) for message, sent_ns in sent)
        return [record for record in records if record is not None]

    def record(self, role: str, type_name: str, message: Any, sent_ns: int) -> Any:
        """Return the record of a message of a slow role, or of a role's own type."""
        form = self.conventions.form(role, type_name)
        if form is None:
            own = self._own(role, message)
            if own is not None and not self._plain:
                own = self.conventions.record(role, own, sent_ns)
            return self._angles.moving(own) if isinstance(own, TableSample) else own
        stamp_ns = form.stamp_ns(message, sent_ns)
        if role == names.PROBE_POINT:
            taken_ns = self.conventions.measured_at_ns(role, stamp_ns, sent_ns)
            return Position(taken_ns, self.conventions.position(form.row(message)))
        sensor = attrgetter("header.frame_id")(message) if form.stamped else ""
        return _AIR[role](stamp_ns, sensor, self.conventions.air(role, form.row(message)[0]))

    def bare(
        self, role: str, rows: Ints, stamps: Ints, sent_ns: Ints, values: Floats
    ) -> NDArray[np.void]:
        """Return the readings or the feedback of bare ``values`` (n, numbers and limits)."""
        taken = self.conventions.measured_at_ns(role, stamps, sent_ns)
        if role == names.TRACER_LENGTH:
            return self._lengths.readings(rows, taken, values)
        return self._angles.feedback(rows, taken, values)

    def completed(self, feedback: NDArray[np.void]) -> NDArray[np.void]:
        """Return feedback of a joint (n,) with velocities: :meth:`BareAngles.completed`."""
        return self._angles.completed(feedback)

    def _fast(self, role: str, form: NumericFields, sent: Sequence[Sent]) -> list[Any]:
        values = np.array([form.row(message) for message, _ in sent], np.float64)
        stamps = np.array([form.stamp_ns(*pair) for pair in sent], np.int64)
        sent_ns = np.array([time_ns for _, time_ns in sent], np.int64)
        rows = self.bare(role, np.arange(len(sent)), stamps, sent_ns, values)
        return tracer_samples(rows) if role == names.TRACER_LENGTH else table_samples(rows)

    def _own(self, role: str, message: Any) -> Any:
        if role == names.JOINT_STATES:
            return messages.table_sample(message, self.joint)
        return _OWN[role](message)


def table_samples(feedback: Iterable[Any]) -> list[Any]:
    """Return feedback (n,) as records."""
    return [TableSample(int(s), float(a), float(v)) for _, s, a, v in feedback]


READING: Final = np.dtype(
    [
        ("row", np.int64),
        ("stamp_ns", np.int64),
        ("sequence", np.int64),
        ("length", np.float64),
        ("status", np.int64),
    ]
)
FEEDBACK: Final = np.dtype(
    [("row", np.int64), ("stamp_ns", np.int64), ("angle", np.float64), ("velocity", np.float64)]
)
_WRAP: Final = 1 << 32


class BareLengths:
    """Turns bare numbers into tracer readings, numbered in the order of arrival.

    NaN, an infinite number or one outside the limits in its message means a broken beam: a type
    without a status has no other way to report it.
    """

    def __init__(self, settings: TopicSettings) -> None:
        self._unit = settings.length_m
        self._counted = 0

    def readings(self, rows: Ints, stamps: Ints, values: Floats) -> NDArray[np.void]:
        """Return the readings (n,) of ``values`` (n, 1), or (n, 3) with their limits."""
        readings = np.zeros(len(rows), READING)
        readings["row"], readings["stamp_ns"] = rows, stamps
        readings["length"] = values[:, 0] * self._unit
        readings["sequence"] = (self._counted + np.arange(len(rows))) % _WRAP
        good = np.isfinite(values[:, 0])
        if values.shape[1] > 1:
            stated = values[:, 2] > values[:, 1]  # limits left out are equal, both zero
            within = (values[:, 0] >= values[:, 1]) & (values[:, 0] <= values[:, 2])
            good &= ~stated | within
        readings["status"] = np.where(good, int(LengthStatus.OK), int(LengthStatus.BEAM_BROKEN))
        self._counted += len(rows)
        return readings


class BareAngles:
    """Turns bare angles into feedback with a velocity; jumps by full turns are no motion."""

    def __init__(self, settings: TopicSettings) -> None:
        self._unit = settings.angle_rad
        self._speed = TableSpeed(settings.angle_span_s)
        self._unwrapped: float | None = None
        self._stated = False

    def feedback(self, rows: Ints, stamps: Ints, values: Floats) -> NDArray[np.void]:
        """Return the feedback (m,), m <= n, of ``values`` (n, 1 or more).

        The first ones have no velocity yet and are left out.
        """
        return self._speeds(rows, stamps, values[:, 0] * self._unit)

    def completed(self, feedback: NDArray[np.void]) -> NDArray[np.void]:
        """Return the feedback of a joint (n,), with a velocity from its angles where it has none.

        A joint that has stated a velocity before does not know it for a while, and is left alone.
        """
        stated = self._stated | np.logical_or.accumulate(np.isfinite(feedback["velocity"]))
        self._stated |= bool(stated.any())
        bare = feedback[~stated]
        found = self._speeds(bare["row"], bare["stamp_ns"], bare["angle"])
        return np.concatenate([found, feedback[stated]])

    def moving(self, sample: TableSample) -> TableSample | None:
        """Return one feedback of a joint as :meth:`completed` does; None: it has no speed yet."""
        self._stated |= isfinite(sample.velocity)
        if self._stated:
            return sample
        moving = self._speed.feed(sample.stamp_ns, self._unwrap(sample.angle))
        return moving and replace(moving, angle=sample.angle)

    def _speeds(self, rows: Ints, stamps: Ints, angles: Floats) -> NDArray[np.void]:
        """Return angles (n,) in rad with their velocities, without the first ones."""
        found = []
        for row, stamp_ns, angle in zip(
            rows.tolist(), stamps.tolist(), angles.tolist(), strict=True
        ):
            sample = self._speed.feed(stamp_ns, self._unwrap(angle))
            if sample is not None:
                found.append((row, stamp_ns, angle, sample.velocity))
        return np.array(found, FEEDBACK)

    def _unwrap(self, angle: float) -> float:
        """Return an angle with the full turns that bring it nearest to the one before."""
        before = angle if self._unwrapped is None else self._unwrapped
        if np.isfinite(angle - before):
            self._unwrapped = before + remainder(angle - before, 2.0 * pi)
        return angle if self._unwrapped is None else self._unwrapped


def tracer_samples(readings: NDArray[np.void]) -> list[TracerSample]:
    """Return readings (n,) as records."""
    return [
        TracerSample(stamp_ns, sequence, length, 0.0, LengthStatus(status))
        for _, stamp_ns, sequence, length, status in readings.tolist()
    ]
