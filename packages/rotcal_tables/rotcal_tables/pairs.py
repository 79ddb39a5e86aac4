"""Commanded and actual angles of a bag at rest, as rows of a table of deviations.

The numbers are a topic and a field of its messages each. A command that does not change for a
while is a row, if the actual angle stands still in the last part of that time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import hypot, sqrt
from pathlib import Path
from typing import Final

import numpy as np

from rotcal_ros.bags.decode import Columns, Decoder
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.other_encodings import decoder_of
from rotcal_ros.bags.reader import bag_files, read_blocks
from rotcal_ros.capture.messages import joint_index
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.units import NANOSECOND

MARGIN: Final = 0.1
"""Share of the time at rest that is kept from the next command: the topics' clocks differ."""
_LEAST: Final = 4
"""Samples of a rest."""
_CREEP: Final = 4.0
"""Standard deviations by which the halves of a rest may differ."""


@dataclass(frozen=True)
class Numbers:
    """A field of the messages of a topic: ``joint`` names its element by the names beside it."""

    topic: str
    field: str
    joint: str = ""

    @classmethod
    def of(cls, text: str, joint: str = "") -> Numbers:
        """Return what ``TOPIC:FIELD`` means; ConfigurationError for any other text."""
        topic, _, field = text.partition(":")
        if not (topic and field):
            raise ConfigurationError(
                f"{text!r}: expected TOPIC:FIELD, as /joint_states:position or /drive:reference"
            )
        return cls(topic, field, joint)

    def read(self, decoder: Decoder, columns: Columns) -> Floats:
        """Return the numbers (n,); BagError where a message has several and none is named."""
        values = columns.values[self.field]
        if values.ndim == 1:
            return np.asarray(values, dtype=np.float64)
        listed = columns.layout.texts.get("name", [])
        at = joint_index(listed, self.joint) if listed and self.joint else None
        if at is None and values.shape[1] != 1:
            names = ", ".join(listed) or f"{values.shape[1]} numbers"
            raise BagError(
                f"topic {self.topic}: {decoder.channel.type_name} has {names} in {self.field}: "
                "say which by --joint"
            )
        return np.asarray(values[:, at or 0], dtype=np.float64)


@dataclass(frozen=True)
class Rest:
    """The mean ``actual`` angle at a ``commanded`` one, and its standard uncertainty ``u``."""

    commanded: float
    actual: float
    u: float


def rests(
    path: Path, commanded: Numbers, actual: Numbers, rest_s: float, period: float
) -> tuple[list[Rest], list[str]]:
    """Return the rests of a bag, in the units of its fields, and in words what is none.

    ``period``: by which the actual angle jumps where it wraps; 0: not known. Raises BagError for
    topics or fields that are not there, and for a jump within a rest whose period is not known.
    """
    (command_ns, orders), (stamps, angles) = _series(bag_files(path), (commanded, actual))
    changes = np.flatnonzero(np.diff(orders)) + 1
    begins = [int(command_ns[k]) for k in (0, *changes.tolist())]
    levels = [float(orders[k]) for k in (0, *changes.tolist())]
    found, left_out = list[Rest](), list[str]()
    steps = np.abs(np.diff(np.unique(angles)))
    step = float(steps.min()) if len(steps) else 0.0
    for (begin, end), level in zip(pairwise([*begins, int(stamps[-1]) + 1]), levels, strict=True):
        lasted = (end - begin) * NANOSECOND
        if lasted < rest_s:
            continue  # on the way
        last = end - round(MARGIN * rest_s / NANOSECOND)
        inside = (stamps > last - round(rest_s * (1.0 - MARGIN) / NANOSECOND)) & (stamps <= last)
        try:
            found.append(_rest(level, angles[inside], step, period))
        except ValueError as error:
            left_out.append(f"commanded {level:.9g}, {lasted:.3g} s: {error}")
    return found, left_out


def _rest(level: float, values: Floats, step: float, period: float) -> Rest:
    """Return one rest; ValueError says why it is none, BagError what has to be said first."""
    if len(values) < _LEAST:
        raise ValueError(f"{len(values)} samples at its end, expected {_LEAST}")
    off = values - values[0]
    if period:
        off -= period * np.rint(off / period)
    elif np.abs(np.diff(off)).max() > 0.5 * np.ptp(off) > 100.0 * np.median(np.abs(np.diff(off))):
        raise BagError(
            f"at the commanded {level:.9g} the actual angle jumps by {np.ptp(off):.9g} and back: "
            "say by how much it jumps where it wraps: --period"
        )
    half = len(off) // 2
    std = float(np.std(off, ddof=1))
    creep = abs(float(np.mean(off[half:]) - np.mean(off[:half])))
    if creep > _CREEP * max(std * sqrt(4.0 / len(off)), step / sqrt(12.0)):
        raise ValueError(f"it creeps by {creep:.3g}")
    # samples of a controlled axis follow each other: their mean is not surer than one of them
    return Rest(level, float(values[0] + np.mean(off)), hypot(std, step / sqrt(12.0)))


def _series(files: tuple[Path, ...], wanted: Sequence[Numbers]) -> list[tuple[Ints, Floats]]:
    """Return times (n,) of recording in ns, ascending, and the numbers (n,) of each field."""
    decoders, topics = dict[ChannelDefinition, Decoder](), set[str]()
    parts = [list[tuple[Ints, Floats]]() for _ in wanted]
    for scan, block in read_blocks(files):
        for number in () if block is None else np.unique(block.headers["channel"]).tolist():
            assert block is not None
            channel = scan.channels[number]
            topics.add(channel.topic)
            rows = np.flatnonzero(block.headers["channel"] == number)
            for own, numbers in zip(parts, wanted, strict=True):
                if channel.topic.strip("/") != numbers.topic.strip("/"):
                    continue
                decoder = decoders.setdefault(channel, decoder_of(channel))
                for columns in decoder.columns(block.select(rows), (numbers.field,), ("name",)):
                    times = block.headers["log_time"][rows[columns.rows]].astype(np.int64)
                    own.append((times, numbers.read(decoder, columns)))
    return [_joined(own, numbers, topics) for own, numbers in zip(parts, wanted, strict=True)]


def _joined(
    parts: Sequence[tuple[Ints, Floats]], numbers: Numbers, topics: set[str]
) -> tuple[Ints, Floats]:
    if not parts:
        raise BagError(
            f"no message of {numbers.topic} in the bag; its topics: "
            f"{', '.join(sorted(topics)) or 'none'}"
        )
    times, values = (np.concatenate(each) for each in zip(*parts, strict=True))
    keep = np.argsort(times, kind="stable")
    keep = keep[np.isfinite(values[keep])]
    return times[keep], values[keep]


def as_table(found: Sequence[Rest], commanded_unit: str, actual_unit: str) -> Iterator[str]:
    """Yield the lines of a table of pairs; units in brackets at its heads."""
    yield (
        f"commanded [{commanded_unit}],actual [{actual_unit}],standard uncertainty [{actual_unit}]"
    )
    for rest in found:
        yield f"{rest.commanded!r},{rest.actual!r},{rest.u:.6g}"
