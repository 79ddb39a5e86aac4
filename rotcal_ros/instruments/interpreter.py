"""What an instrument says, whatever its message type: records in SI, by the common clock."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import attrgetter
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.bags import names
from rotcal_ros.bags.settings import TopicSettings
from rotcal_ros.capture import messages
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.observations import (
    HumiditySample,
    PressureSample,
    TableSample,
    TemperatureSample,
)
from rotcal_ros.instruments.conventions import Conventions
from rotcal_ros.instruments.conversion import BareAngles, BareLengths, tracer_samples
from rotcal_ros.instruments.forms import Form, form_of
from rotcal_ros.instruments.steps import Position

Sent = tuple[Any, int]
"""A message, and when it was sent (ns)."""
FAST: Final = (names.TRACER_LENGTH, names.JOINT_STATES)
"""Roles whose messages are many."""
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
    """Understands the instruments of one cell, as ``settings`` describe them.

    ``joint`` names the table among joint states; empty: the first.
    """

    def __init__(self, settings: TopicSettings, joint: str = "") -> None:
        self.conventions, self.joint = Conventions(settings), joint
        self._plain = self.conventions.plain
        self._lengths, self._angles = BareLengths(settings), BareAngles(settings)

    def records(self, role: str, type_name: str, sent: Sequence[Sent]) -> list[Any]:
        """Return the records of messages of one topic; what says nothing of use is left out."""
        form = form_of(role, type_name)
        if form is not None and role in FAST:
            return self._fast(role, form, sent)
        found = (self.record(role, type_name, message, sent_ns) for message, sent_ns in sent)
        return [record for record in found if record is not None]

    def record(self, role: str, type_name: str, message: Any, sent_ns: int) -> Any:
        """Return the record of a message of a slow role, or of any role's own type."""
        form = form_of(role, type_name)
        if form is None:
            own = self._own(role, message)
            if own is None or self._plain:
                return own
            return self.conventions.record(role, own, sent_ns)
        stamp_ns = form.stamp_ns(message, sent_ns)
        if role == names.PROBE_POINT:
            taken_ns = self.conventions.taken_ns(role, stamp_ns, sent_ns)
            return Position(taken_ns, self.conventions.position(form.row(message)))
        sensor = attrgetter("header.frame_id")(message) if form.stamped else ""
        return _AIR[role](stamp_ns, sensor, self.conventions.air(role, form.row(message)[0]))

    def bare(
        self, role: str, rows: Ints, stamps: Ints, sent_ns: Ints, values: Floats
    ) -> NDArray[np.void]:
        """Return readings or feedback of bare ``values`` (n, numbers and limits); see there."""
        taken = self.conventions.taken_ns(role, stamps, sent_ns)
        if role == names.TRACER_LENGTH:
            return self._lengths.readings(rows, taken, values)
        return self._angles.feedback(rows, taken, values)

    def _fast(self, role: str, form: Form, sent: Sequence[Sent]) -> list[Any]:
        values = np.array([form.row(message) for message, _ in sent], np.float64)
        stamps = np.array([form.stamp_ns(*pair) for pair in sent], np.int64)
        sent_ns = np.array([time_ns for _, time_ns in sent], np.int64)
        found = self.bare(role, np.arange(len(sent)), stamps, sent_ns, values)
        if role == names.TRACER_LENGTH:
            return list(tracer_samples(found))
        return table_samples(found)

    def _own(self, role: str, message: Any) -> Any:
        if role == names.JOINT_STATES:
            return messages.table_sample(message, self.joint)
        return _OWN[role](message)


def table_samples(feedback: Iterable[Any]) -> list[Any]:
    """Return feedback (n,) as records."""
    return [TableSample(int(s), float(a), float(v)) for _, s, a, v in feedback]
