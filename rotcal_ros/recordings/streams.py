"""The streams of one cell in a bag, fed to the capture in the order they were recorded."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
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
from rotcal_ros.observations import LengthStatus, Observation, TableSample
from rotcal_ros.recordings.foreign import FLOAT, POINT, Position, Speedometer, StepFinder
from rotcal_ros.recordings.topics import Part

_STAMP: Final = ("header.stamp.sec", "header.stamp.nanosec")
_TRACER: Final = (*_STAMP, "sequence", "length", "status")
_SLICE_NS: Final = 1_000_000_000

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


class StreamFeeder:
    """Feeds blocks of messages to a capture and collects the observations.

    Tracer readings go in many at once, so they run ahead of the other streams, by one second
    of their stamps at most; the capture's answer does not depend on that. ``make`` returns a new
    capture for the run with a number. ``joint`` names the table among the joint states; empty
    means the first.
    """

    def __init__(
        self,
        make: Callable[[int], Capture],
        joint: str = "",
        finder: StepFinder | None = None,
        topics: TopicSettings | None = None,
    ) -> None:
        self.observations: list[Observation] = []
        self._make = make
        self._captures = [make(0)]
        self._joint = joint
        self._finder = finder
        self._units = topics or TopicSettings()
        self._speed = Speedometer()
        self._counted = 0
        self._orders = Orders()
        self._makers: dict[str, Callable[[Any], Any]] = {
            names.PROBE_POINT: records.probe_sample,
            names.TEMPERATURE: records.temperature_sample,
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
        readings = np.zeros(0, _READING)
        for part in parts:
            if part.role == names.TRACER_LENGTH:
                readings = self._readings(block, part)
            elif part.role == names.JOINT_STATES:
                others.extend(self._table_samples(block, part))
            elif part.role in self._makers:
                others.extend(self._single(block, part))
        others.sort(key=lambda numbered: numbered[0])
        self._feed_slices(readings, others)

    def _feed_slices(self, readings: NDArray[np.void], others: list[Numbered]) -> None:
        """Feed in file order, but the readings of one second at once."""
        stamps = readings["stamp_ns"]
        seconds = (stamps - stamps[:1]) // _SLICE_NS
        cuts = [*(np.flatnonzero(np.diff(seconds)) + 1).tolist(), len(readings)]
        begin = done = 0
        for cut in cuts:
            part = readings[begin:cut]
            if cut > begin:
                self.observations += self._capture.feed_tracer(
                    part["stamp_ns"], part["sequence"], part["length"], part["status"]
                )
            last_row = readings["row"][cut] if cut < len(readings) else math.inf
            while done < len(others) and others[done][0] < last_row:
                for record in self._understood(others[done][1]):
                    self.observations += self._capture.feed(record)
                done += 1
            begin = cut

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
        rows = np.concatenate([part.rows[c.rows] for c in shapes])
        values = np.concatenate([c.values["data"] for c in shapes])
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

    def _bare_angles(self, block: Block, part: Part) -> Iterator[Numbered]:
        rows, stamps, values = self._floats(block, part)
        angles = (values * self._units.angle_unit_rad).tolist()
        samples = map(self._speed.sample, stamps.tolist(), angles)
        yield from zip(rows.tolist(), samples, strict=True)

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

    def _table_samples(self, block: Block, part: Part) -> Iterator[Numbered]:
        wanted = (*_STAMP, "position", "velocity")
        if part.decoder.channel.type_name == FLOAT:
            yield from self._bare_angles(block, part)
            return
        for columns in part.decoder.columns(block.select(part.rows), wanted):
            index = records.joint_index(columns.layout.texts.get("name", []), self._joint)
            position, velocity = columns.values["position"], columns.values["velocity"]
            if index is None or index >= position.shape[1]:
                continue
            known = velocity.shape[1] > index
            speeds = velocity[:, index].tolist() if known else [math.nan] * len(columns.rows)
            angles = position[:, index].tolist()
            samples = map(TableSample, columns.stamp_ns().tolist(), angles, speeds)
            yield from zip(part.rows[columns.rows].tolist(), samples, strict=True)

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


def _readings_of(columns: Columns, part: Part) -> NDArray[np.void]:
    readings = np.zeros(len(columns.rows), _READING)
    readings["row"] = part.rows[columns.rows]
    readings["stamp_ns"] = columns.stamp_ns()
    for name in ("sequence", "length", "status"):
        readings[name] = columns.values[name]
    return readings
