"""Reading one MCAP file from begin to end, tolerantly: blocks of messages and a verdict.

Yielding small blocks together: a small one costs as much as a large one.

What may be kept of a file in memory while it is read.

The schemas and channels of an MCAP file, each from the place that is to be trusted most.

The definitions in the summary of an MCAP file, read before its data.
"""

from __future__ import annotations

import re
import zlib
from collections import Counter, defaultdict
from collections.abc import Hashable, Iterator, Mapping
from enum import IntEnum
from pathlib import Path
from typing import BinaryIO, Final, TypeVar

import numpy as np
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from rotcal_ros.bags import mcap_records as mcap
from rotcal_ros.bags import names
from rotcal_ros.bags.blocks import Block, Others, block_of_contents, joined, split_chunk
from rotcal_ros.bags.definitions import ChannelDefinition, parse_definitions, schema_text
from rotcal_ros.bags.file_compression import opened
from rotcal_ros.bags.framing import Framing, Record
from rotcal_ros.bags.index_check import IndexCheck
from rotcal_ros.bags.mcap_records import DamagedRecord
from rotcal_ros.bags.message_compression import (
    declared_compression,
    decompressor,
    looks_packed,
    unpacked,
)
from rotcal_ros.bags.reading_limits import DEFAULT_LIMITS, ReadingLimits, refusal
from rotcal_ros.bags.storage_scan import Item, Scan
from rotcal_ros.bags.unpacking import Unpacker
from rotcal_ros.bags.verdict import Damage, FileVerdict, State
from rotcal_ros.foundation.errors import BagError

_RUN_BYTES: Final = 1 << 20
_WHOLE: Final = re.compile(r"-?[0-9]{1,18}")
"""A count that a recorder may have written."""
_CDR: Final = "cdr"
_LARGE: Final = (mcap.MESSAGE, mcap.CHUNK, mcap.MESSAGE_INDEX, mcap.ATTACHMENT)
"""Records that hold data; the others hold texts and numbers by name."""


