"""The messages of an instrument: which fields hold its numbers, their units, and its clock.

Its numbers become SI. Fields are named by their dotted path, which is an attribute of a live
message and a column of a bag alike.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any, Final

from rotcal_ros.bags import names
from rotcal_ros.bags.settings import LENGTH_UNITS, TopicSettings
from rotcal_ros.capture.messages import stamp_ns
from rotcal_ros.foundation.observations import (
    HumiditySample,
    PressureSample,
    ProbeSample,
    TableSample,
    TemperatureSample,
    TracerSample,
)
from rotcal_ros.foundation.units import NANOSECOND

_KELVIN: Final = 273.15
_CELSIUS: Final[Mapping[str, Callable[[Any], Any]]] = {
    "degC": lambda value: value,
    "K": lambda value: value - _KELVIN,
    "degF": lambda value: (value - 32.0) / 1.8,
}
_PASCAL: Final = {"Pa": 1.0, "hPa": 100.0, "kPa": 1000.0}
_SHARE: Final = {"share": 1.0, "percent": 0.01}
_OWNERS: Final = {
    names.TRACER_LENGTH: "length",
    names.JOINT_STATES: "table",
    names.PROBE_POINT: "probe",
}
"""The prefix of the settings of a role's clock."""
_FIELDS: Final = {
    names.TRACER_LENGTH: "length_field",
    names.JOINT_STATES: "angle_field",
    names.PROBE_POINT: "position_field",
}
"""The settings that name a role's numbers in messages of any type."""


def single_shots(settings: TopicSettings) -> tuple[str, ...]:
    """Return the roles that send nothing before they are asked or have arrived."""
    silent = {
        names.TRACER_LENGTH: settings.length_single_shot,
        names.PROBE_POINT: settings.probe_single_shot,
    }
    return tuple(role for role, is_silent in silent.items() if is_silent)


@dataclass(frozen=True)
class Conventions:
    """Units and clocks of the ``settings``, applied to the numbers of each role."""

    settings: TopicSettings

    def length(self, value: Any) -> Any:
        """Return a length, or an array of them, in m."""
        return value * self.settings.length_m

    def angle(self, value: Any) -> Any:
        """Return an angle in rad, a velocity in rad/s, or an array of them."""
        return value * self.settings.angle_rad

    def position(self, values: Any) -> tuple[float, float, float]:
        """Return a position (x, y, z), or its standard deviations, in m."""
        unit = LENGTH_UNITS[self.settings.position_unit]
        x, y, z = (float(value) * unit for value in values)
        return x, y, z

    def air(self, role: str, value: float) -> float:
        """Return the temperature in degrees Celsius, the pressure in Pa, the humidity 0 to 1."""
        if role == names.TEMPERATURE:
            return float(_CELSIUS[self.settings.temperature_unit](value))
        if role == names.AIR_PRESSURE:
            return value * _PASCAL[self.settings.pressure_unit]
        return value * _SHARE[self.settings.humidity_unit]

    def form(self, role: str, type_name: str) -> NumericFields | None:
        """Return the form of a type other than the role's own: as named, else as it is known."""
        owner, path = _OWNERS.get(role), self._path(role)
        if owner is None or not path:
            return FORMS.get(role, {}).get(type_name)
        stamped = getattr(self.settings, f"{owner}_clock") == "stamp"
        paths = tuple(f"{path}.{axis}" for axis in "xyz") if owner == "probe" else (path,)
        return NumericFields(paths, stamped)

    def _path(self, role: str) -> str:
        return str(getattr(self.settings, _FIELDS[role])) if role in _FIELDS else ""

    def why_unusable(self, role: str, type_name: str, fields: Collection[str]) -> str:
        """Return why messages of a type cannot be used in a role; empty: they can.

        ``fields`` are the dotted names of its numbers.
        """
        form, path = self.form(role, type_name), self._path(role)
        if form is None and type_name != OWN[role]:
            usable = ", ".join([OWN[role], *FORMS[role]])
            field = _FIELDS.get(role)
            named = f" (any other type: name its field, topics.{field})" if field else ""
            return f"{role}: {type_name} cannot be used; expected {usable}{named}"
        if form is None or not path:
            return ""
        missing = next((name for name in form.numbers if name not in fields), "")
        if missing:
            return (
                f"{role}: {type_name} has no field {missing} (topics.{_FIELDS[role]}: {path}); it "
                f"has {', '.join(fields) or 'no numbers'}"
            )
        return "" if STAMP[0] in fields else self.without_header(role, type_name)

    def without_header(self, role: str, type_name: str) -> str:
        """Return what to do about a type without a header; empty: nothing."""
        if not self._path(role) or getattr(self.settings, f"{_OWNERS[role]}_clock") == "sent":
            return ""
        return (
            f"{role}: {type_name} has no header: state topics.{_OWNERS[role]}_clock: sent, so "
            "that the time of sending counts"
        )

    def measured_at_ns(self, role: str, stamp_ns: Any, sent_ns: Any) -> Any:
        """Return when a value was taken, by the common clock; one time or (n,), integer ns.

        ``stamp_ns`` is the time in its header, ``sent_ns`` that of sending.
        """
        owner = _OWNERS.get(role)
        if owner is None:
            return stamp_ns
        by_stamp = getattr(self.settings, f"{owner}_clock") == "stamp"
        offset_s = getattr(self.settings, f"{owner}_clock_offset_s")
        return (stamp_ns if by_stamp else sent_ns) - round(offset_s / NANOSECOND)

    def by_sending(self, role: str, type_name: str) -> bool:
        """Return whether a message of this type counts as measured when it was sent."""
        form = self.form(role, type_name)
        if form is not None and not form.stamped:
            return True
        owner = _OWNERS.get(role)
        return owner is not None and getattr(self.settings, f"{owner}_clock") == "sent"

    def record(self, role: str, record: Any, sent_ns: int) -> Any:
        """Return a record of a message of the role's own type, in SI and by the common clock."""
        record = replace(record, stamp_ns=self.measured_at_ns(role, record.stamp_ns, sent_ns))
        match record:
            case TracerSample():
                std = self.length(record.length_std)
                return replace(record, length=self.length(record.length), length_std=abs(std))
            case TableSample():
                angle, velocity = self.angle(record.angle), self.angle(record.velocity)
                return replace(record, angle=angle, velocity=velocity)
            case ProbeSample():
                return self._point(record)
            case TemperatureSample():
                return replace(record, temperature_c=self.air(role, record.temperature_c))
            case PressureSample():
                return replace(record, pressure_pa=self.air(role, record.pressure_pa))
            case HumiditySample():
                return replace(record, humidity=self.air(role, record.humidity))
        return record

    def _point(self, sample: ProbeSample) -> ProbeSample:
        radius = sample.tip_radius * LENGTH_UNITS[self.settings.position_unit]
        return replace(
            sample,
            position=self.position(sample.position),
            position_std=self.position(sample.position_std),
            tip_radius=radius or self.settings.tip_radius_m,
        )

    @property
    def without_topic_names(self) -> TopicSettings:
        """The settings without the names of the topics."""
        named: dict[str, Any] = dict.fromkeys(self.settings.renamed(), "")
        return replace(self.settings, **named)

    @property
    def plain(self) -> bool:
        """Whether nothing has to be converted: SI units, and the stamps of the headers."""
        irrelevant: dict[str, Any] = {
            "length_single_shot": False,
            "probe_single_shot": False,
            "length_trigger": "",
        }
        return replace(self.without_topic_names, **irrelevant) == TopicSettings()


