"""The streams of one cell in a bag, fed to the capture in the order they were recorded."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from rotcal_ros import messages as records
from rotcal_ros.arrays import Ints
from rotcal_ros.bags import names
from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.decode import Columns
from rotcal_ros.bags.topic_settings import TopicSettings
from rotcal_ros.capture.orders import Orders
from rotcal_ros.capture.stamp_offsets import StampOffsets
from rotcal_ros.observations import LengthStatus, Observation, TableSample
from rotcal_ros.recordings.foreign import FLOAT, POINT, Position, Speedometer, StepFinder
from rotcal_ros.recordings.topics import Part

_STAMP: Final = ("header.stamp.sec", "header.stamp.nanosec")
_TRACER: Final = (*_STAMP, "sequence", "length", "status")
_JOINTS: Final = (*_STAMP, "position", "velocity")
SLICE_NS: Final = 1_000_000_000
"""How far readings and feedback run ahead of the other streams at most (1 s)."""

Numbered = tuple[int, Any]
"""The row of a message in its block, and its record."""


class Capture(Protocol):
    """What is needed of rotcal_ros.capture.Capture."""

    @property
    def counts(self) -> Mapping[str, Mapping[str, int]]:
        """What each stream delivered."""

    def feed(self, record: Any) -> tuple[Observation, ...]:
        """Take one record."""

    def feed_tracer(
        self, stamp_ns: Ints, sequence: NDArray[Any], length: NDArray[Any], status: NDArray[Any]
    ) -> tuple[Observation, ...]:
        """Take many tracer readings."""

    def feed_table(
        self, stamp_ns: Ints, angle: NDArray[Any], velocity: NDArray[Any]
    ) -> tuple[Observation, ...]:
        """Take many feedbacks of the table."""


class StreamFeeder:
    """Feeds blocks of messages to a capture and collects the observations.

    Tracer readings and feedback of the table go in many at once, so they run ahead of the other
    streams, by ``slice_ns`` of their stamps at most; as long as that is well within the clock
    tolerance, the capture's answer does not depend on it. ``make`` returns a new
    capture for the run with a number. ``joint`` names the table among the joint states; empty
    means the first. ``offset`` says which clocks differ, by more than ``stamp_offset_s``,
    ``offsets`` what the bag tells of that at each observation.
    """

    def __init__(
        self,
        make: Callable[[int], Capture],
        joint: str = "",
        finder: StepFinder | None = None,
        topics: TopicSettings | None = None,
        slice_ns: int = SLICE_NS,
        stamp_offset_s: float = math.inf,
    ) -> None:
        self._clocks = StampOffsets(stamp_offset_s)
        self.observations: list[Observation] = []
        self.offset, self.offsets = "", list[str]()
        self._make = make
        self._captures = [make(0)]
        self._joint = joint
        self._finder = finder
        self._finding = False
        self._slice_ns = max(1, slice_ns)
        self._units = topics or TopicSettings()
        self._speed = Speedometer()
        self._counted = 0
        self._orders = Orders()
        self._makers: dict[str, Callable[[Any], Any]] = {
            names.PROBE_POINT: records.probe_sample,
            names.TEMPERATURE: records.temperature_sample,
            names.AIR_PRESSURE: records.pressure_sample,
            names.RELATIVE_HUMIDITY: records.humidity_sample,
            names.TABLE_ANGLE: self._orders.table_angle,
            names.PROBE_TARGET: self._orders.probe_target,
        }

    def begin_run(self, run: int) -> None:
        """Start afresh: what was undecided when a run was interrupted stays undecided."""
        self._captures.append(self._make(run))
        self._orders.clear()

    @property
    def counts(self) -> dict[str, dict[str, int]]:
        """What the captures of all runs counted, by stream."""
        total: dict[str, Counter[str]] = {}
        for capture in self._captures:
            for stream, counts in capture.counts.items():
                total.setdefault(stream, Counter()).update(counts)
        return {stream: dict(counts) for stream, counts in total.items()}

    @property
    def _capture(self) -> Capture:
        return self._captures[-1]

    def feed(self, block: Block, parts: list[Part]) -> None:
        """Feed one block that ``parts`` splits into the topics of the cell."""
        others: list[Numbered] = []
        readings, feedback = np.zeros(0, _READING), np.zeros(0, _FEEDBACK)
        self._finding |= self._finder is not None and any(
            part.decoder.channel.type_name == POINT for part in parts
        )
        for part in parts:
            with part.taken_as_expected():
                if part.role == names.TRACER_LENGTH:
                    readings = self._readings(block, part)
                    self._hold(part.role, readings, block)
                elif part.role == names.JOINT_STATES:
                    feedback = self._feedback(block, part)
                    self._hold(part.role, feedback, block)
                elif part.role in self._makers:
                    found = list(self._single(block, part))
                    others.extend(found)
                    if part.role == names.PROBE_POINT:
                        self._hold_points(found, block)
        if self._finding:  # a foreign position is the step at which the table stood just then
            others.extend(_samples(feedback))
            feedback = feedback[:0]
        others.sort(key=lambda numbered: numbered[0])
        self._feed_slices(readings, feedback, others)
        offset = self._clocks.in_words()
        self.offset = self.offset or offset
        self.offsets += [offset] * (len(self.observations) - len(self.offsets))

    def _hold(self, role: str, records: NDArray[np.void], block: Block) -> None:
        """Hold stamps against the times at which the messages came."""
        came = block.headers["log_time"][records["row"]].astype(np.int64)
        self._clocks.note_many(role, records["stamp_ns"], came)

    def _hold_points(self, points: Iterable[Numbered], block: Block) -> None:
        for row, point in points:
            came_ns = int(block.headers["log_time"][row])
            self._clocks.note(names.PROBE_POINT, point.stamp_ns, came_ns)

    def _feed_slices(
        self, readings: NDArray[np.void], feedback: NDArray[np.void], others: list[Numbered]
    ) -> None:
        """Feed in file order, but the readings and the feedback of one slice of time at once."""
        done = 0
        for ends, last_row in _slices(readings, feedback, self._slice_ns):
            ours, table = readings[slice(*ends[0])], feedback[slice(*ends[1])]
            if len(ours):
                self.observations += self._capture.feed_tracer(
                    ours["stamp_ns"], ours["sequence"], ours["length"], ours["status"]
                )
            if len(table):
                self._feed_table(table)
            while done < len(others) and others[done][0] < last_row:
                for record in self._understood(others[done][1]):
                    self.observations += self._capture.feed(record)
                done += 1

    def _feed_table(self, feedback: NDArray[np.void]) -> None:
        self.observations += self._capture.feed_table(
            feedback["stamp_ns"], feedback["angle"], feedback["velocity"]
        )
        if self._finder is not None:  # so that it knows where the table is, should points come
            ((_, last),) = _samples(feedback[-1:])
            self._finder.table(last)

    def _understood(self, record: Any) -> Iterator[Any]:
        """Yield the records for the capture; a foreign position becomes the step it stands at."""
        if isinstance(record, Position):
            answer = self._finder.probe(record) if self._finder else None
        else:
            yield record
            is_table = isinstance(record, TableSample)
            answer = self._finder.table(record) if is_table and self._finder else None
        if answer is not None:
            yield answer

    def _floats(self, block: Block, part: Part) -> tuple[Ints, Ints, NDArray[Any]]:
        """Return rows, log times (ns) and values (n,) of a topic of bare numbers."""
        shapes = list(part.decoder.columns(block.select(part.rows), ("data",)))
        rows = np.concatenate([part.rows[:0], *(part.rows[c.rows] for c in shapes)])
        values = np.concatenate([np.zeros(0), *(c.values["data"] for c in shapes)])
        order = np.argsort(rows)
        rows = rows[order]
        return rows, block.headers["log_time"][rows].astype(np.int64), values[order]

    def _bare_readings(self, block: Block, part: Part) -> NDArray[np.void]:
        """Return readings of a topic of bare lengths, numbered as they came."""
        rows, stamps, values = self._floats(block, part)
        readings = np.zeros(len(rows), _READING)
        readings["row"], readings["stamp_ns"] = rows, stamps
        readings["length"] = values * self._units.length_unit_m
        readings["sequence"] = (self._counted + np.arange(len(rows))) % (1 << 32)
        readings["status"] = int(LengthStatus.OK)
        self._counted += len(rows)
        return readings

    def _bare_angles(self, block: Block, part: Part) -> NDArray[np.void]:
        rows, stamps, values = self._floats(block, part)
        feedback = np.zeros(len(rows), _FEEDBACK)
        feedback["row"], feedback["stamp_ns"] = rows, stamps
        feedback["angle"] = angles = values * self._units.angle_unit_rad
        samples = map(self._speed.sample, stamps.tolist(), angles.tolist())
        feedback["velocity"] = [sample.velocity for sample in samples]
        return feedback

    def _positions(self, block: Block, part: Part) -> Iterator[Numbered]:
        for row, message in part.messages(block):
            point = message.point
            stamp_ns = records.stamp_ns(message.header.stamp)
            yield row, Position(stamp_ns, (point.x, point.y, point.z))

    def _readings(self, block: Block, part: Part) -> NDArray[np.void]:
        """Return the tracer readings of a block in file order."""
        if part.decoder.channel.type_name == FLOAT:
            return self._bare_readings(block, part)
        shapes = part.decoder.columns(block.select(part.rows), _TRACER)
        found = [np.zeros(0, _READING), *(_readings_of(columns, part) for columns in shapes)]
        readings = np.concatenate(found)
        return readings[np.argsort(readings["row"], kind="stable")]

    def _feedback(self, block: Block, part: Part) -> NDArray[np.void]:
        """Return the feedback of the table in a block in file order."""
        if part.decoder.channel.type_name == FLOAT:
            return self._bare_angles(block, part)
        found = [np.zeros(0, _FEEDBACK)]
        for columns in part.decoder.columns(block.select(part.rows), _JOINTS):
            index = records.joint_index(columns.layout.texts.get("name", []), self._joint)
            position, velocity = columns.values["position"], columns.values["velocity"]
            if index is None or index >= position.shape[1]:
                continue
            rows = np.zeros(len(columns.rows), _FEEDBACK)
            rows["row"], rows["stamp_ns"] = part.rows[columns.rows], columns.stamp_ns()
            rows["angle"] = position[:, index]
            rows["velocity"] = velocity[:, index] if velocity.shape[1] > index else math.nan
            found.append(rows)
        feedback = np.concatenate(found)
        return feedback[np.argsort(feedback["row"], kind="stable")]

    def _single(self, block: Block, part: Part) -> Iterator[Numbered]:
        """Yield the records of a slow topic, message by message."""
        if part.decoder.channel.type_name == POINT:
            yield from self._positions(block, part)
            return
        for row, message in part.messages(block):
            record = self._makers[part.role](message)
            if record is not None:
                yield row, record


_READING: Final = np.dtype(
    [
        ("row", np.int64),
        ("stamp_ns", np.int64),
        ("sequence", np.int64),
        ("length", np.float64),
        ("status", np.int64),
    ]
)
_FEEDBACK: Final = np.dtype(
    [("row", np.int64), ("stamp_ns", np.int64), ("angle", np.float64), ("velocity", np.float64)]
)

Ends = tuple[tuple[int, int], tuple[int, int]]
"""First and last index of readings, and of feedback."""


def _slices(
    readings: NDArray[np.void], feedback: NDArray[np.void], slice_ns: int
) -> Iterator[tuple[Ends, float]]:
    """Yield what goes in at once, and the row from which on other messages come after it."""
    rows = np.concatenate([readings["row"], feedback["row"]])
    order = np.argsort(rows, kind="stable")
    rows = rows[order]
    stamps = np.concatenate([readings["stamp_ns"], feedback["stamp_ns"]])[order]
    number = (stamps - stamps[:1]) // slice_ns
    last_rows = [*rows[np.flatnonzero(np.diff(number)) + 1].tolist(), math.inf]
    begins = (0, 0)
    for last_row in last_rows:
        ours = int(np.searchsorted(readings["row"], last_row))
        table = int(np.searchsorted(feedback["row"], last_row))
        yield ((begins[0], ours), (begins[1], table)), last_row
        begins = (ours, table)


def _samples(feedback: NDArray[np.void]) -> Iterator[Numbered]:
    """Yield the feedback one by one, as records."""
    for row, stamp_ns, angle, velocity in feedback.tolist():
        yield row, TableSample(stamp_ns, angle, velocity)


def _readings_of(columns: Columns, part: Part) -> NDArray[np.void]:
    readings = np.zeros(len(columns.rows), _READING)
    readings["row"] = part.rows[columns.rows]
    readings["stamp_ns"] = columns.stamp_ns()
    for name in ("sequence", "length", "status"):
        readings[name] = columns.values[name]
    return readings
