"""From messages to the records of rotcal_ros.foundation.observations: which field means what.

The functions take any object whose attributes are the message's fields, made by rclpy or
decoded from a bag, so that the live path and the replay build identical records. An order comes
as two messages, one for the table and one for the probe, which :class:`OrderPairing` pairs.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from enum import IntEnum
from typing import Any, Final, TypeVar

from rotcal_ros.foundation.language import Phrase, phrase, phrase_of
from rotcal_ros.foundation.observations import (
    Approach,
    Command,
    HumiditySample,
    LengthStatus,
    Observation,
    PointKind,
    PressureSample,
    ProbeSample,
    TableSample,
    TemperatureSample,
    TracerSample,
    Turn,
)
from rotcal_ros.geometry.frames import StaticFrame

E = TypeVar("E", bound=IntEnum)
Point = tuple[float, float, float]


def stamp_ns(stamp: Any) -> int:
    """Return a builtin_interfaces/Time as integer nanoseconds."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def tracer_sample(message: Any) -> TracerSample:
    """Return a rotcal_msgs/TracerLength as record; an unfamiliar status is UNKNOWN."""
    return TracerSample(
        stamp_ns(message.header.stamp),
        message.sequence,
        message.length,
        message.length_std,
        _member(LengthStatus, message.status),
    )


def table_sample(message: Any, joint: str = "") -> TableSample | None:
    """Return the feedback of ``joint`` (empty: the first one); None if it is not there.

    Without a velocity from the drive the velocity is NaN, which the capture counts as unusable.
    """
    index = joint_index(message.name, joint)
    if index is None or index >= len(message.position):
        return None
    velocity = float(message.velocity[index]) if index < len(message.velocity) else math.nan
    return TableSample(stamp_ns(message.header.stamp), float(message.position[index]), velocity)


def joint_index(names: Iterable[str], joint: str) -> int | None:
    """Return the index of ``joint`` among ``names``; empty means the first one."""
    listed = list(names)
    if not joint:
        return 0 if listed else None
    return listed.index(joint) if joint in listed else None


def probe_sample(message: Any) -> ProbeSample:
    """Return a rotcal_msgs/ProbePoint as record; an unfamiliar kind is UNKNOWN."""
    return ProbeSample(
        stamp_ns=stamp_ns(message.header.stamp),
        sequence=message.sequence,
        step=message.step,
        attempt=message.attempt,
        kind=_member(PointKind, message.kind),
        target=message.target,
        station=message.station,
        point=message.point,
        position=_point(message.position),
        position_std=_point(message.position_std),
        tip_radius=message.tip_radius,
    )


def temperature_sample(message: Any) -> TemperatureSample:
    """Return a sensor_msgs/Temperature as record; the frame names the sensor."""
    return TemperatureSample(
        stamp_ns(message.header.stamp), message.header.frame_id, message.temperature
    )


def pressure_sample(message: Any) -> PressureSample:
    """Return a sensor_msgs/FluidPressure as record; the frame names the sensor."""
    return PressureSample(
        stamp_ns(message.header.stamp), message.header.frame_id, message.fluid_pressure
    )


def humidity_sample(message: Any) -> HumiditySample:
    """Return a sensor_msgs/RelativeHumidity as record; the frame names the sensor."""
    return HumiditySample(
        stamp_ns(message.header.stamp), message.header.frame_id, message.relative_humidity
    )


def command(table: Any, probe: Any) -> Command:
    """Return the order that the TableAngle and ProbeTarget of an attempt form together."""
    return Command(
        step=table.step,
        attempt=table.attempt,
        table_angle=table.angle,
        approach=_member(Approach, table.approach),
        kind=_member(PointKind, probe.kind),
        target=probe.target,
        position=_point(probe.position),
        station=probe.station,
        turn=_turn(table),
    )


def _turn(table: Any) -> Turn | None:
    """Return the turn of a TableAngle; bags from before there were turns have no such fields."""
    if not getattr(table, "turn_speed", 0.0):
        return None
    return Turn(float(table.turn_begin), float(table.turn_end), float(table.turn_speed))


