"""Message types of other packages that instruments use: which fields hold their numbers.

Fields are named by their dotted path, which is an attribute of a live message and a column of a
bag alike.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Final

from rotcal_ros.bags.names import (
    AIR_PRESSURE,
    JOINT_STATES,
    PROBE_POINT,
    RELATIVE_HUMIDITY,
    TEMPERATURE,
    TRACER_LENGTH,
)
from rotcal_ros.capture.messages import stamp_ns
from rotcal_ros.foundation.errors import ConfigurationError

STAMP: Final = ("header.stamp.sec", "header.stamp.nanosec")


@dataclass(frozen=True, slots=True)
class Form:
    """The fields of a message type: its ``numbers``, and the ``limits`` of their valid range."""

    numbers: tuple[str, ...]
    stamped: bool = True
    limits: tuple[str, ...] = ()

    @property
    def fields(self) -> tuple[str, ...]:
        """All fields that are read: numbers, limits, and the stamp where there is one."""
        return (*self.numbers, *self.limits, *(STAMP if self.stamped else ()))

    def row(self, message: Any) -> tuple[float, ...]:
        """Return numbers and limits of a live message."""
        return tuple(float(attrgetter(name)(message)) for name in (*self.numbers, *self.limits))

    def stamp_ns(self, message: Any, sent_ns: int) -> int:
        """Return the stamp of a live message; the time of sending if it has none."""
        return stamp_ns(message.header.stamp) if self.stamped else sent_ns


_SCALARS: Final = {
    "std_msgs/msg/Float64": Form(("data",), stamped=False),
    "std_msgs/msg/Float32": Form(("data",), stamped=False),
    "sensor_msgs/msg/Range": Form(("range",), limits=("min_range", "max_range")),
}
_POINTS: Final = {
    "geometry_msgs/msg/PointStamped": Form(("point.x", "point.y", "point.z")),
    "geometry_msgs/msg/PoseStamped": Form(
        ("pose.position.x", "pose.position.y", "pose.position.z")
    ),
    "geometry_msgs/msg/Vector3Stamped": Form(("vector.x", "vector.y", "vector.z")),
}
FORMS: Final[Mapping[str, Mapping[str, Form]]] = {
    TRACER_LENGTH: _SCALARS,
    JOINT_STATES: _SCALARS,
    PROBE_POINT: _POINTS,
    TEMPERATURE: _SCALARS,
    AIR_PRESSURE: _SCALARS,
    RELATIVE_HUMIDITY: _SCALARS,
}
"""The types that each role accepts besides its own, by name."""
OWN: Final[Mapping[str, str]] = {
    TRACER_LENGTH: "rotcal_msgs/msg/TracerLength",
    JOINT_STATES: "sensor_msgs/msg/JointState",
    PROBE_POINT: "rotcal_msgs/msg/ProbePoint",
    TEMPERATURE: "sensor_msgs/msg/Temperature",
    AIR_PRESSURE: "sensor_msgs/msg/FluidPressure",
    RELATIVE_HUMIDITY: "sensor_msgs/msg/RelativeHumidity",
}
"""The type made for each role, with numbers, status and step."""


def form_of(role: str, type_name: str) -> Form | None:
    """Return the form of a foreign type that the role accepts; None for any other type."""
    return FORMS.get(role, {}).get(type_name)


def check_type(role: str, type_name: str) -> None:
    """Raise ConfigurationError unless messages of a type can be used in a role."""
    if type_name != OWN.get(role) and form_of(role, type_name) is None:
        usable = ", ".join([OWN[role], *FORMS[role]])
        raise ConfigurationError(f"{role}: {type_name} cannot be used; expected {usable}")
