"""What was measured: frozen dataclasses in SI, without ROS.

Everything from the instruments reaches the core as one of these records, whether live, from a bag
or from a plain table. Time is integer nanoseconds of the machine's clock. Angles are radians
counter-clockwise about the table axis +z, lengths and positions are metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from rotcal_ros.foundation.language import Phrase, phrase


class LengthStatus(IntEnum):
    """Status of a tracer reading; the values of ``rotcal_msgs/TracerLength``."""

    UNKNOWN = 0
    OK = 1
    BEAM_BROKEN = 2
    UNSTABLE = 3


class PointKind(IntEnum):
    """What a probe point is; the values of ``rotcal_msgs/ProbePoint``.

    >>> import rotcal_ros as rc
    >>> rc.PointKind(3).name
    'CENTRE'
    """

    UNKNOWN = 0
    REFLECTOR = 1  # reflector carried by the probe, standing at its target
    SURFACE = 2  # tip centre touching a ball
    CENTRE = 3  # ball centre computed by the machine
    DIRECT = 4  # tracker: reflector measured directly
    MIRRORED = 5  # tracker: the same reflector through the mirror
    NEST = 6  # tracker: fixed nest for registration
    READING = 7  # up to three values of a method's own instrument, in its own unit


class Approach(IntEnum):
    """Side from which the table reaches its angle; the values of ``rotcal_msgs/TableAngle``."""

    UNKNOWN = 0
    POSITIVE = 1  # angle increasing while approaching
    NEGATIVE = 2  # angle decreasing while approaching


@dataclass(frozen=True, slots=True)
class TracerSample:
    """One tracer reading: relative ``length`` and its standard deviation, both in metres."""

    stamp_ns: int
    sequence: int
    length: float
    length_std: float
    status: LengthStatus


@dataclass(frozen=True, slots=True)
class TableSample:
    """Table feedback: actual ``angle`` (rad, unwrapped by the drive) and ``velocity`` (rad/s)."""

    stamp_ns: int
    angle: float
    velocity: float


@dataclass(frozen=True, slots=True)
class ProbeSample:
    """One probe point, machine frame, metres.

    ``step`` and ``attempt`` echo the command that the machine carried out; ``target`` is the
    index of target, ball step or nest; ``station`` that of the tracker station; ``point`` counts
    the touch points of one ball.
    """

    stamp_ns: int
    sequence: int
    step: int
    attempt: int
    kind: PointKind
    target: int
    station: int
    point: int
    position: tuple[float, float, float]
    position_std: tuple[float, float, float]
    tip_radius: float


@dataclass(frozen=True, slots=True)
class TemperatureSample:
    """One air or body temperature in degrees Celsius, with the name of its sensor."""

    stamp_ns: int
    sensor: str
    temperature_c: float


@dataclass(frozen=True, slots=True)
class PressureSample:
    """One air pressure in pascal, with the name of its sensor."""

    stamp_ns: int
    sensor: str
    pressure_pa: float


@dataclass(frozen=True, slots=True)
class HumiditySample:
    """One relative humidity of the air, 0 to 1, with the name of its sensor."""

    stamp_ns: int
    sensor: str
    humidity: float


@dataclass(frozen=True, slots=True)
class Turn:
    """The table turns from rest at ``begin`` to rest at ``end``, rad, and passes its angles.

    It does so at ``speed``, rad/s, negative for decreasing angles.
    """

    begin: float
    end: float
    speed: float


@dataclass(frozen=True, slots=True)
class Command:
    """What the planner ordered for one step: a table angle and where the probe shall be.

    ``station`` is the index of the tracker station, 0 if there is no tracker. With a ``turn`` the
    table turns past the angle and all that are behind it, while the probe follows or stands.
    """

    step: int
    attempt: int
    table_angle: float
    approach: Approach
    kind: PointKind
    target: int
    position: tuple[float, float, float]
    station: int = 0
    turn: Turn | None = None

    def answered(
        self,
        stamp_ns: int,
        sequence: int,
        position: tuple[float, float, float],
        position_std: tuple[float, float, float] = (0.0, 0.0, 0.0),
        point: int = 0,
        tip_radius: float = 0.0,
    ) -> ProbeSample:
        """Return the point that answers this order: it echoes step, attempt and target."""
        return ProbeSample(
            stamp_ns=stamp_ns,
            sequence=sequence,
            step=self.step,
            attempt=self.attempt,
            kind=self.kind,
            target=self.target,
            station=self.station,
            point=point,
            position=position,
            position_std=position_std,
            tip_radius=tip_radius,
        )


ATTEMPTS_PER_RUN: Final = 1_000_000
"""Attempts of run k count from k times this on, so that none repeats an order of an earlier run.

More than a person has patience for; 4000 runs fit the messages' 32 bits.
"""


def place_in_words(table_position: int, target: int, attempt: int = 0) -> str:
    """Return a step for people: its place, and from the second of its run on the attempt.

    The number of a step in its plan does not count what was done: a policy takes few of them, in
    any order.

    >>> place_in_words(3, 30), place_in_words(3, 30, ATTEMPTS_PER_RUN + 1)
    ('table position 3, target 30', 'table position 3, target 30 (attempt 2)')
    """
    place = (table_position, target)
    if tried := attempt % ATTEMPTS_PER_RUN:
        return phrase("table position {0}, target {1} (attempt {2})", *place, tried + 1)
    return phrase("table position {0}, target {1}", *place)


@dataclass(frozen=True, slots=True)
class Observation:
    """One captured step: the mean of a window of samples, or the reason why there is none.

    ``mean``, ``std`` (of the mean) and ``scatter`` (standard deviation of one sample) hold one
    value (length) or three (point), in metres. A rejected observation keeps its numbers and
    says why in ``reason``; an accepted one has an empty reason. ``run`` counts from 0 how often an
    interrupted plan was continued. Observations of a run with equal ``segment`` were read from one
    unbroken beam of a tracer, that is from the same zero. ``humidity`` is relative, 0 to 1.

    >>> import rotcal_ros as rc
    >>> first = rc.read_bag("examples/data/ball_plate_bag").observations[0]
    >>> first.accepted, first.reason, first.kind.name, len(first.mean)
    (True, '', 'SURFACE', 3)
    """

    step: int
    attempt: int
    table_position: int
    table_angle: float
    target: int
    station: int
    kind: PointKind
    mean: tuple[float, ...]
    std: tuple[float, ...]
    scatter: tuple[float, ...]
    probe_position: tuple[float, float, float]
    n_samples: int
    n_used: int
    accepted: bool
    reason: Phrase
    table_angle_measured: float
    temperature_c: float | None
    window_start_ns: int
    window_end_ns: int
    run: int = 0
    segment: int = 0
    pressure_pa: float | None = None
    humidity: float | None = None

    @property
    def captured(self) -> bool:
        """Whether a window of samples was captured; a row of a table has none, at most a time."""
        return self.window_start_ns > 0