def observation(message: Any) -> Observation:
    """Return a rotcal_msgs/Observation as record."""
    return Observation(
        step=message.step,
        attempt=message.attempt,
        table_position=message.table_index,
        table_angle=message.table_angle,
        target=message.target,
        station=message.station,
        kind=_member(PointKind, message.kind),
        mean=_floats(message.mean),
        std=_floats(message.std),
        scatter=_floats(message.scatter),
        probe_position=_point(message.probe_position),
        n_samples=message.n_samples,
        n_used=message.n_used,
        accepted=bool(message.accepted),
        reason=coded_phrase(message.reason, getattr(message, "reason_code", None)),
        table_angle_measured=message.table_angle_measured,
        temperature_c=_number(message.temperature),
        window_start_ns=stamp_ns(message.window_start),
        window_end_ns=stamp_ns(message.window_end),
        run=message.run,
        segment=message.segment,
        pressure_pa=_number(message.pressure),
        humidity=_number(message.humidity),
    )


def coded_phrase(text: str, code: Any) -> Phrase:
    """Return a text with its rotcal_msgs/TextCode; None: a bag from before there were codes."""
    return phrase(text) if code is None else phrase_of(text, code.code, code.arguments)


def static_frames(message: Any) -> tuple[StaticFrame, ...]:
    """Return the transforms of a tf2_msgs/TFMessage."""
    return tuple(
        StaticFrame(
            str(each.header.frame_id),
            str(each.child_frame_id),
            _point(getattr(each.transform.translation, axis) for axis in "xyz"),
            _quaternion(each.transform.rotation),
        )
        for each in message.transforms
    )


def _quaternion(rotation: Any) -> tuple[float, float, float, float]:
    return float(rotation.x), float(rotation.y), float(rotation.z), float(rotation.w)


def _member(kind: type[E], number: int) -> E:
    """Return a member of an enumeration; for an unfamiliar number its UNKNOWN, which is 0."""
    try:
        return kind(number)
    except ValueError:
        return kind(0)


def _number(value: float) -> float | None:
    """Return a number of a message, or None for NaN, which means that there is none."""
    return None if math.isnan(value) else value


def _floats(values: Iterable[Any]) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


def _point(values: Iterable[Any]) -> Point:
    x, y, z = values
    return float(x), float(y), float(z)


WAITING_LIMIT: Final = 64
"""Messages that may wait for their partner; beyond that the oldest is forgotten."""


class OrderPairing:
    """Pairs the messages of an order by step and attempt, whichever comes first.

    A message that is repeated before its partner comes replaces the earlier one. ``stamp_ns`` is
    the stamp of the latest order that was complete.
    """

    def __init__(self) -> None:
        self.stamp_ns = 0
        self._waiting: dict[tuple[int, int], tuple[Any, Any]] = {}

    def table_angle(self, message: Any) -> Command | None:
        """Take a rotcal_msgs/TableAngle; return the order when it is complete."""
        return self._pair(message, table=message)

    def probe_target(self, message: Any) -> Command | None:
        """Take a rotcal_msgs/ProbeTarget; return the order when it is complete."""
        return self._pair(message, probe=message)

    def clear(self) -> None:
        """Forget what waits for its partner."""
        self._waiting.clear()

    def _pair(self, message: Any, table: Any = None, probe: Any = None) -> Command | None:
        key = (message.step, message.attempt)
        earlier_table, earlier_probe = self._waiting.pop(key, (None, None))
        table = earlier_table if table is None else table
        probe = earlier_probe if probe is None else probe
        if table is not None and probe is not None:
            self.stamp_ns = max(stamp_ns(table.header.stamp), stamp_ns(probe.header.stamp))
            return command(table, probe)
        self._waiting[key] = (table, probe)
        if len(self._waiting) > WAITING_LIMIT:
            del self._waiting[next(iter(self._waiting))]
        return None
