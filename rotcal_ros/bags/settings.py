"""Settings of recording and of reading: the groups ``recorder``, ``topics`` and ``reading``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, Final, Literal

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.settings import (
    check_ros_name,
    expert,
    group,
    setting,
    settings_from_changes,
)
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICRORADIAN
from rotcal_ros.foundation.untrusted import load_yaml


@dataclass(frozen=True)
class WriterSettings:
    """When chunks are closed and files are split."""

    sync_interval_s: ClassVar[
        Annotated[
            float,
            "data wait at most so long for the disk: a crash costs no more, and a step that waits "
            "for its receipt hardly takes longer",
        ]
    ] = 0.5
    chunk_bytes: ClassVar[
        Annotated[
            int,
            "a chunk is closed early at this size: compression gains nothing beyond it",
        ]
    ] = 262_144
    split_bytes: int = setting(
        0, doc="bytes, size at which a new file is begun; 0: never", minimum=0
    )
    split_duration_s: ClassVar[
        Annotated[float, "split_bytes bounds files by what is limited, their size"]
    ] = 0.0
    min_free_bytes: int = setting(
        67108864, doc="bytes, free disk space below which recording stops in good order", minimum=0
    )


@dataclass(frozen=True)
class RecorderSettings:
    """Where and how a cell is recorded."""

    folder: str = setting(
        "~/.ros/rotcal", doc="folder below which every calibration gets its session folder"
    )
    session: str = expert(
        "", doc="name of the session folder; empty: UTC time and the start of the plan's hash"
    )
    run: int = expert(
        0,
        minimum=0,
        maximum=1_000_000,
        doc="number of this run of an interrupted session; 0 begins a session, later runs "
        "continue its bag in a new file",
    )
    queue_bytes: ClassVar[
        Annotated[
            int,
            "minutes of all streams; a disk that is so far behind does not catch up",
        ]
    ] = 67_108_864
    silence_s: float = expert(
        30.0,
        minimum=0.1,
        maximum=3600.0,
        doc="s, time without a message after which tracer_length, joint_states or a topic of the "
        "air counts as silent",
    )
    writer: WriterSettings = group(WriterSettings, expert=True)


LENGTH_UNITS: Final = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "nm": 1e-9}
"""Units of lengths and positions in m."""
ANGLE_UNITS: Final = {"rad": 1.0, "deg": DEGREE, "arcsec": ARCSEC, "urad": MICRORADIAN}
"""Units of angles in rad."""
Length = Literal["m", "mm", "um", "nm"]
Clock = Literal["stamp", "sent"]

_MAX_OFFSET_S: Final = 4e9
"""A clock that counts from its start is behind by the time since 1970."""
_OFFSET_DOC: Final = "by which the clock of {} is ahead (behind: negative); it is subtracted"
_CLOCK_DOC: Final = (
    "which time counts as that of {}: the stamp in its header, or when its message was sent (for "
    "a device whose clock drifts or counts from its start); without a header always the latter"
)

_FIELD_DOC: Final = (
    "where the {} stands in messages of any other type, by the names of the fields, such as {}; "
    "empty: by the type"
)


@dataclass(frozen=True)
class TopicSettings:
    """Topics that bear other names, and the units and clocks of those who publish them."""

    tracer_length: str = setting(
        "", doc="topic of the lengths; empty: the one called tracer_length"
    )
    probe_point: str = setting("", doc="topic of the probe; empty: the one called probe_point")
    joint_states: str = setting(
        "", doc="topic of the table's feedback; empty: the one called joint_states"
    )
    temperature: str = setting(
        "", doc="topic of the temperature; empty: the one called temperature"
    )
    air_pressure: str = setting(
        "", doc="topic of the air pressure; empty: the one called air_pressure"
    )
    relative_humidity: str = setting(
        "", doc="topic of the humidity; empty: the one called relative_humidity"
    )
    length_field: str = expert("", doc=_FIELD_DOC.format("length", "measurement.distance"))
    angle_field: str = expert("", doc=_FIELD_DOC.format("angle", "axis.position"))
    position_field: str = expert("", doc=_FIELD_DOC.format("point's x, y and z", "pose.position"))
    length_unit: Length = setting("m", doc="unit of the lengths")
    length_unit_m: float = expert(
        1.0,
        doc="m, unit of the lengths where it has no name; negative where a length shrinks with "
        "distance",
    )
    angle_unit: Literal["rad", "deg", "arcsec", "urad"] = setting(
        "rad", doc="unit of the table's angles; its velocities are in this unit per second"
    )
    angle_unit_rad: float = expert(
        1.0,
        doc="rad, unit of the angles where it has no name; negative where the table counts "
        "clockwise",
    )
    angle_span_s: float = expert(
        0.1,
        minimum=1e-3,
        maximum=10.0,
        doc="s, time over which the speed is taken from angles that come without a velocity; "
        "longer: rest is seen that much later; shorter: noise looks like motion",
    )
    position_unit: Length = setting("m", doc="unit of the probe's positions")
    temperature_unit: Literal["degC", "K", "degF"] = expert("degC", doc="unit of the temperatures")
    pressure_unit: Literal["Pa", "hPa", "kPa"] = expert("Pa", doc="unit of the air pressure")
    humidity_unit: Literal["share", "percent"] = expert(
        "share", doc="unit of the relative humidity"
    )
    length_single_shot: bool = expert(
        False,
        doc="lengths come one by one or in bursts, only when the instrument is asked: its "
        "silence is no loss",
    )
    probe_single_shot: bool = expert(
        False,
        doc="the probe publishes a point only on arrival: the preflight does not wait for one",
    )
    length_trigger: str = setting(
        "",
        doc="service (std_srvs/Trigger) that takes one length, called at rest until the window "
        "is full; empty: the instrument measures by itself",
    )
    tip_radius_m: float = setting(
        0.0, doc="m, radius of the probe tip, where the touch points do not state it", minimum=0.0
    )
    length_clock: Clock = expert("stamp", doc=_CLOCK_DOC.format("a length"))
    table_clock: Clock = expert("stamp", doc=_CLOCK_DOC.format("an angle"))
    probe_clock: Clock = expert("stamp", doc=_CLOCK_DOC.format("a point"))
    length_clock_offset_s: float = expert(
        0.0,
        minimum=-_MAX_OFFSET_S,
        maximum=_MAX_OFFSET_S,
        doc=f"s, {_OFFSET_DOC.format('the lengths')}",
    )
    table_clock_offset_s: float = expert(
        0.0,
        minimum=-_MAX_OFFSET_S,
        maximum=_MAX_OFFSET_S,
        doc=f"s, {_OFFSET_DOC.format('the table')}",
    )
    probe_clock_offset_s: float = expert(
        0.0,
        minimum=-_MAX_OFFSET_S,
        maximum=_MAX_OFFSET_S,
        doc=f"s, {_OFFSET_DOC.format('the probe')}",
    )
    clock_bound_s: float = expert(
        0.0,
        minimum=0.0,
        maximum=10.0,
        doc="s, by which the clocks of table, probe and instrument may differ all the same; "
        "multiplied by the creep of a table at rest (capture.velocity_tolerance_deg_s) it is "
        "part of the uncertainty of ECC",
    )

    def __post_init__(self) -> None:
        """Refuse names that no topic can bear, units that are none, and two for one."""
        for role, topic in self.renamed().items():
            check_ros_name(topic, role)
        if self.length_trigger:
            check_ros_name(self.length_trigger, "length_trigger")
        for name, factor, short in (
            ("length_unit_m", self.length_unit_m, self.length_unit != "m"),
            ("angle_unit_rad", self.angle_unit_rad, self.angle_unit != "rad"),
        ):
            if factor == 0.0:
                raise ConfigurationError(
                    f"{name} = 0 makes every value zero: give the size of one unit, such as 0.001"
                )
            if short and abs(factor) != 1.0:
                by_name = name.rpartition("_")[0]
                raise ConfigurationError(
                    f"{by_name} = {getattr(self, by_name)} and {name} = {factor:g} are two units "
                    f"for one stream: state one of them (beside {by_name}, {name} may be -1 to "
                    "turn the sign)"
                )

    @property
    def length_m(self) -> float:
        """The unit of the lengths in m, with its sign."""
        return LENGTH_UNITS[self.length_unit] * self.length_unit_m

    @property
    def angle_rad(self) -> float:
        """The unit of the angles in rad, with its sign."""
        return ANGLE_UNITS[self.angle_unit] * self.angle_unit_rad

    def renamed(self) -> dict[str, str]:
        """Return role -> topic of those that were given."""
        roles = (
            "tracer_length", "probe_point", "joint_states", "temperature", "air_pressure",
            "relative_humidity",
        )  # fmt: skip
        return {role: getattr(self, role) for role in roles if getattr(self, role)}


_GROUP: Final = "reading"

LARGEST_MESSAGE: Final = 128 * 1024 * 1024
"""Bytes of the largest message that a database may hold, or a definition ask for."""


@dataclass(frozen=True)
class ReadingLimits:
    """What a bag may cost to read; what goes beyond is left out and said."""

    record_bytes: ClassVar[Annotated[int, "chunk_bytes bounds records, too"]] = 50_331_648
    chunk_bytes: int = setting(
        50_331_648,
        doc="bytes, largest record, unpacked chunk or message that is taken into memory",
        minimum=65_536,
    )
    unpacked_bytes: int = setting(
        268_435_456,
        doc="bytes, largest total that a file of any size may unpack to",
        minimum=65_536,
    )
    unpacked_ratio: int = setting(
        1000,
        doc="largest ratio of unpacked to stored bytes of a file, where this allows more than "
        "unpacked_bytes",
        minimum=1,
    )
    other_records: ClassVar[
        Annotated[
            int,
            "a chunk holds its messages and a few hundred definitions; more records that are no "
            "messages are made to exhaust a reader",
        ]
    ] = 200_000
    kept_bytes: int = setting(
        33_554_432,
        doc="bytes, memory for all definitions, attachments and metadata of a file together",
        minimum=65_536,
    )


DEFAULT_LIMITS: Final = ReadingLimits()


def is_limit(change: str) -> bool:
    """Return whether a ``group.name=value`` is about the limits of reading."""
    return change.partition(".")[0] == _GROUP


def changed_limits(changes: Sequence[str]) -> ReadingLimits:
    """Return the limits with ``reading.name=value`` changes; ConfigurationError for all others."""
    return settings_from_changes(ReadingLimits, _GROUP, changes, load_yaml)


def limit_refusal(what: str, setting_name: str, least: int) -> str:
    """Return the words for something beyond a limit: what it is, and what lets it pass."""
    return f"{what}; --set reading.{setting_name}={least} of rotcal bag repair lets it pass"
