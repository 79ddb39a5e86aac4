"""Feeds the streams of one cell in a bag to the capture, in the order of recording."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.bags import names
from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.decode import Columns
from rotcal_ros.bags.settings import TopicSettings
from rotcal_ros.capture import messages as records
from rotcal_ros.capture.instruments.conventions import STAMP, NumericFields
from rotcal_ros.capture.instruments.interpreter import (
    FEEDBACK,
    READING,
    Interpreter,
    table_samples,
)
from rotcal_ros.capture.instruments.steps import Order, Position, StepFinder
from rotcal_ros.capture.messages import OrderPairing
from rotcal_ros.capture.stamp_offsets import REFERENCE, OffsetLimits, StampOffsets
from rotcal_ros.foundation.arrays import Ints
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.escapes import printable
from rotcal_ros.foundation.language import Phrase, phrase
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.planning.table_feedback import missing_joint_message
from rotcal_ros.recordings.topics import RoleMessages

_TRACER: Final = (*STAMP, "sequence", "length", "status")
_JOINTS: Final = (*STAMP, "position", "velocity")
SLOW: Final = frozenset({
    names.PROBE_POINT, names.TEMPERATURE, names.AIR_PRESSURE, names.RELATIVE_HUMIDITY,
})  # fmt: skip
"""Roles of instruments with few messages."""
TIMED: Final = SLOW | {
    names.TRACER_LENGTH, names.JOINT_STATES, names.TABLE_ANGLE, names.PROBE_TARGET,
}  # fmt: skip
"""All roles whose order in time matters to the capture."""
SLICE_NS: Final = 1_000_000_000
"""Readings and feedback run at most this far (1 s) ahead of the other streams."""

Numbered = tuple[int, Any]
"""The row of a message in its block, and its record."""


class RecordConsumer(Protocol):
    """What StreamFeeder needs of rotcal_ros.capture.Capture."""

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


class TopicJoints:
    """Which joints a topic has, and what of the table's is missing, for words about it.

    ``joint`` is the table's; empty: the first one. Raises nothing: it only counts.
    """

    def __init__(self, joint: str) -> None:
        self._joint = joint
        self.topic = ""
        self._orders: dict[tuple[str, ...], None] = {}
        self._placed = 0

    def note(self, topic: str, listed: Sequence[str], placed: int) -> None:
        """Note messages with the same names, ``placed`` of which have an angle of the joint."""
        self.topic = topic
        if len(self._orders) < _MOST_ORDERS:
            self._orders[tuple(listed)] = None
        self._placed += placed

    def changing(self) -> str:
        """Return that the first joint is not always the same, if it stands for the table."""
        firsts = {order[0] for order in self._orders if order}
        if self._joint or len(firsts) < 2:
            return ""
        seen = "; ".join(", ".join(map(printable, order)) for order in self._orders)
        return phrase(
            "{0}: the order of its joints changes ({1}), so the first one is not always "
            "the table: set cell.joint to the table's joint", self.topic, seen
        )  # fmt: skip

    def faults(self) -> Iterator[str]:
        """Yield what keeps the table from being known to rest, as the preflight says it."""
        names_heard = [*dict.fromkeys(name for order in self._orders for name in order)]
        chosen = self._joint or next(iter(names_heard), "")
        if names_heard and chosen not in names_heard:
            yield missing_joint_message(self.topic, self._joint, names_heard)
        elif names_heard and not self._placed:
            yield phrase(
                "{0}: joint {1} has no position: publish it, in rad", self.topic, printable(chosen)
            )
        elif not self._joint and len(names_heard) > 1:
            yield phrase(
                "{0} has the joints {1}; the first one, {2}, was taken as the table: if "
                "it is another one, set cell.joint", self.topic,
                ", ".join(map(printable, names_heard)), printable(chosen)
            )  # fmt: skip


_MOST_ORDERS: Final = 8
"""Most orders of joints that are kept for words."""


class StreamFeeder:
    """Feeds blocks of messages to a capture and collects the observations.

    Tracer readings and feedback of the table go in many at once, so they run ahead of the other
    streams, by ``slice_ns`` of their stamps at most; as long as that is well within the clock
    tolerance, the capture's answer does not depend on it. ``make`` returns a new capture for the
    run with a number. ``joint`` names the table among the joint states; empty means the first.
    ``offset`` says which clocks differ by more than ``limits``, ``doubt`` which seem to differ by
    less, ``offsets`` what the bag shows of it at each observation. ``joints`` are those heard.
    """

    def __init__(
        self,
        make: Callable[[int], RecordConsumer],
        joint: str = "",
        make_finder: Callable[[], StepFinder] | None = None,
        topics: TopicSettings | None = None,
        slice_ns: int = SLICE_NS,
        limits: OffsetLimits | None = None,
    ) -> None:
        self._clocks = StampOffsets(limits or OffsetLimits())
        self.observations: list[Observation] = []
        self.offset: Phrase | None = None
        self.doubt: str | None = None
        self.offsets = list[Phrase | None]()
        self._make = make
        self._captures = [make(0)]
        self._joint = joint
        self.joints = TopicJoints(joint)
        self._make_finder = make_finder
        self._finder = make_finder() if make_finder is not None else None
        self._finding = False
        self._slice_ns = max(1, slice_ns)
        self._topics = topics or TopicSettings()
        self._instruments = Interpreter(self._topics, joint)
        self._orders = OrderPairing()
        self._makers: dict[str, Callable[[Any], Any]] = {
            names.TABLE_ANGLE: self._orders.table_angle,
            names.PROBE_TARGET: self._orders.probe_target,
        }

    def begin_run(self, run: int) -> None:
        """Begin with a new capture: attempts that the interrupted run left undecided stay so."""
        self._captures.append(self._make(run))
        self._instruments = Interpreter(self._topics, self._joint)
        if self._finder is not None and self._make_finder is not None:
            ordered = self._finder.ordered
            self._finder = self._make_finder()
            self._finder.ordered = ordered
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
    def _capture(self) -> RecordConsumer:
        return self._captures[-1]

    def feed(self, block: Block, parts: list[RoleMessages]) -> None:
        """Feed one block that ``parts`` splits into the topics of the cell."""
        others: list[Numbered] = []
        readings, feedback = np.zeros(0, READING), np.zeros(0, FEEDBACK)
        if self._finder is not None and any(part.role == names.PLAN for part in parts):
            self._finder.ordered = True
        self._finding |= self._finder is not None and any(
            part.role == names.PROBE_POINT and self._form(part) is not None for part in parts
        )
        for part in sorted(parts, key=lambda part: part.role != REFERENCE):
            with part.checked():
                if part.role == names.TRACER_LENGTH:
                    rows = self._readings(block, part)
                    readings = _in_file_order(readings, rows)
                    self._compare_stamps(part.role, rows, block)
                elif part.role == names.JOINT_STATES:
                    rows = self._feedback(block, part)
                    feedback = _in_file_order(feedback, rows)
                    self._compare_stamps(part.role, rows, block)
                elif part.role in self._makers or part.role in SLOW:
                    found = list(self._single(block, part))
                    others.extend(found)
                    if part.role == names.PROBE_POINT:
                        self._compare_point_stamps(found, block)
        if self._finding:  # positions of the probe come without a step
            # A position without a step belongs to the one at which the table stands just then.
            others.extend(_samples(feedback))
            feedback = feedback[:0]
        others.sort(key=lambda numbered: numbered[0])
        self._feed_slices(readings, feedback, others)
        offset = self._clocks.reason_to_reject()
        self.offset = self.offset or offset
        self.doubt = self.doubt or self._clocks.doubt()
        self.offsets += [offset] * (len(self.observations) - len(self.offsets))

    def _compare_stamps(self, role: str, records: NDArray[np.void], block: Block) -> None:
        """Compare stamps with the times at which the messages arrived."""
        arrived = block.headers["log_time"][records["row"]].astype(np.int64)
        self._clocks.note_many(role, records["stamp_ns"], arrived)

    def _compare_point_stamps(self, points: Iterable[Numbered], block: Block) -> None:
        for row, point in points:
            arrived_ns = int(block.headers["log_time"][row])
            self._clocks.note(names.PROBE_POINT, point.stamp_ns, arrived_ns)

    def _feed_slices(
        self, readings: NDArray[np.void], feedback: NDArray[np.void], others: list[Numbered]
    ) -> None:
        """Feed in file order, but readings and feedback of one slice of time at once."""
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
        if self._finder is not None:  # so that it knows where the table is when points come
            self._finder.table(*table_samples(feedback[-1:]))

    def _understood(self, record: Any) -> Iterator[Any]:
        """Yield the records for the capture; a foreign position becomes the step it stands at."""
        if self._finder is not None:
            yield from self._finder.understood(record)
        elif isinstance(record, Order):
            yield record.command
        elif not isinstance(record, Position):
            yield record

    def _sent_ns(self, block: Block, rows: Ints) -> Ints:
        """Return when messages were sent, or recorded if the bag does not say that."""
        sent = block.headers["publish_time"][rows].astype(np.int64)
        arrived = block.headers["log_time"][rows].astype(np.int64)
        return np.where(sent > 0, sent, arrived)

    def _numbers(self, block: Block, part: RoleMessages, form: NumericFields) -> NDArray[np.void]:
        """Return the records of a topic of plain numbers, in file order."""
        numbers, channel = (*form.numbers, *form.limits), part.decoder.channel
        found = [(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, len(numbers))))]
        unstamped = self._instruments.conventions.without_header(part.role, channel.type_name)
        if unstamped and not part.decoder.begins_with_header:
            raise BagError(unstamped)
        for columns in part.decoder.columns(block.select(part.rows), form.fields, ()):
            rows = part.rows[columns.rows]
            if lists := [name for name in numbers if columns.values[name].ndim > 1]:
                raise BagError(
                    f"topic {channel.topic}: {lists[0]} is a list of numbers: say which of them "
                    f"in the group topics, as {lists[0]}.0 for the first"
                )
            values = np.column_stack([columns.values[name] for name in numbers])
            stamps = columns.stamp_ns() if form.stamped else self._sent_ns(block, rows)
            found.append((rows, stamps, values.astype(np.float64)))
        rows, stamps, values = (np.concatenate(parts) for parts in zip(*found, strict=True))
        order = np.argsort(rows, kind="stable")
        sent = self._sent_ns(block, rows[order])
        return self._instruments.bare(part.role, rows[order], stamps[order], sent, values[order])

    def _converted(
        self, block: Block, part: RoleMessages, rows: NDArray[np.void]
    ) -> NDArray[np.void]:
        """Return records (n,) of a role's own type in SI, by the common clock, in file order."""
        rows = rows[np.argsort(rows["row"], kind="stable")]
        conventions = self._instruments.conventions
        sent = self._sent_ns(block, rows["row"])
        rows["stamp_ns"] = conventions.measured_at_ns(part.role, rows["stamp_ns"], sent)
        for name, convert in (
            ("length", conventions.length),
            ("angle", conventions.angle),
            ("velocity", conventions.angle),
        ):
            if name in (rows.dtype.names or ()):
                rows[name] = convert(rows[name])
        return rows

    def _form(self, part: RoleMessages) -> NumericFields | None:
        conventions = self._instruments.conventions
        return conventions.form(part.role, part.decoder.channel.type_name)

    def _readings(self, block: Block, part: RoleMessages) -> NDArray[np.void]:
        """Return the tracer readings of a block in file order."""
        form = self._form(part)
        if form is not None:
            return self._numbers(block, part, form)
        shapes = part.decoder.columns(block.select(part.rows), _TRACER, ())
        found = [np.zeros(0, READING), *(_readings_of(columns, part) for columns in shapes)]
        return self._converted(block, part, np.concatenate(found))

    def _feedback(self, block: Block, part: RoleMessages) -> NDArray[np.void]:
        """Return the feedback of the table in a block in file order."""
        form = self._form(part)
        if form is not None:
            return self._numbers(block, part, form)
        found = [np.zeros(0, FEEDBACK)]
        for columns in part.decoder.columns(block.select(part.rows), _JOINTS, ("name",)):
            listed = columns.layout.texts.get("name", [])
            index = records.joint_index(listed, self._joint)
            position, velocity = columns.values["position"], columns.values["velocity"]
            if index is None or index >= position.shape[1]:
                self.joints.note(part.decoder.channel.topic, listed, 0)
                continue
            rows = np.zeros(len(columns.rows), FEEDBACK)
            rows["row"], rows["stamp_ns"] = part.rows[columns.rows], columns.stamp_ns()
            rows["angle"] = position[:, index]
            rows["velocity"] = velocity[:, index] if velocity.shape[1] > index else math.nan
            self.joints.note(part.decoder.channel.topic, listed, len(rows))
            found.append(rows)
        return self._instruments.completed(self._converted(block, part, np.concatenate(found)))

    def _single(self, block: Block, part: RoleMessages) -> Iterator[Numbered]:
        """Yield the records of a slow topic, message by message."""
        type_name = part.decoder.channel.type_name
        make = self._makers.get(part.role)
        for row, message in part.messages(block):
            if make is None:
                sent_ns = int(self._sent_ns(block, np.array([row]))[0])
                record = self._instruments.record(part.role, type_name, message, sent_ns)
            else:
                record = make(message)
                record = record and Order(record, self._orders.stamp_ns)
            if record is not None:
                yield row, record


def _in_file_order(first: NDArray[np.void], second: NDArray[np.void]) -> NDArray[np.void]:
    """Return the records of two channels of one topic in the order of their rows."""
    if not len(first):
        return second
    both = np.concatenate([first, second])
    return both[np.argsort(both["row"], kind="stable")]


Ends = tuple[tuple[int, int], tuple[int, int]]
"""First and last index of readings, and of feedback."""


def _slices(
    readings: NDArray[np.void], feedback: NDArray[np.void], slice_ns: int
) -> Iterator[tuple[Ends, float]]:
    """Yield slices to feed at once, and the row from which on other messages follow."""
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
    yield from zip(feedback["row"].tolist(), table_samples(feedback.tolist()), strict=True)


def _readings_of(columns: Columns, part: RoleMessages) -> NDArray[np.void]:
    readings = np.zeros(len(columns.rows), READING)
    readings["row"] = part.rows[columns.rows]
    readings["stamp_ns"] = columns.stamp_ns()
    for name in ("sequence", "length", "status"):
        readings[name] = columns.values[name]
    return readings