class McapScan(Scan):
    """One pass over an MCAP file.

    Data are read without the index; with ``check_index`` it is compared with them.
    """

    def __init__(
        self, path: Path, limits: ReadingLimits = DEFAULT_LIMITS, *, check_index: bool = False
    ) -> None:
        super().__init__(path)
        self._limits = limits
        self._check_index = check_index
        self._definitions = Definitions()
        self.channels = self._definitions.channels
        self._keeping = Keeping(limits.kept_bytes)
        self._lost: Counter[int] = Counter()
        self._unreadable: Counter[int] = Counter()
        self._statistics: tuple[int, Statistics] | None = None
        self._promised: dict[int, int] | None = None
        self._read_of_chunk: Counter[int] | None = None
        self._index_awaited = False
        self._loss_unknown = False
        self._size = 0
        self._damages: list[Damage] = []
        self._index_faults: list[Damage] = []
        self._truncated: int | None = None

    def blocks(self) -> Iterator[Block]:
        """Yield the readable messages in file order; raises BagError when unreadable at all."""
        return (item for item in self.items() if isinstance(item, Block))

    def items(self) -> Iterator[Item]:
        """Yield messages, attachments and metadata in file order; raises as :meth:`blocks`."""
        self._require_known_compression()
        try:
            with opened(self.path, self._limits) as file:
                self._size = self.path.stat().st_size
                size = file.seek(0, 2)
                self._unpacker = Unpacker(self._limits, self._size)
                self._framing = Framing(file, size, self._limits.record_bytes)
                report = self._framing.index_fault, self._framing.damage
                self._index = IndexCheck(*report) if self._check_index else None
                self._read_summary(file, size)
                yield from self._items(self._framing)
        except OSError as error:
            raise BagError(f"cannot read {self.path}: {error.strerror or error}") from error

    def verdict(self) -> FileVerdict:
        """Return the verdict on the file, after the iteration."""
        damages = sorted(self._damages, key=lambda damage: damage.offset)
        index_faults = sorted(self._index_faults, key=lambda damage: damage.offset)
        state: State = "damaged" if damages else "index wrong" if index_faults else "complete"
        if self._truncated is not None:
            state = state if damages else "truncated"
            damages.append(Damage(self._truncated, "the file ends without its closing records"))
        damages += index_faults
        lost = self._lost if self._promised is None else self._missing(self._promised)
        start_ns, end_ns = self._span or (None, None)
        return FileVerdict(
            path=self.path,
            size=self._size,
            state=state,
            damages=tuple(damages),
            topics=self._topics(lost + self._unreadable),
            start_ns=start_ns,
            end_ns=end_ns,
            lost_exactly=self._promised is not None or not self._loss_unknown,
            losses_recorded=_integers(self.metadata.get(names.LOSSES, {})),
            run=_integers(self.metadata.get(names.RUN, {})).get("number", 0),
            dropouts=tuple(self._dropouts.found),
            notes=self.metadata,
        )

    def _require_known_compression(self) -> None:
        try:
            decompressor(*declared_compression(self.path))
        except BagError as error:
            raise BagError(f"cannot read {self.path}: {error}") from None

    def _items(self, framing: Framing) -> Iterator[Item]:
        run: list[Record] = []
        run_size = 0
        held = Held()
        for record in framing.records():
            self.position = min(record.offset, self._size)
            if record.opcode not in (mcap.CHUNK, mcap.MESSAGE_INDEX):
                yield from self._readable(held.released())  # it may speak of what comes after it
            if record.opcode == mcap.MESSAGE and record.content:
                run.append(record)
                run_size += len(record.content)
            if run and (record.opcode != mcap.MESSAGE or run_size > _RUN_BYTES):
                yield from self._readable((self._block_of_run(run),))
                run, run_size = [], 0
            try:
                for item in self._take(record):
                    if isinstance(item, Block):
                        yield from self._readable(held.grown(item))
                    else:
                        yield item
            except (mcap.DamagedRecord, BagError) as fault:
                framing.reject(record, str(fault))
        yield from self._readable(held.released())
        if run:
            yield from self._readable((self._block_of_run(run),))
        self._conclude(framing)

    def _block_of_run(self, run: list[Record]) -> Block:
        """Return the block of messages that stand outside chunks."""
        block = block_of_contents([record.content for record in run])
        self._require_defined(run[0].offset, block, {})
        return block

    def _take(self, record: Record) -> Iterator[Item]:
        """Take in one top-level record; yields what it holds."""
        opcode, content = record.opcode, record.content
        self._admit(record)
        if opcode == mcap.CHUNK:
            yield from self._chunk(record)
        elif opcode == mcap.MESSAGE_INDEX:
            self._message_index(record)
        elif opcode == mcap.ATTACHMENT:
            yield self._attachment(record)
        elif opcode == mcap.METADATA:
            yield self._metadata(record)
        elif opcode in (mcap.SCHEMA, mcap.CHANNEL):
            trust = None if self._framing.in_summary else Trust.PLAIN_DATA
            self._framing.settle(record, self._define(record, opcode, content, trust))
        elif opcode == mcap.HEADER:
            self._framing.settle(record, mcap.parse(Header, content)[1])
        else:
            self._take_index(record)

    def _admit(self, record: Record) -> None:
        """Take note of a record; raises DamagedRecord where it is larger than is allowed."""
        opcode = record.opcode
        if opcode == mcap.CHUNK:
            self._loss_unknown |= self._index_awaited
            self._read_of_chunk, self._index_awaited = Counter(), True
        if self._index is not None:
            self._index.passed(record)
            if self._framing.in_summary and opcode not in (mcap.DATA_END, mcap.FOOTER):
                self._index.in_summary(record)
        if record.size and not record.content:
            self._loss_unknown |= opcode == mcap.MESSAGE
            what = f"a record has {record.size} bytes"
            raise mcap.DamagedRecord(refusal(what, "record_bytes", record.size))
        if opcode not in _LARGE:
            self._keeping.admit(record.content)

    def _chunk(self, record: Record) -> Iterator[Block]:
        chunk, end = mcap.parse_chunk(record.content)
        self._framing.settle(record, end)
        data = self._unpacker.chunk(chunk)
        trust = Trust.CHECKED_DATA if chunk.crc else Trust.PLAIN_DATA
        if self._index is not None:
            self._index.chunk(record, chunk)
        try:
            for block, others in split_chunk(data, self._limits.other_records):
                new = self._define_all(record, others, trust)
                self._require_defined(record.offset, block, new)
                if self._index is not None:
                    self._index.messages(block)
                if self._read_of_chunk is not None:
                    self._read_of_chunk.update(block.counts())
                yield block
        except mcap.DamagedRecord:
            if self._index is not None:
                self._index.chunk_lost()
            raise
        self._read_of_chunk, self._index_awaited = None, False

    def _define_all(self, record: Record, others: Others, trust: Trust) -> dict[int, int]:
        """Take the definitions of a chunk; returns where those of new channels begin."""
        places: dict[int, int] = {}
        for place, opcode, content in others:
            if opcode in (mcap.SCHEMA, mcap.CHANNEL):
                before = len(self._definitions.from_data)
                self._define(record, opcode, content, trust)
                if len(self._definitions.from_data) > before:
                    places[int.from_bytes(content[:2], "little")] = place
            elif opcode <= mcap.DATA_END:
                self._framing.damage(record.offset, f"a chunk holds a record {opcode}")
        return places

    def _require_defined(self, offset: int, block: Block, new: dict[int, int]) -> None:
        """Report messages that stand before their channel; ``new``: where channels begin."""
        known, numbers = self._definitions.from_data, block.counts().keys()
        channel = block.headers["channel"]
        late = {n for n in numbers & new.keys() if block.start[np.argmax(channel == n)] < new[n]}
        for number in (numbers - known) | late:
            what = f"messages of channel {number} stand before its definition"
            self._framing.damage(offset, what)
            known.add(number)

    def _message_index(self, record: Record) -> None:
        channel, entries, end = mcap.parse_message_index(record.content)
        self._framing.settle(record, end)
        if self._index is not None:
            self._index.message_index(record, channel, entries)
        if self._read_of_chunk is not None:
            self._lost[channel] += max(0, len(entries) // 16 - self._read_of_chunk[channel])
            self._index_awaited = False

    def _take_index(self, record: Record) -> None:
        """Take a record of the summary, or one that is not known here."""
        opcode, content, index = record.opcode, record.content, self._index
        clean = self._framing.data_sound
        if opcode == mcap.STATISTICS:
            statistics, end = mcap.parse_mapping(Statistics, opcode, content)
            self._framing.settle(record, end)
            if self._statistics is not None:
                raise mcap.DamagedRecord("there are two statistics")
            self._statistics = record.offset, statistics
        elif index is None:
            return
        elif opcode == mcap.CHUNK_INDEX:
            chunk, end = mcap.parse_mapping(ChunkIndex, opcode, content)
            self._framing.settle(record, end)
            index.chunk_index(record, chunk, clean=clean)
        elif opcode == mcap.ATTACHMENT_INDEX:
            attachment, end = mcap.parse(AttachmentIndex, content)
            self._framing.settle(record, end)
            index.attachment_index(record, attachment, clean=clean)
        elif opcode == mcap.METADATA_INDEX:
            metadata, end = mcap.parse(MetadataIndex, content)
            self._framing.settle(record, end)
            index.metadata_index(record, metadata, clean=clean)
        elif opcode == mcap.SUMMARY_OFFSET:
            place, end = mcap.parse(SummaryOffset, content)
            self._framing.settle(record, end)
            index.summary_offset(record, place)
        elif opcode == mcap.FOOTER:
            index.footer(record)

    def _attachment(self, record: Record) -> Attachment:
        attachment, end = mcap.parse_attachment(record.content)
        self._framing.settle(record, end)
        if self._index is not None:
            self._index.attachment(record, attachment)
        name = attachment.name
        earlier = self.attachments.get(name, attachment)
        changed = earlier.data != attachment.data
        if changed and self._keeping.has_room(("replaced", name), len(earlier.data)):
            self.replaced[name] = earlier
        if self._keeping.has_room(("attachment", name), len(attachment.data)):
            self.attachments[name] = attachment
        if name == names.DEFINITIONS:
            for channel in parse_definitions(attachment.data):
                self._definitions.add_copy(channel)
        return attachment

    def _metadata(self, record: Record) -> Metadata:
        metadata, end, fault = mcap.parse_texts(Metadata, record.content)
        self._framing.settle(record, end)
        if fault:
            self._framing.damage(record.offset, fault)
        if self._index is not None:
            self._index.metadata(record, metadata)
        self._keeping.add(("metadata", metadata.name), cost_of_texts(metadata.metadata))
        self.metadata[metadata.name] = metadata.metadata
        return metadata

    def _define(self, record: Record, opcode: int, content: bytes, trust: Trust | None) -> int:
        """Take a schema or channel, without ``trust`` not at all; returns where its fields end."""
        found: Schema | Channel
        fault = ""
        self._keeping.admit(content)
        if opcode == mcap.SCHEMA:
            schema, end = mcap.parse(Schema, content)
            found, cost = schema, len(schema.data)
        else:
            channel, end, fault = mcap.parse_texts(Channel, content)
            found, cost = channel, cost_of_texts(channel.metadata)
        if trust is not None:
            self._keeping.add((opcode, found.id, trust), cost)
            for what in filter(None, (fault, self._definitions.add(found, trust))):
                self._framing.damage(record.offset, what)
        return end

    def _readable(self, blocks: tuple[Block, ...]) -> Iterator[Block]:
        """Count the messages and yield those of known channels, as they were published."""
        for block in blocks:
            numbers = block.counts()
            missing = numbers.keys() - self.channels.keys()
            unknown = {number for number in missing if not self._definitions.recover(number)}
            if unknown:
                self._lost.update({n: numbers[n] for n in unknown})
                block = block.select(~np.isin(block.headers["channel"], list(unknown)))
            if len(block):
                self._count(block)
                yield from self._plain(block)

    def _plain(self, block: Block) -> Iterator[Block]:
        """Yield ``block``, unpacked where rosbag2 has packed message by message."""
        encoding = self.channels[int(block.headers["channel"][0])].message_encoding
        if encoding != _CDR or not looks_packed(block.payload(0)):
            yield block
            return
        broken = Counter[int]()
        yield from unpacked(block, self._unpacker.message, broken)
        if broken:
            self._unreadable += broken
            self._counts -= broken
            self._framing.damage(self.position, f"{broken.total()} packed messages are broken")

    def _conclude(self, framing: Framing) -> None:
        if framing.damages and self.position == 0:
            raise BagError(f"{self.path} is no MCAP file: nothing in it can be read")
        self._truncated = framing.truncated
        self._loss_unknown |= (
            self._index_awaited or framing.skipped or (framing.truncated is not None)
        )
        if self._index is not None and framing.data_sound and framing.truncated is None:
            self._index.complete(self.position)
        with_index = self._definitions.with_index()
        self._definitions.recover_all(trusted=bool(framing.damages))
        if self._statistics is not None and framing.summary_sound:
            self._compare_statistics(framing, *self._statistics, with_index)
        self._damages, self._index_faults = framing.damages, framing.index_faults

    def _compare_statistics(
        self, framing: Framing, offset: int, stated: Statistics, with_index: tuple[int, int]
    ) -> None:
        """Judge what is missing by the statistics, or by sound data that these are wrong."""
        if not framing.data_proven and (stated.channel_message_counts or not stated.message_count):
            self._promised = stated.channel_message_counts
        if not framing.data_sound:
            return
        if self._index is not None:
            counts = self._counts + self._unreadable
            data = len(self._definitions.schema_ids), len(self._definitions.from_data)
            self._index.statistics(
                offset, stated, counts, self._span,
                schemas=(data[0], with_index[0]), channels=(data[1], with_index[1]),
            )  # fmt: skip
        promised = self._promised or {}
        if not framing.damages and (self._missing(promised) or promised.keys() - self.channels):
            framing.damage(0, "fewer messages than the index of the file promises")

    def _missing(self, promised: dict[int, int]) -> Counter[int]:
        return Counter(promised) - self._counts - self._unreadable

    def _read_summary(self, file: BinaryIO, size: int) -> None:
        """Take schemas and channels from the index of a complete file, if it has any."""
        for record, checked in summary_definitions(file, size, self._limits.record_bytes):
            trust = Trust.CHECKED_INDEX if checked else Trust.PLAIN_INDEX
            try:
                self._define(record, record.opcode, record.content, trust)
            except mcap.DamagedRecord:
                continue


def _integers(texts: dict[str, str]) -> dict[str, int]:
    return {name: int(text) for name, text in texts.items() if _WHOLE.fullmatch(text)}


_JOINED_BYTES: Final = 1 << 20
"""Blocks are joined up to this size."""


class Held:
    """Blocks that wait for more; what is released keeps their order."""

    def __init__(self) -> None:
        self._blocks: list[Block] = []
        self._room = 0  # the first block goes at once: who wants no more need not wait

    def grown(self, block: Block) -> tuple[Block, ...]:
        """Take ``block``; return what has become large enough."""
        if len(block.data) >= _JOINED_BYTES:  # never copied
            return (*self.released(), *((block,) if len(block) else ()))
        self._blocks.append(block)
        self._room -= len(block.data)
        return () if self._room > 0 else self.released()

    def released(self) -> tuple[Block, ...]:
        """Return what is held as one block, if anything is."""
        if not self._blocks:
            return ()
        blocks, self._blocks, self._room = self._blocks, [], _JOINED_BYTES
        return (joined(blocks),)


_OVERHEAD: Final = 1000
"""Bytes that an entry takes beside its content, at most."""
_TEXT_OVERHEAD: Final = 150
_PARSED: Final = 4
"""Times the size of a record that it may take while it is parsed."""


class Keeping:
    """Counts the bytes of all entries; one of a known key takes the place of the earlier one."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._total = 0
        self._costs: dict[Hashable, int] = {}

    def admit(self, content: bytes) -> None:
        """Refuse a record that may take more memory than is allowed while it is parsed."""
        if len(content) > self._limit // _PARSED:
            what = f"definitions or metadata have {len(content)} bytes"
            raise DamagedRecord(refusal(what, "kept_bytes", _PARSED * len(content)))

    def has_room(self, key: Hashable, size: int) -> bool:
        """Count ``size`` bytes as kept under ``key``, unless that is too much."""
        cost = size + _OVERHEAD
        total = self._total + cost - self._costs.get(key, 0)
        if total > self._limit:
            return False
        self._total, self._costs[key] = total, cost
        return True

    def add(self, key: Hashable, size: int) -> None:
        """Count ``size`` bytes as kept under ``key``; raises DamagedRecord beyond the limit."""
        if not self.has_room(key, size):
            what = "definitions and metadata take too much memory"
            raise DamagedRecord(refusal(what, "kept_bytes", 2 * (self._total + size)))


def cost_of_texts(texts: Mapping[str, str]) -> int:
    """Return about how many bytes of memory ``texts`` take."""
    return sum(len(key) + len(value) + _TEXT_OVERHEAD for key, value in texts.items())


T = TypeVar("T", Schema, Channel)

_QOS: Final = "offered_qos_profiles"
_HASH: Final = "topic_type_hash"
_NO_SCHEMA: Final = Schema(id=0, data=b"", encoding="", name="")


class Trust(IntEnum):
    """Where a definition stands: data outrank the index, what has a checksum what has none."""

    PLAIN_INDEX = 0
    PLAIN_DATA = 1
    CHECKED_INDEX = 2
    CHECKED_DATA = 3


class Definitions:
    """Schemas and channels by id; ``channels`` holds those that the data define.

    What only the index or another copy knows is held back until :meth:`recover` needs it.
    """

    def __init__(self) -> None:
        self.channels: dict[int, ChannelDefinition] = {}
        self.schema_ids: set[int] = set()
        """Of the schemas that the data define."""
        self.from_data: set[int] = set()
        """Ids of the channels that the data define."""
        self._schemas: dict[int, tuple[Trust, Schema]] = {}
        self._records: dict[int, tuple[Trust, Channel]] = {}
        self._copies: dict[int, ChannelDefinition] = {}
        self._users: defaultdict[int, set[int]] = defaultdict(set)

    def add(self, record: Schema | Channel, trust: Trust) -> str:
        """Take a schema or channel; returns what is wrong with it, or an empty text."""
        if isinstance(record, Schema):
            return self._add_schema(record, trust)
        return self._add_channel(record, trust)

    def add_copy(self, channel: ChannelDefinition) -> None:
        """Take a channel from a copy with a checksum of its own."""
        self._copies.setdefault(channel.channel_id, channel)

    def recover(self, number: int) -> bool:
        """Take a channel that the data do not define from elsewhere; False when nobody does."""
        trust, record = self._records.get(number, (Trust.PLAIN_INDEX, None))
        if number in self._copies and trust < Trust.CHECKED_INDEX:
            self.channels[number] = self._copies[number]
        elif record is not None:
            self.channels[number] = self._resolved(record)
        return number in self.channels

    def recover_all(self, *, trusted: bool) -> None:
        """Take all channels that the data do not define; ``trusted``: with a checksum only."""
        for number, (trust, _) in self._records.items():
            if number not in self.channels and (trust >= Trust.CHECKED_INDEX or not trusted):
                self.recover(number)
        for number in self._copies.keys() - self.channels.keys():
            self.recover(number)

    def with_index(self) -> tuple[int, int]:
        """Return how many schemas and channels there are, those of the index among them."""
        return len(self._schemas), len(self._records)

    def _add_schema(self, schema: Schema, trust: Trust) -> str:
        if schema.id == 0:
            return "a schema has the id 0, which means none"
        if trust in (Trust.PLAIN_DATA, Trust.CHECKED_DATA):
            self.schema_ids.add(schema.id)
        fault = _take(self._schemas, schema, trust)
        for number in self._users[schema.id] & self.channels.keys():
            self.channels[number] = self._resolved(self._records[number][1])
        if not schema.encoding and schema.data:
            return fault or f"schema {schema.name!r} has no encoding"
        return fault

    def _add_channel(self, channel: Channel, trust: Trust) -> str:
        in_data = trust in (Trust.PLAIN_DATA, Trust.CHECKED_DATA)
        fault = _take(self._records, channel, trust)
        self._users[channel.schema_id].add(channel.id)
        if in_data:
            self.from_data.add(channel.id)
        if in_data or channel.id in self.channels:
            self.channels[channel.id] = self._resolved(self._records[channel.id][1])
        if in_data and channel.schema_id and channel.schema_id not in self.schema_ids:
            return fault or f"channel {channel.id} refers to a schema that is not there"
        return fault

    def _resolved(self, channel: Channel) -> ChannelDefinition:
        _, schema = self._schemas.get(channel.schema_id, (None, _NO_SCHEMA))
        copy = self._copies.get(channel.id)
        if schema is _NO_SCHEMA and channel.schema_id and copy and copy.topic == channel.topic:
            return copy  # the record of its schema is damaged
        known = {_QOS: "", _HASH: ""} | channel.metadata
        return ChannelDefinition(
            channel.id,
            channel.topic,
            schema.name,
            schema.encoding,
            schema_text(schema.data),
            type_hash=known.pop(_HASH),
            offered_qos=known.pop(_QOS),
            message_encoding=channel.message_encoding,
            metadata=tuple(known.items()),
        )


def _take(known: dict[int, tuple[Trust, T]], record: T, trust: Trust) -> str:
    """Keep ``record`` if none of its id is to be trusted more; say if they disagree."""
    before = known.get(record.id)
    if before is None or before[0] < trust:
        known[record.id] = trust, record
    if before is None or before[1] == record:
        return ""
    return f"two definitions of {type(record).__name__.lower()} {record.id} disagree"


_TAIL: Final = mcap.HEADER_SIZE + mcap.FOOTER_CONTENT + len(mcap.MAGIC)
_CRC_SIZE: Final = 4


def summary_definitions(file: BinaryIO, size: int, largest: int) -> Iterator[tuple[Record, bool]]:
    """Yield the schemas and channels of the summary, and whether a checksum covers them.

    A summary with a wrong checksum, or one of more than ``largest`` bytes, yields none.
    """
    if size < _TAIL:
        return
    file.seek(size - _TAIL)
    footer = file.read(_TAIL)
    start = int.from_bytes(footer[mcap.HEADER_SIZE : mcap.HEADER_SIZE + 8], "little")
    end = size - _TAIL
    sound = footer[0] == mcap.FOOTER and footer.endswith(mcap.MAGIC)
    if not sound or not 0 < start < end or end - start > largest:
        return
    file.seek(start)
    summary = file.read(end - start)
    fields = footer[: -len(mcap.MAGIC)]
    stated = int.from_bytes(fields[-_CRC_SIZE:], "little")
    if stated and stated != zlib.crc32(fields[:-_CRC_SIZE], zlib.crc32(summary)):
        return
    position = 0
    while position + mcap.HEADER_SIZE <= len(summary):
        opcode, length = mcap.record_header.unpack_from(summary, position)
        begin = position + mcap.HEADER_SIZE
        if opcode in (mcap.SCHEMA, mcap.CHANNEL):
            content = summary[begin : begin + length]
            yield Record(start + position, opcode, content, start + begin + length), stated != 0
        position = begin + length
