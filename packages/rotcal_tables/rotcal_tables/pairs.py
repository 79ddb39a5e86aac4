"""Commanded and actual angles of a bag at rest, as rows of a table of deviations.

The numbers are a topic and a field of its messages each. A command that does not change for a
while is a row, if the actual angle stands still in the last part of that time.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import hypot, sqrt
from pathlib import Path
from typing import Final

import numpy as np

from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.decode import Decoder
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.other_encodings import decoder_of
from rotcal_ros.bags.reader import bag_files, read_blocks
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.units import NANOSECOND

END_MARGIN: Final = 0.1
"""Share of the time at rest that is kept from the next command, and by which an end that moves is
left: a feedback may be recorded before its command."""
_LEAST: Final = 4
"""Samples of a rest."""
_SEVERAL: Final = 10
"""Samples whose scatter a few among them, as of a move that begins, do not widen."""
_OF_MAD: Final = 1.4826
"""Standard deviations in the median absolute deviation of a normal distribution, inverse."""
_EVENER: Final = 100.0
"""Times that one series of levels is less even than another that a program has set."""
_JOINTS: Final = ("name", "joint_names")
"""Fields in which messages of ROS name their joints."""
_FAR: Final = 100.0
"""Usual distances of neighbouring samples by which places at a rest differ that are two."""
_CREEP: Final = 4.0
"""Standard deviations by which the halves of a rest may differ."""


@dataclass(frozen=True)
class TopicField:
    """A field of the messages of a topic: ``joint`` names its element by the names beside it."""

    topic: str
    field: str
    joint: str = ""

    @classmethod
    def of(cls, text: str, joint: str = "") -> TopicField:
        """Return what ``TOPIC:FIELD`` means; ConfigurationError for any other text."""
        topic, _, field = text.partition(":")
        if not (topic and field):
            raise ConfigurationError(
                f"{text!r}: expected TOPIC:FIELD, as /joint_states:position or /drive:reference"
            )
        return cls(topic, field, joint)

    @property
    def is_place(self) -> bool:
        """Whether the field is an element of a list."""
        return any(part.isdecimal() for part in self.field.split("."))

    @property
    def names(self) -> tuple[str, ...]:
        """The fields that may name the joints, the nearest first."""
        parts = self.field.split(".")[:-1]
        inside = [".".join(parts[:k]) + "." for k in range(len(parts), 0, -1)]
        return tuple(f"{prefix}{name}" for prefix in (*inside, "") for name in _JOINTS)


@dataclass
class FieldSeries:
    """What the messages of a topic say of some ``numbers``, by their times of recording (ns).

    ``without`` counts messages that give none, by reason.
    """

    numbers: TopicField
    without: Counter[str] = field(default_factory=Counter)
    _parts: list[tuple[Ints, Floats, tuple[str, ...]]] = field(default_factory=list)
    _orders: set[tuple[str, ...]] = field(default_factory=set)
    _kind: str = ""

    def take(self, decoder: Decoder, block: Block) -> None:
        """Take the messages of a block, all of this topic."""
        self._kind, before = decoder.channel.type_name, decoder.broken
        for columns in decoder.columns(block, (self.numbers.field,), self.numbers.names):
            values = columns.values[self.numbers.field]
            texts = columns.layout.texts
            listed = next((texts[name] for name in self.numbers.names if texts.get(name)), [])
            if values.ndim == 1 and len(listed) > 1:  # one of them, by its place
                self._orders |= {tuple(listed)} if self.numbers.is_place else set()
                listed = []
            elif len(listed) < values[0].size:
                listed = []  # the name of something else
            times = block.headers["log_time"][columns.rows].astype(np.int64)
            self._parts.append((times, np.asarray(values, dtype=np.float64), tuple(listed)))
        if decoder.broken > before:
            why = decoder.unreadable or f"{self.numbers.field} cannot be read as a number"
            self.without[why] += decoder.broken - before

    def series(self, topics: Collection[str]) -> tuple[Ints, Floats]:
        """Return times (n,), ascending, and numbers (n,); BagError where there are none.

        ``topics`` are those of the bag. Asks which joint is meant where there are several.
        """
        at, place = self._joint(), f"topic {self.numbers.topic}"
        if not self._parts and not self.without:
            found = ", ".join(sorted(topics)) or "none"
            raise BagError(f"no message of {self.numbers.topic} in the bag; its topics: {found}")
        taken = [(np.zeros(0, np.int64), np.zeros(0))]
        for times, values, listed in self._parts:
            if values.ndim == 1 and at in (None, *listed):
                taken.append((times, values))
                continue
            index = listed.index(at) if at in listed else 0
            if values.ndim > 1 and (at is None or at in listed) and index < values.shape[1]:
                taken.append((times, values[:, index]))
            else:
                self.without[f"no {self.numbers.field} of {at or 'any joint'}"] += len(times)
        times, values = (np.concatenate(each) for each in zip(*taken, strict=True))
        is_number = np.isfinite(values)
        if not is_number.all():
            self.without[f"{self.numbers.field} is no number"] += int(np.sum(~is_number))
        if not is_number.any():
            raise BagError(f"{place}: no message gives a number: {'; '.join(self.reasons())}")
        order = np.argsort(times[is_number], kind="stable")
        return times[is_number][order], values[is_number][order]

    def reasons(self) -> Iterator[str]:
        """Yield why messages give no number, with how many."""
        yield from (f"{why} in {n} messages" for why, n in self.without.items())

    def _joint(self) -> str | None:
        """Return the joint that is meant; None: all messages have one number alone."""
        own = self.numbers
        heard = [*dict.fromkeys(name for *_, listed in self._parts for name in listed)]
        if not all(listed for *_, listed in self._parts):
            heard = []
        width = max((values[0].size for _, values, _ in self._parts), default=1)
        kind = f"topic {own.topic}: {self._kind or 'its message'}"
        if len(self._orders) > 1:
            orders = "; ".join(sorted(", ".join(order) for order in self._orders))
            raise BagError(
                f"{kind} has its joints in changing order ({orders}), so {own.field} is not one "
                "of them: give the whole list, and say which by --joint"
            )
        if width > 1 and not heard:
            raise BagError(
                f"{kind} has {width} numbers in {own.field}, without names: say which, as "
                f"{own.topic}:{own.field}.0"
            )
        if not own.joint and len(heard) > 1:
            raise BagError(f"{kind} has {', '.join(heard)} in {own.field}: say which by --joint")
        listed = any(values.ndim > 1 for _, values, _ in self._parts)
        if own.joint and own.joint not in heard and (len(heard) > 1 or (heard and listed)):
            raise BagError(
                f"{kind} has no {own.joint} in {own.field}; it has {', '.join(heard)}: say which "
                f"by --joint, or by its place, as {own.topic}:{own.field}.0"
            )
        return own.joint if own.joint in heard else next(iter(heard), None)


@dataclass(frozen=True)
class RestPair:
    """The mean ``actual`` angle at a ``commanded`` one, and its standard uncertainty ``u``.

    ``middle_ns`` is the middle of the time that was read, ``early`` how many margins before its
    usual place that lies.
    """

    commanded: float
    actual: float
    u: float
    middle_ns: int
    early: int


@dataclass(frozen=True)
class RestSearch:
    """The rests of a bag, in the units of its fields; ``remarks`` say in words what is none."""

    found: tuple[RestPair, ...]
    remarks: tuple[str, ...]
    leads: tuple[float, ...]
    """s, by which the actual angle passes the middle between two rests before the command."""
    spacing: float
    """s between messages."""

    def require_order(self) -> None:
        """Raise BagError where commanded and actual angle seem to be exchanged.

        Commands are even or round, and come first; an encoder's counts are neither.
        """
        commanded = _unevenness([rest.commanded for rest in self.found])
        actual = _unevenness([rest.actual for rest in self.found])
        low, high = np.quantile(self.leads, [0.25, 0.75]) if self.leads else (0.0, 0.0)
        if actual >= _EVENER * commanded > 0.0 or high < -self.spacing:
            return
        is_even = commanded >= _EVENER * actual
        if not is_even and low <= self.spacing:
            return
        why = "is even, and the commanded one is not" if is_even else "changes first"
        raise BagError(
            f"the actual angle {why}: are they exchanged? Give --commanded and --actual the other "
            "way round, or --as-stated where they are right"
        )


def find_rests(
    path: Path, commanded: TopicField, actual: TopicField, rest_s: float, period: float
) -> RestSearch:
    """Return the rests of a bag.

    ``period``: by which the actual angle jumps where it wraps; 0: not known. Raises BagError for
    topics or fields that are not there, and for a jump within a rest whose period is not known.
    """
    if commanded == actual:
        raise ConfigurationError(
            f"{commanded.topic}:{commanded.field} cannot be commanded and actual angle at once"
        )
    heard, topics = _heard(bag_files(path), (commanded, actual))
    (command_ns, orders), (stamps, angles) = (own.series(topics) for own in heard)
    changes = np.flatnonzero(np.diff(orders)) + 1
    begins = [int(command_ns[k]) for k in (0, *changes.tolist())]
    levels = [float(orders[k]) for k in (0, *changes.tolist())]
    found, left_out = list[RestPair](), list[str]()
    for own in heard:
        left_out += [f"{own.numbers.topic}: {reason}" for reason in own.reasons()]
    feedback = ReportedAngles.of(stamps, angles, period)
    for (begin, end), level in zip(pairwise([*begins, int(stamps[-1]) + 1]), levels, strict=True):
        if (end - begin) * NANOSECOND < rest_s:
            continue  # on the way
        try:
            found.append(feedback.rest(level, begin, end, rest_s))
        except ValueError as error:
            lasted = (end - begin) * NANOSECOND
            left_out.append(f"commanded {level:.9g}, {lasted:.3g} s: {error}")
    leads = [
        _passed(command_ns, orders, (a, b), (a.commanded, b.commanded), 0.0)
        - _passed(stamps, angles, (a, b), (a.actual, b.actual), period)
        for a, b in pairwise(found)
    ]
    spacing = max(float(np.median(np.diff(each))) if len(each) > 1 else 0.0
                  for each in (command_ns, stamps))  # fmt: skip
    return RestSearch(
        tuple(found), tuple(left_out), tuple(lead * NANOSECOND for lead in leads),
        spacing * NANOSECOND,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class ReportedAngles:
    """Actual angles (n,) with their times (n,), ns; ``step`` is the smallest between numbers."""

    stamps: Ints
    angles: Floats
    period: float
    step: float

    @classmethod
    def of(cls, stamps: Ints, angles: Floats, period: float) -> ReportedAngles:
        """Return the angles with their smallest step."""
        steps = np.diff(np.unique(angles))
        return cls(stamps, angles, period, float(steps.min()) if len(steps) else 0.0)

    def rest(self, level: float, begin: int, end: int, rest_s: float) -> RestPair:
        """Return the rest at the end of a time (ns) in which the command stood at ``level``.

        Where it moves there, that before it. ValueError says why there is none, BagError what has
        to be said first.
        """
        margin, refused = round(END_MARGIN * rest_s / NANOSECOND), list[Exception]()
        spare = (end - begin - round(rest_s / NANOSECOND)) // margin
        for early in range(1 + min(int(spare), round(1.0 / END_MARGIN))):
            last = end - (1 + early) * margin
            first = last - round(rest_s * (1.0 - END_MARGIN) / NANOSECOND)
            inside = (self.stamps > first) & (self.stamps <= last)
            try:
                mean, u = self._mean(level, self.angles[inside])
            except (ValueError, BagError) as error:
                refused.append(error)
                continue
            return RestPair(level, mean, u, (first + last) // 2, early)
        raise refused[0]

    def _mean(self, level: float, values: Floats) -> tuple[float, float]:
        """Return the mean of a rest and its standard uncertainty; raises as :meth:`rest`."""
        if len(values) < _LEAST:
            raise ValueError(f"{len(values)} samples at its end, expected {_LEAST}")
        off = _less_turns(values - values[0], self.period)
        gaps = np.diff(np.sort(off))
        apart = float(gaps.max())
        if apart > max(0.5 * np.ptp(off), _FAR * max(float(np.median(gaps)), self.step)):
            if self.period:
                raise ValueError(f"it is in two places, {apart:.9g} apart: two sources, or a jump")
            raise BagError(
                f"at the commanded {level:.9g} the actual angle jumps by {apart:.9g} and back: "
                "say by how much it jumps where it wraps: --period"
            )
        half, rounding = len(off) // 2, self.step / sqrt(12.0)
        std = float(np.std(off, ddof=1))
        middle = _OF_MAD * float(np.median(np.abs(off - np.median(off))))
        usual = min(std, middle) if len(off) >= _SEVERAL else std
        creep = abs(float(np.mean(off[half:]) - np.mean(off[:half])))
        if creep > _CREEP * max(usual * sqrt(4.0 / len(off)), rounding):
            raise ValueError(f"it creeps by {creep:.3g}")
        # samples of a controlled axis follow each other: their mean is not surer than one of them
        return float(values[0] + np.mean(off)), hypot(std, rounding)


def _less_turns(off: Floats, period: float) -> Floats:
    """Return differences less whole periods, if there is one."""
    return off - period * np.rint(off / period) if period else off


def _passed(
    times: Ints,
    values: Floats,
    ends: tuple[RestPair, RestPair],
    levels: tuple[float, float],
    period: float,
) -> float:
    """Return when (ns) numbers come nearer to the second of two levels, between two rests."""
    first, last = np.searchsorted(times, [rest.middle_ns for rest in ends])
    off = (np.abs(_less_turns(values[first:last] - level, period)) for level in levels)
    nearer = np.flatnonzero(np.greater(*off))
    return float(times[first + nearer[0] if len(nearer) else min(last, len(times) - 1)])


def _unevenness(levels: Sequence[float]) -> float:
    """Return by what share of the smallest step others are no whole numbers of it, at most."""
    steps = np.diff(np.unique(levels))
    counts = steps / steps.min() if len(steps) else steps
    return float(np.max(np.abs(counts - np.rint(counts)), initial=1e-12))


def _heard(
    files: tuple[Path, ...], wanted: Sequence[TopicField]
) -> tuple[list[FieldSeries], set[str]]:
    """Return what a bag says of each of the numbers, and the names of its topics."""
    decoders, topics = dict[ChannelDefinition, Decoder](), set[str]()
    heard = [FieldSeries(numbers) for numbers in wanted]
    for scan, block in read_blocks(files):
        for number in () if block is None else np.unique(block.headers["channel"]).tolist():
            assert block is not None
            channel = scan.channels[number]
            topics.add(channel.topic)
            rows = np.flatnonzero(block.headers["channel"] == number)
            for own in heard:
                if channel.topic.strip("/") == own.numbers.topic.strip("/"):
                    if channel not in decoders:
                        decoders[channel] = decoder_of(channel)
                    own.take(decoders[channel], block.select(rows))
    return heard, topics


def table_lines(found: Sequence[RestPair], commanded_unit: str, actual_unit: str) -> Iterator[str]:
    """Yield the lines of a table of pairs; units in brackets at its heads."""
    yield (
        f"commanded [{commanded_unit}],actual [{actual_unit}],standard uncertainty [{actual_unit}]"
    )
    for rest in found:
        yield f"{rest.commanded!r},{rest.actual!r},{rest.u:.6g}"
