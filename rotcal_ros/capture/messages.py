"""From messages to the records of rotcal_ros.foundation.observations: which field means what.

The functions take any object whose attributes are the message's fields, be it made by rclpy
or decoded from a bag, so that the live path and the replay build identical records.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from enum import IntEnum
from typing import Any, TypeVar

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
)
from rotcal_ros.geometry.frames import StaticFrame

E = TypeVar("E", bound=IntEnum)
Point = tuple[float, float, float]


def stamp_ns(stamp: Any) -> int:
    """Return a builtin_interfaces/Time as integer nanoseconds."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def tracer_sample(message: Any) -> TracerSample:
    """Return a rotcal_msgs/TracerLength as record; an unheard-of status is UNKNOWN."""
    return TracerSample(
        stamp_ns(message.header.stamp),
        message.sequence,
        message.length,
        message.length_std,
        _known(LengthStatus, message.status),
    )


def table_sample(message: Any, joint: str = "") -> TableSample | None:
    """Return the feedback of ``joint`` (empty: the first one); None when it is not there.

    A drive that tells no velocity gives NaN, which the capture counts as not usable.
    """
    index = joint_index(message.name, joint)
    if index is None or index >= len(message.position):
        return None
    velocity = float(message.velocity[index]) if index < len(message.velocity) else math.nan
    return TableSample(stamp_ns(message.header.stamp), float(message.position[index]), velocity)


def joint_index(names: Iterable[str], joint: str) -> int | None:
    """Return the place of ``joint`` among ``names``; empty means the first one."""
    known = list(names)
    if not joint:
        return 0 if known else None
    return known.index(joint) if joint in known else None


def probe_sample(message: Any) -> ProbeSample:
    """Return a rotcal_msgs/ProbePoint as record; an unheard-of kind is UNKNOWN."""
    return ProbeSample(
        stamp_ns=stamp_ns(message.header.stamp),
        sequence=message.sequence,
        step=message.step,
        attempt=message.attempt,
        kind=_known(PointKind, message.kind),
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
    """Return the order that a TableAngle and a ProbeTarget of one attempt give together."""
    return Command(
        step=table.step,
        attempt=table.attempt,
        table_angle=table.angle,
        approach=_known(Approach, table.approach),
        kind=_known(PointKind, probe.kind),
        target=probe.target,
        position=_point(probe.position),
        station=probe.station,
    )


def observation(message: Any) -> Observation:
    """Return a rotcal_msgs/Observation as record."""
    return Observation(
        step=message.step,
        attempt=message.attempt,
        table_position=message.table_index,
        table_angle=message.table_angle,
        target=message.target,
        station=message.station,
        kind=_known(PointKind, message.kind),
        mean=_floats(message.mean),
        std=_floats(message.std),
        scatter=_floats(message.scatter),
        probe_position=_point(message.probe_position),
        n_samples=message.n_samples,
        n_used=message.n_used,
        accepted=bool(message.accepted),
        reason=message.reason,
        table_angle_measured=message.table_angle_measured,
        temperature_c=_number(message.temperature),
        window_start_ns=stamp_ns(message.window_start),
        window_end_ns=stamp_ns(message.window_end),
        run=message.run,
        segment=message.segment,
        pressure_pa=_number(message.pressure),
        humidity=_number(message.humidity),
    )


def static_frames(message: Any) -> tuple[StaticFrame, ...]:
    """Return the transforms of a tf2_msgs/TFMessage."""
    return tuple(
        StaticFrame(
            str(each.header.frame_id),
            str(each.child_frame_id),
            _point(getattr(each.transform.translation, axis) for axis in "xyz"),
            _turn(each.transform.rotation),
        )
        for each in message.transforms
    )


def _turn(rotation: Any) -> tuple[float, float, float, float]:
    return float(rotation.x), float(rotation.y), float(rotation.z), float(rotation.w)


def _known(kind: type[E], number: int) -> E:
    try:
        return kind(number)
    except ValueError:
        return kind(0)


def _number(value: float) -> float | None:
    """Return a number of a message, in which NaN says that there is none."""
    return None if math.isnan(value) else value


def _floats(values: Iterable[Any]) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


def _point(values: Iterable[Any]) -> Point:
    x, y, z = values
    return float(x), float(y), float(z)
