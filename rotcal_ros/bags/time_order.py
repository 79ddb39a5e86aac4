"""Finds in which order of time the messages of a bag stand, and which of their times is true.

The capture lets streams run apart by seconds, and its windows go by stamps, so the order of a file
is nearly always good as it is. It is not if topics or channels stand one after the other, as
converters and merges write them: then the messages are sorted, by

1. their log times, as long as those of each topic ascend;
2. their publish times, else the stamps in their headers, if the streams have those in common but
   hardly any log time: then the log times are those of the program that wrote the file.

If the log times of one channel go back while its numbers ascend, the clock of the recorder was
set: only the order of the file remains. Many writers do not number messages; then the stamps
decide. If they ascend, that clock was set; if they go back too, the clock of the whole machine was
set, provided that what follows covers times that were there before, else parts of the file were
exchanged.

Messages that are sorted wait in temporary files; only their times are sorted in memory.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from tempfile import TemporaryFile
from typing import IO, Any, Final

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.bags.blocks import HEADER_TYPE, Block, gather_rows
from rotcal_ros.bags.decode import Decoder
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.names import run_number
from rotcal_ros.bags.storage_scan import Scan, StorageContents
from rotcal_ros.foundation.arrays import Bools, Ints
from rotcal_ros.foundation.language import Phrase, noted, phrase

READ_BY: Final = noted("the bag is not in time order ({0}): its messages were read by {1}")
GOES_BACK: Final = noted(
    "log times go back {0} times, by up to {1:.1f} s: the recorder's clock was set, or parts of "
    "the file were exchanged; the messages were read in file order"
)

LEAST_NS: Final = 1_000_000_000
"""Smaller disorder between topics is normal."""
STANDSTILL_NS: Final = 20_000_000_000
"""A recorder that stood still writes what waited topic by topic: no warning up to this."""
LOG, PUBLISH, STAMP = range(3)
IN_WORDS: Final = (
    noted("log times"), noted("publish times"), noted("the stamps in their headers")
)  # fmt: skip
_SHARED, _APART = 0.5, 0.1
"""Share of the whole time that long streams have in common by a true and by a false clock."""
_MOST_SETS: Final = 10
"""A clock is not set more often than that while a bag is recorded."""
_STAMP_AT: Final = 4
"""Byte of a message at which its header's stamp begins: behind the four of CDR's encapsulation."""
_LARGEST: Final = (1 << 63) - 1


@dataclass(frozen=True)
class TimeOrder:
    """The order of a bag: ``sort_by`` is LOG, PUBLISH or STAMP, None if it is good as it is.

    ``back`` is how often log times of one channel go back by a second or more, ``back_ns`` how far
    at most, ``apart_ns`` how far messages follow later ones. ``doubtful``: the log times are false
    and not every stream has another time. ``rearranged``: a standstill of the recorder does not
    explain the order.
    """

    sort_by: int | None = None
    back: int = 0
    back_ns: int = 0
    apart_ns: int = 0
    doubtful: bool = False
    rearranged: bool = True

    def describe(self) -> tuple[Phrase, ...]:
        """Return what a reader of the messages should know; nothing if all is in order."""
        if self.sort_by is not None and self.rearranged:
            reason = phrase("its log times are those of the program that wrote it")
            if self.sort_by == LOG:
                reason = phrase("some stand {0:.1f} s behind later ones", self.apart_ns / 1e9)
            return (
                phrase(
                    READ_BY,
                    reason, phrase(IN_WORDS[self.sort_by])
                ),
            )  # fmt: skip
        if self.doubtful:
            return (
                phrase(
                    "the bag is not in time order, and not all of its streams have valid times: "
                    "its messages were read in file order"
                ),
            )
        if self.back:
            return (phrase(GOES_BACK, self.back, self.back_ns / 1e9),)
        return ()


@dataclass
class _Progress:
    """Progress of the three times of one channel or topic, or of all together.

    ``newest`` are the latest times so far, ``most`` how far any was behind them.
    """

    newest: Ints = field(default_factory=lambda: np.full(3, -1, np.int64))
    most: Ints = field(default_factory=lambda: np.zeros(3, np.int64))

    def take(self, times: NDArray[np.int64]) -> NDArray[np.int64]:
        """Add times (3, n), negative where unknown; return how far each is behind the newest."""
        newest = np.maximum.accumulate(np.column_stack([self.newest, times]), axis=1)
        behind = np.where(times < 0, 0, newest[:, 1:] - times)
        self.newest = newest[:, -1]
        self.most = np.maximum(self.most, behind.max(axis=1, initial=0))
        return behind


@dataclass
class _Unnumbered:
    """Steps back in the log times of a channel whose messages have no numbers.

    ``count`` is how often by a second or more, ``most_ns`` how far at most, ``small`` how often at
    all; ``with_stamps`` says that the stamps always went back with them. ``first`` and ``last``
    are the log times at which stretches without a gap begin and end, but for the last end.
    """

    count: int = 0
    most_ns: int = 0
    small: int = 0
    with_stamps: bool = True
    first: list[int] = field(default_factory=list)
    last: list[int] = field(default_factory=list)

    def take(self, times: Ints, steps: Ints, before: int) -> None:
        """Add log times and their ``steps``; the first step is from ``before``."""
        self.small += int(np.count_nonzero(steps < 0))
        if self.small <= _MOST_SETS:
            breaks = np.flatnonzero(np.abs(steps) >= LEAST_NS)
            self.first += times[breaks].tolist()
            self.last += np.where(breaks > 0, times[breaks - 1], before).tolist()

    def fall(self, by_ns: Ints, *, with_stamps: bool) -> None:
        """Add by how much they went back, and whether the stamps always did as well."""
        if len(by_ns):
            self.count += len(by_ns)
            self.most_ns = max(self.most_ns, int(by_ns.max()))
            self.with_stamps &= with_stamps

    def clock_was_set(self, newest: int) -> bool:
        """Return whether a clock was set; ``newest`` is the last log time.

        Then log times after a step back lie within stretches that were there before.
        """
        if not self.with_stamps:
            return True
        if self.small > _MOST_SETS:
            return False
        first, last = np.array(self.first), np.array([*self.last[1:], newest])
        order = np.argsort(first, kind="stable")
        overlap = np.maximum.accumulate(last[order])[:-1] - first[order][1:]
        return int(overlap.max(initial=0)) >= LEAST_NS // 2


@dataclass
class _Channel(_Progress):
    """A channel of one file, with what distinguishes a clock that was set from a sorted file."""

    part: tuple[str, int] = ("", 0)
    stamp: int = -1
    sequence: int = -1
    back: int = 0
    back_ns: int = 0
    unnumbered: _Unnumbered = field(default_factory=_Unnumbered)

    def set_back(self) -> tuple[int, int]:
        """Return how often a clock was set back, and by how much at most (ns)."""
        steps = self.unnumbered
        if not steps.count or not steps.clock_was_set(int(self.newest[LOG])):
            return self.back, self.back_ns
        return self.back + steps.count, max(self.back_ns, steps.most_ns)


@dataclass
class _Topic(_Progress):
    """A topic: first and last times, by which streams have time in common."""

    first: Ints = field(default_factory=lambda: np.full(3, _LARGEST, np.int64))
    unknown: Bools = field(default_factory=lambda: np.zeros(3, np.bool_))
    count: int = 0
    channels: set[tuple[Any, int]] = field(default_factory=set)


class TimeOrders:
    """Examines the messages in the order of the files, and judges that order."""

    def __init__(self) -> None:
        self._channels: dict[tuple[str, str, int], _Channel] = {}
        self._topics: dict[str, _Topic] = {}
        self._all = _Progress()

    def look(
        self, block: Block, rows: Iterable[tuple[Decoder, Ints]], file: str = "", run: int = 0
    ) -> None:
        """Look at the next block of a ``file`` of a ``run``; ``rows``: by channel those wanted."""
        by_channel = list(rows)
        if not by_channel:
            return
        times = np.full((3, len(block)), -1, np.int64)
        for decoder, mine in by_channel:
            times[:, mine] = times_of(block, mine, decoder)
            self._channel(decoder.channel, block.headers[mine], times[:, mine], (file, run))
        for topic in {decoder.channel.topic for decoder, _ in by_channel}:
            of_topic = [(d.channel, mine) for d, mine in by_channel if d.channel.topic == topic]
            self._topic(topic, times, of_topic)
        self._all.take(times[:, np.sort(np.concatenate([mine for _, mine in by_channel]))])

    def judged(self, tolerance_ns: int = LEAST_NS) -> TimeOrder:
        """Return the order, in which streams may be apart by ``tolerance_ns``."""
        clock = self._true_clock()
        streams = [topic for topic in self._topics.values() if topic.count > 1]
        apart = int(self._all.most[clock])
        mixed = any(len(t.channels) > 1 and t.most[clock] > 0 for t in streams)
        sets = [channel.set_back() for channel in self._channels.values()]
        back = max((count for count, _ in sets), default=0)
        back_ns = max((far for _, far in sets), default=0)
        if clock != LOG:
            lost = any(t.unknown[clock] for t in streams)
            in_channels = max((int(c.most[clock]) for c in self._channels.values()), default=0)
            if apart <= tolerance_ns and not mixed:
                return TimeOrder()
            if lost or in_channels > tolerance_ns:
                return TimeOrder(apart_ns=apart, doubtful=True)
            return TimeOrder(clock, apart_ns=apart)
        if back:
            return TimeOrder(back=back, back_ns=back_ns, apart_ns=apart)
        if apart <= tolerance_ns and not mixed:
            return TimeOrder(apart_ns=apart)
        first = min(int(topic.first[LOG]) for topic in self._topics.values())
        standstill = min(STANDSTILL_NS, (int(self._all.newest[LOG]) - first) // 3)
        return TimeOrder(LOG, apart_ns=apart, rearranged=mixed or apart > standstill)

    def _channel(
        self,
        channel: ChannelDefinition,
        headers: NDArray[np.void],
        times: NDArray[np.int64],
        part: tuple[str, int],
    ) -> None:
        key = (channel.topic, channel.type_name, channel.channel_id)
        known = self._channels.setdefault(key, _Channel())
        steps = np.diff(times[LOG], prepend=known.newest[LOG])
        numbers = np.diff(headers["sequence"].astype(np.int64), prepend=known.sequence)
        stamps = np.append(known.stamp, times[STAMP])
        falls = np.flatnonzero(steps <= -LEAST_NS)
        with_stamps = np.minimum(stamps[falls], stamps[falls + 1]) >= 0
        with_stamps &= np.abs(np.diff(stamps)[falls] - steps[falls]) < LEAST_NS
        rearranged = numbers[falls] < 0
        if len(falls) and not falls[0] and part[0] != known.part[0] and part[1] == known.part[1]:
            rearranged[0] |= with_stamps[0]
        unnumbered = ~rearranged & (numbers[falls] == 0)
        known.unnumbered.take(times[LOG], steps, int(known.newest[LOG]))
        known.unnumbered.fall(
            -steps[falls][unnumbered], with_stamps=bool(with_stamps[unnumbered].all())
        )
        set_back = ~rearranged & ~unnumbered
        known.back += int(np.count_nonzero(set_back))
        known.back_ns = max(known.back_ns, -int(steps[falls][set_back].min(initial=0)))
        known.take(times)
        known.newest[LOG], known.stamp = times[LOG, -1], times[STAMP, -1]
        known.sequence, known.part = int(headers["sequence"][-1]), part

    def _topic(
        self, name: str, times: NDArray[np.int64], parts: list[tuple[ChannelDefinition, Ints]]
    ) -> None:
        known = self._topics.setdefault(name, _Topic())
        mine = times[:, np.sort(np.concatenate([rows for _, rows in parts]))]
        known.first = np.minimum(known.first, np.where(mine < 0, _LARGEST, mine).min(axis=1))
        known.unknown |= (mine < 0).any(axis=1)
        known.count += mine.shape[1]
        known.channels |= {(channel.type_name, channel.channel_id) for channel, _ in parts}
        known.take(mine)

    def _true_clock(self) -> int:
        """Return the time that the long streams have in common; LOG in doubt."""
        for other in (PUBLISH, STAMP):
            spans = {
                name: int(t.newest[other] - t.first[other])
                for name, t in self._topics.items()
                if t.count > 1 and t.newest[other] > 0
            }
            longest = max(spans.values(), default=0)
            long = [self._topics[name] for name, span in spans.items() if 2 * span > longest]
            if len(long) < 2 or longest <= LEAST_NS:
                continue
            if _in_common(long, other) >= _SHARED and _in_common(long, LOG) < _APART:
                return other
        return LOG


def _in_common(topics: list[_Topic], clock: int) -> float:
    """Return the share of the whole time during which all topics were there."""
    first = [int(topic.first[clock]) for topic in topics]
    last = [int(topic.newest[clock]) for topic in topics]
    whole = max(last) - min(first)
    return max(0, min(last) - max(first)) / whole if whole > 0 else 0.0


def times_of(block: Block, rows: Ints, decoder: Decoder) -> NDArray[np.int64]:
    """Return log time, publish time and stamp (3, n) of messages in ns, -1 where unknown."""
    headers = block.headers[rows]
    times = np.full((3, len(rows)), -1, np.int64)
    times[LOG] = np.minimum(headers["log_time"], _LARGEST).astype(np.int64)
    sent = np.minimum(headers["publish_time"], _LARGEST).astype(np.int64)
    times[PUBLISH] = np.where(sent > 0, sent, -1)
    if decoder.begins_with_header:
        long = np.flatnonzero(block.size[rows] >= _STAMP_AT + 8)
        raw = np.frombuffer(block.data, np.uint8)
        stamps = (
            gather_rows(raw, block.start[rows[long]] + _STAMP_AT, 8).view("<u4").astype(np.int64)
        )
        stamped_ns = stamps[:, 0] * 1_000_000_000 + stamps[:, 1]
        times[STAMP, long] = np.where(stamped_ns > 0, stamped_ns, -1)
    return times


def sorted_blocks(
    blocks: Iterable[tuple[Scan, Block | None]],
    wanted: Mapping[ChannelDefinition, Decoder],
    sort_by: int,
) -> Iterator[tuple[StorageContents, Block]]:
    """Yield the messages of the ``wanted`` channels by time; ``blocks``: of :func:`read_blocks`.

    Files of one run belong together: their messages are sorted as one, and come with what is known
    of all. The log times of the blocks are the times they are sorted by.
    """
    run, group = 0, _Group(sort_by, wanted)
    for scan, block in blocks:
        before, run = run, run_number(scan.metadata, run)
        if run != before and group.scans:
            yield from group.blocks()
            group = _Group(sort_by, wanted)
        if block is None:
            group.scans.append(scan)
        else:
            group.add(scan, block)
    yield from group.blocks()


class _Group:
    """The messages of the files of one run; ``scans`` are those that were read to their ends."""

    def __init__(self, sort_by: int, wanted: Mapping[ChannelDefinition, Decoder]) -> None:
        self.scans: list[Scan] = []
        self._sorting = BlockSorter()
        self._sort_by = sort_by
        self._wanted = wanted
        self._numbers: dict[ChannelDefinition, int] = {}

    def add(self, scan: Scan, block: Block) -> None:
        numbers = block.headers["channel"]
        keys = np.full(len(block), -1, np.int64)
        headers = block.headers.copy()
        chosen = np.zeros(len(block), np.bool_)
        for number in np.unique(numbers).tolist():
            channel = scan.channels[number]
            decoder = self._wanted.get(channel)
            if decoder is None:
                continue
            rows = np.flatnonzero(numbers == number)
            keys[rows] = times_of(block, rows, decoder)[self._sort_by]
            headers["channel"][rows] = self._numbers.setdefault(channel, len(self._numbers))
            chosen[rows] = True
        if chosen.any():
            whole = Block(block.data, block.start, block.size, headers)
            self._sorting.add(whole.select(chosen), keys[chosen])

    def blocks(self) -> Iterator[tuple[StorageContents, Block]]:
        """Yield the sorted messages."""
        if not self.scans:
            return
        channels = {number: channel for channel, number in self._numbers.items()}
        together = StorageContents(self.scans[0].path, channels)
        for scan in self.scans:
            together.metadata |= scan.metadata
            together.attachments |= scan.attachments
        for block in self._sorting.blocks():
            yield together, block


_PIECE: Final = 1 << 18
"""Bytes of payloads that are put in order together."""
_ROWS: Final = 1 << 16
_ROW: Final = np.dtype(
    [("key", "<i8"), ("start", "<i8"), ("size", "<i8"), ("header", HEADER_TYPE)]
)


class BlockSorter:
    """Sorts the messages of blocks by a key that each has; those of equal key keep their order.

    The messages wait in temporary files; the sorting takes 24 bytes of memory for each.
    """

    def __init__(self) -> None:
        self._count = self._size = 0

    @cached_property
    def _rows(self) -> IO[bytes]:
        """The file of what is sorted; a bag in order needs none, and no room for it."""
        return TemporaryFile()

    @cached_property
    def _payloads(self) -> IO[bytes]:
        """The file of the messages' bytes."""
        return TemporaryFile()

    def add(self, block: Block, keys: Ints) -> None:
        """Take the messages of ``block``; ``keys`` has one time (ns) for each."""
        rows = np.zeros(len(block), _ROW)
        rows["key"], rows["start"], rows["size"] = keys, block.start, block.size
        rows["header"] = block.headers
        raw = np.frombuffer(block.data, np.uint8)
        for piece in _pieces(rows):
            payloads = _payloads(raw, piece["start"], piece["size"])
            piece["start"] = self._size + np.cumsum(piece["size"]) - piece["size"]
            self._rows.write(piece.tobytes())
            self._payloads.write(payloads)
            self._size += len(payloads)
        self._count += len(rows)

    def blocks(self) -> Iterator[Block]:
        """Yield all messages, then forget them; their log times are the keys."""
        if not self._count:
            return
        with self._rows, self._payloads:
            self._payloads.write(b"\0")  # an empty file cannot be mapped
            self._rows.flush()
            self._payloads.flush()
            rows = np.memmap(self._rows, _ROW, "r")
            raw = np.memmap(self._payloads, np.uint8, "r")
            order = np.argsort(rows["key"], kind="stable")
            for begin in range(0, len(order), _ROWS):
                for piece in _pieces(np.array(rows[order[begin : begin + _ROWS]])):
                    size, headers = piece["size"], piece["header"]
                    headers["log_time"] = np.maximum(piece["key"], 0).astype(np.uint64)
                    data = _payloads(raw, piece["start"], size)
                    yield Block(data, np.cumsum(size) - size, size, headers)


def _pieces(rows: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """Yield messages in parts of about ``_PIECE`` bytes."""
    number = np.cumsum(rows["size"]) // _PIECE
    yield from np.split(rows, np.flatnonzero(np.diff(number)) + 1)


def _payloads(raw: NDArray[np.uint8], start: Ints, size: Ints) -> bytes:
    """Return the bytes of messages one after the other."""
    shift = start - (np.cumsum(size) - size)
    return raw[np.repeat(shift, size) + np.arange(int(size.sum()))].tobytes()