STAMP: Final = ("header.stamp.sec", "header.stamp.nanosec")


@dataclass(frozen=True, slots=True)
class NumericFields:
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
        """Return the stamp of a live message; the time of sending where it has none."""
        return stamp_ns(message.header.stamp) if self.stamped else sent_ns


_SCALARS: Final = {
    "std_msgs/msg/Float64": NumericFields(("data",), stamped=False),
    "std_msgs/msg/Float32": NumericFields(("data",), stamped=False),
    "sensor_msgs/msg/Range": NumericFields(("range",), limits=("min_range", "max_range")),
}
_POINTS: Final = {
    "geometry_msgs/msg/PointStamped": NumericFields(("point.x", "point.y", "point.z")),
    "geometry_msgs/msg/PoseStamped": NumericFields(
        ("pose.position.x", "pose.position.y", "pose.position.z")
    ),
    "geometry_msgs/msg/Vector3Stamped": NumericFields(("vector.x", "vector.y", "vector.z")),
}
FORMS: Final[Mapping[str, Mapping[str, NumericFields]]] = {
    names.TRACER_LENGTH: _SCALARS,
    names.JOINT_STATES: _SCALARS,
    names.PROBE_POINT: _POINTS,
    names.TEMPERATURE: _SCALARS,
    names.AIR_PRESSURE: _SCALARS,
    names.RELATIVE_HUMIDITY: _SCALARS,
}
"""The types that each role accepts beside its own, by name."""
OWN: Final[Mapping[str, str]] = {
    names.TRACER_LENGTH: "rotcal_msgs/msg/TracerLength",
    names.JOINT_STATES: "sensor_msgs/msg/JointState",
    names.PROBE_POINT: "rotcal_msgs/msg/ProbePoint",
    names.TEMPERATURE: "sensor_msgs/msg/Temperature",
    names.AIR_PRESSURE: "sensor_msgs/msg/FluidPressure",
    names.RELATIVE_HUMIDITY: "sensor_msgs/msg/RelativeHumidity",
}
"""The type made for each role: with numbers, status, step."""
