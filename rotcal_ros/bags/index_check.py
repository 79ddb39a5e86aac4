"""Checks the index of an MCAP file against its data, and the order of its records.

This package reads without the index, so a fault in it does no harm here; other programs look up
messages in it and would miss them, and readers of streams rely on the order.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
from mcap import records
from numpy.typing import NDArray

from rotcal_ros.bags import mcap_records as mcap
from rotcal_ros.bags.blocks import HEADER_TYPE, Block
from rotcal_ros.bags.framing import Record
from rotcal_ros.bags.mcap_records import ChunkRecord
from rotcal_ros.foundation.arrays import Ints

Index = (
    records.ChunkIndex | records.AttachmentIndex | records.MetadataIndex | records.SummaryOffset
)
INDEXES: Final[dict[int, type[Index]]] = {
    mcap.CHUNK_INDEX: records.ChunkIndex,
    mcap.ATTACHMENT_INDEX: records.AttachmentIndex,
    mcap.METADATA_INDEX: records.MetadataIndex,
    mcap.SUMMARY_OFFSET: records.SummaryOffset,
}
"""The records of an index, by their opcodes."""
Report = Callable[[int, str], None]
"""Called with the offset and the words of each fault."""

_BEFORE_PAYLOAD: Final = mcap.HEADER_SIZE + mcap.MESSAGE_FIXED
_MOST_FACTS: Final = 1 << 22
"""If a file has more chunks, attachments or metadata records, their index is not checked."""


class IndexCheck:
    """Compares the index with the records, which are passed to it in file order.

    ``report_order`` is called for records that are out of place: readers of streams stop there.
    """

    def __init__(self, report: Report, report_order: Report) -> None:
        self._report = report
        self._order = RecordOrder(report_order)
        self._chunk: _ChunkFacts | None = None
        self._chunks, self._attachments, self._notes = _Facts(), _Facts(), _Facts()
        self._indexes = _Facts()
        self._groups: dict[int, list[int]] = {}  # begin and end of those of a kind
        self._last_kind = 0
        self._begin: int | None = None
        self._offsets_begin: int | None = None

    def chunk(self, record: Record, chunk: ChunkRecord) -> None:
        """Add a chunk, before its messages."""
        self._chunk = _ChunkFacts(record, chunk, self._report)

    def messages(self, block: Block) -> None:
        """Add messages of the chunk."""
        if self._chunk is not None:
            self._chunk.messages(block)

    def chunk_lost(self) -> None:
        """Forget the chunk: it is damaged."""
        self._chunk = None

    def message_index(self, record: Record, channel: int, entries: memoryview) -> None:
        """Compare a message index with the chunk before it."""
        if self._chunk is not None:
            self._chunk.index(record, channel, entries)

    def passed(self, record: Record) -> None:
        """Note any record: all but a message index end the chunk and its indexes before it."""
        self._order.passed(record)
        if self._chunk is not None and record.opcode != mcap.MESSAGE_INDEX:
            chunk, self._chunk = self._chunk, None
            chunk.finish()
            self._chunks.add(chunk.record.offset, chunk.described)
            self._indexes.add(chunk.record.offset, chunk.places())

    def attachment(self, record: Record, found: records.Attachment) -> None:
        """Add an attachment."""
        times = (found.log_time, found.create_time)
        size = record.end - record.offset
        facts = (size, *times, len(found.data), found.name, found.media_type)
        self._attachments.add(record.offset, facts)

    def metadata(self, record: Record, found: records.Metadata) -> None:
        """Add a metadata record."""
        self._notes.add(record.offset, (record.end - record.offset, found.name))

    def compare(self, record: Record, index: Index, *, data_sound: bool) -> None:
        """Compare a record of the index; ``data_sound``: all data could be read."""
        match index:
            case records.SummaryOffset():
                self._summary_offset(record, index)
            case records.ChunkIndex():
                known, what, offset = self._chunks, "chunk", index.chunk_start_offset
                self._compare(known, record, what, offset, _described(index), data_sound)
                self._places(record, index)
            case records.AttachmentIndex():
                times = (index.log_time, index.create_time)
                facts = (index.length, *times, index.data_size, index.name, index.media_type)
                known, what = self._attachments, "attachment"
                self._compare(known, record, what, index.offset, facts, data_sound)
            case records.MetadataIndex():
                named = (index.length, index.name)
                known, what = self._notes, "metadata record"
                self._compare(known, record, what, index.offset, named, data_sound)

    def _places(self, record: Record, index: records.ChunkIndex) -> None:
        """Compare where the indexes behind a chunk stand, if that is said."""
        if index.message_index_offsets or index.message_index_length:
            places = (index.message_index_length, frozenset(index.message_index_offsets.items()))
            offset = index.chunk_start_offset
            if self._indexes.differs(offset, places):
                self._report(
                    record.offset, f"the positions of the indexes after chunk {offset} are wrong"
                )

    def in_summary(self, record: Record) -> None:
        """Note where a record of the summary stands."""
        if record.opcode == mcap.SUMMARY_OFFSET:
            if self._offsets_begin is None:
                self._offsets_begin = record.offset
            return
        if self._begin is None:
            self._begin = record.offset
        group = self._groups.setdefault(record.opcode, [record.offset, record.end])
        if group[1] != record.end and self._last_kind != record.opcode:
            self._report(record.offset, "the records of the summary are not grouped by kind")
        group[1], self._last_kind = record.end, record.opcode

    def _summary_offset(self, record: Record, place: records.SummaryOffset) -> None:
        """Compare the place of a group of records; writers also name groups without any."""
        begin, end = self._groups.get(place.group_opcode, [0, 0])
        if place.group_length and (place.group_start, place.group_length) != (begin, end - begin):
            self._report(record.offset, "a summary offset points to the wrong place")

    def footer(self, record: Record) -> None:
        """Compare where the footer says that the summary begins."""
        begin = int.from_bytes(record.content[:8], "little")
        offsets = int.from_bytes(record.content[8:16], "little")
        expected = self._begin if self._begin is not None else self._offsets_begin
        if begin not in ((0,) if expected is None else (expected,)):
            self._report(record.offset, "the footer points to the wrong summary")
        if offsets and offsets != (self._offsets_begin or record.offset):
            self._report(record.offset, "the footer points to the wrong summary offsets")

    def complete(self, offset: int) -> None:
        """Report, at the end of a file whose data are sound, which index is not complete."""
        parts = (
            ("chunk", self._chunks),
            ("attachment", self._attachments),
            ("metadata", self._notes),
        )
        for what, facts in parts:
            if facts.named and facts.named != len(facts):
                self._report(offset, f"{len(facts) - facts.named} {what} records have no index")

    def statistics(
        self,
        offset: int,
        stated: records.Statistics,
        counts: Mapping[int, int],
        span: tuple[int, int] | None,
        *,
        schemas: tuple[int, int],
        channels: tuple[int, int],
    ) -> None:
        """Compare the statistics of a file whose data are sound.

        ``counts`` are messages by channel, ``span`` their first and last log time (ns),
        ``schemas`` and ``channels`` how many the data define, and how many with the index.
        """
        total = sum(counts.values())
        found = {
            "messages": (stated.message_count, (total,)),
            "chunks": (stated.chunk_count, (len(self._chunks),)),
            "attachments": (stated.attachment_count, (len(self._attachments),)),
            "metadata records": (stated.metadata_count, (len(self._notes),)),
            "schemas": (stated.schema_count, schemas),
            "channels": (stated.channel_count, channels),
        }
        for what, (number, true) in found.items():
            if number not in true:
                self._report(offset, f"the statistics count {number} {what}, there are {true[0]}")
        by_channel = {n: count for n, count in stated.channel_message_counts.items() if count}
        if stated.channel_message_counts and by_channel != dict(counts):
            self._report(offset, "the statistics count other messages of a channel than there are")
        if span and span != (stated.message_start_time, stated.message_end_time):
            self._report(offset, "the times of the statistics are not those of the messages")

    def _compare(
        self,
        known: _Facts,
        record: Record,
        what: str,
        offset: int,
        facts: object,
        data_sound: bool,
    ) -> None:
        if known.differs(offset, facts):
            self._report(record.offset, f"the index of the {what} at byte {offset} is wrong")
        elif not known.name(offset) and data_sound:
            self._report(record.offset, f"an index points to byte {offset}, where no {what} is")


def _described(index: records.ChunkIndex) -> tuple[object, ...]:
    """Return what an index says of a chunk, as :class:`_ChunkFacts` does."""
    times = (index.message_start_time, index.message_end_time)
    sizes = (index.compressed_size, index.uncompressed_size)
    return (index.chunk_length, *times, index.compression, *sizes)


class _Facts:
    """The facts of all records of one kind, by offset, as hashes: 17 bytes each."""

    def __init__(self) -> None:
        self._offsets, self._hashes = array("Q"), array("q")
        self._is_named = bytearray()
        self._more = 0
        self.named = 0

    def __len__(self) -> int:
        return len(self._offsets) + self._more

    def add(self, offset: int, facts: object) -> None:
        """Add a record; they come in file order."""
        if len(self._offsets) >= _MOST_FACTS:
            self._more += 1
            return
        self._offsets.append(offset)
        self._hashes.append(hash(facts))
        self._is_named.append(0)

    def differs(self, offset: int, facts: object) -> bool:
        """Return whether the record at ``offset`` is known and differs from ``facts``."""
        place = self._place(offset)
        return place is not None and self._hashes[place] != hash(facts)

    def name(self, offset: int) -> bool:
        """Note that the index names a record; False when it is not there or named before."""
        place = self._place(offset)
        if place is None or self._is_named[place]:
            return self._more > 0
        self._is_named[place] = 1
        self.named += 1
        return True

    def _place(self, offset: int) -> int | None:
        place = bisect_left(self._offsets, offset)
        found = place < len(self._offsets) and self._offsets[place] == offset
        return place if found else None


class _ChunkFacts:
    """A chunk, its messages and the indexes after it."""

    def __init__(self, record: Record, chunk: ChunkRecord, report: Report) -> None:
        self.record = record
        size = record.end - record.offset
        packed = len(chunk.packed)
        times = (chunk.start_ns, chunk.end_ns)
        self.described = (size, *times, chunk.compression, packed, chunk.size)
        self._times = times
        self._report = report
        self._headers: list[NDArray[np.void]] = []
        self._offsets: list[Ints] = []
        self._by_channel: tuple[NDArray[np.void], Ints] | None = None
        self._indexes: dict[int, int] = {}
        self._index_bytes = 0

    def messages(self, block: Block) -> None:
        self._headers.append(block.headers)
        self._offsets.append(block.start - _BEFORE_PAYLOAD)

    def index(self, record: Record, channel: int, entries: memoryview) -> None:
        """Compare the index of one channel with its messages."""
        self._index_bytes += record.end - record.offset
        if channel in self._indexes:
            self._report(record.offset, f"channel {channel} has two indexes after a chunk")
        self._indexes[channel] = record.offset
        headers, offsets = self._sorted()
        first, last = np.searchsorted(headers["channel"], [channel, channel + 1])
        stated = np.frombuffer(entries, "<u8").reshape(-1, 2)
        if (np.diff(stated[:, 1].astype(np.int64)) < 0).any():
            stated = stated[np.argsort(stated[:, 1], kind="stable")]
        same = (
            len(stated) == last - first
            and np.array_equal(stated[:, 0], headers["log_time"][first:last])
            and np.array_equal(stated[:, 1], offsets[first:last].astype(np.uint64))
        )
        if not same:
            self._report(record.offset, f"the message index of channel {channel} is wrong")

    def finish(self) -> None:
        """Compare what is known only after the indexes."""
        if not any(len(headers) for headers in self._headers):
            return
        headers, _ = self._sorted()
        times = headers["log_time"]
        if (int(times.min()), int(times.max())) != self._times:
            self._report(self.record.offset, "the times of a chunk are not those of its messages")
        if self._indexes and (
            missing := set(np.unique(headers["channel"])) - self._indexes.keys()
        ):
            self._report(self.record.offset, f"{len(missing)} channels of a chunk have no index")

    def places(self) -> tuple[int, frozenset[tuple[int, int]]]:
        """Return the size of the indexes and where they stand, by channel."""
        return self._index_bytes, frozenset(self._indexes.items())

    def _sorted(self) -> tuple[NDArray[np.void], Ints]:
        """Return the messages by channel, in file order within one."""
        if self._by_channel is None:
            headers = np.concatenate([np.zeros(0, HEADER_TYPE), *self._headers])
            offsets = np.concatenate([np.zeros(0, np.int64), *self._offsets])
            order = np.argsort(headers["channel"], kind="stable")
            self._by_channel = headers[order], offsets[order]
        return self._by_channel


_OF_DATA: Final = (mcap.MESSAGE, mcap.CHUNK, mcap.MESSAGE_INDEX, mcap.ATTACHMENT, mcap.METADATA)
_OF_SUMMARY: Final = (
    mcap.CHUNK_INDEX,
    mcap.ATTACHMENT_INDEX,
    mcap.STATISTICS,
    mcap.METADATA_INDEX,
    mcap.SUMMARY_OFFSET,
)


class RecordOrder:
    """Reports (offset, words) of records out of place; all are passed to it in file order."""

    def __init__(self, report: Callable[[int, str], None]) -> None:
        self._report = report
        self._last = 0
        self._data_ended = False

    def passed(self, record: Record) -> None:
        """Check the next record at the top level."""
        fault = self._fault(record.opcode)
        if fault is not None:
            self._report(record.offset, fault)
        self._last = record.opcode
        self._data_ended |= record.opcode == mcap.DATA_END

    def _fault(self, opcode: int) -> str | None:
        if (opcode == mcap.HEADER) != (self._last == 0):
            return "a second header" if self._last else "the file does not begin with a header"
        if opcode == mcap.MESSAGE_INDEX and self._last not in (mcap.CHUNK, mcap.MESSAGE_INDEX):
            return "a message index without a chunk before it"
        if opcode == mcap.DATA_END and self._data_ended:
            return "a second end of the data"
        if opcode == mcap.FOOTER and not self._data_ended:
            return "the end of the data is not marked"
        if opcode in _OF_DATA and self._data_ended:
            return f"a data record {opcode} stands in the summary"
        if opcode in _OF_SUMMARY and not self._data_ended:
            return f"a summary record {opcode} stands among the data"
        return None
