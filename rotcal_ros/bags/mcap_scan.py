"""Reads one MCAP file from begin to end, tolerantly: blocks of messages and a verdict.

The index is not needed. Schemas and channels stand in several places of a file, each of which may
be damaged: the most trusted one counts.
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
from mcap.records import Attachment, Channel, Header, Metadata, Schema, Statistics

from rotcal_ros.bags import compression, names
from rotcal_ros.bags import mcap_records as mcap
from rotcal_ros.bags.blocks import Block, Others, block_of_contents, join_blocks, split_chunk
from rotcal_ros.bags.definitions import ChannelDefinition, parse_definitions, schema_text
from rotcal_ros.bags.framing import Framing, Record
from rotcal_ros.bags.index_check import INDEXES, IndexCheck
from rotcal_ros.bags.mcap_records import DamagedRecord, R
from rotcal_ros.bags.settings import DEFAULT_LIMITS, ReadingLimits, limit_refusal
from rotcal_ros.bags.storage_scan import Damage, FileVerdict, Item, Scan, State
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.untrusted import cause_of, open_plain

_UNCHUNKED_BYTES: Final = 1 << 20
"""Messages outside chunks are put together to blocks of this size."""
_COUNT: Final = re.compile(r"-?[0-9]{1,18}")
"""Pattern of a count that a recorder may have written."""
_CDR: Final = "cdr"
_DATA: Final = (mcap.MESSAGE, mcap.CHUNK, mcap.MESSAGE_INDEX, mcap.ATTACHMENT)
"""Records of data, which may be large; the others hold definitions, texts and numbers."""


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
        self._memory = MemoryBudget(limits.kept_bytes)
        self._lost: Counter[int] = Counter()
        self._broken: Counter[int] = Counter()
        self._statistics: tuple[int, Statistics] | None = None
        self._stated_counts: dict[int, int] | None = None
        self._chunk_counts: Counter[int] | None = None
        self._awaits_message_index = False
        self._loss_unknown = False
        self._size = 0
        self._damages: list[Damage] = []
        self._index_faults: list[Damage] = []
        self._truncated: int | None = None

    def blocks(self) -> Iterator[Block]:
        """Yield the readable messages in file order; raises BagError if nothing can be read."""
        return (item for item in self.items() if isinstance(item, Block))

    def items(self) -> Iterator[Item]:
        """Yield messages, attachments and metadata in file order; raises as :meth:`blocks`."""
        self._require_known_compression()
        try:
            with (
                compression.unpacked_storage_file(self.path, self._limits) as (plain, _),
                open_plain(plain) as file,
            ):
                self._size = self.path.stat().st_size
                size = file.seek(0, 2)
                self._unpacker = compression.Unpacker(self._limits, self._size)
                self._framing = Framing(file, size, self._limits.chunk_bytes)
                report = self._framing.index_fault, self._framing.damage
                self._index = IndexCheck(*report) if self._check_index else None
                self._define_by_summary(file, size)
                yield from self._items(self._framing)
        except OSError as error:
            raise BagError(f"cannot read {self.path}: {cause_of(error)}") from error

    def verdict(self) -> FileVerdict:
        """Return the verdict on the file, after the iteration."""
        damages = sorted(self._damages, key=lambda damage: damage.offset)
        index_faults = sorted(self._index_faults, key=lambda damage: damage.offset)
        state: State = "damaged" if damages else "index wrong" if index_faults else "complete"
        if self._truncated is not None:
            state = state if damages else "truncated"
            damages.append(Damage(self._truncated, "the file ends without its closing records"))
        damages += index_faults
        lost = self._lost if self._stated_counts is None else self._missing(self._stated_counts)
        start_ns, end_ns = self._span or (None, None)
        return FileVerdict(
            path=self.path,
            size=self._size,
            state=state,
            damages=tuple(damages),
            topics=self._topics(lost + self._broken),
            start_ns=start_ns,
            end_ns=end_ns,
            cut_off=self._framing.cut_off,
            lost_exactly=self._stated_counts is not None or not self._loss_unknown,
            losses_recorded=_integers(self.metadata.get(names.LOSSES, {})),
            run=_integers(self.metadata.get(names.RUN, {})).get("number", 0),
            dropouts=tuple(self._dropouts.found),
            notes=self.metadata,
        )

    def _require_known_compression(self) -> None:
        try:
            compression.packed_one_by_one(*compression.declared_compression(self.path))
        except BagError as error:
            raise BagError(f"cannot read {self.path}: {error}") from None

    def _items(self, framing: Framing) -> Iterator[Item]:
        unchunked: list[Record] = []
        unchunked_size = 0
        small = SmallBlocks()
        for record in framing.records():
            self.position = min(record.offset, self._size)
            if record.opcode not in (mcap.CHUNK, mcap.MESSAGE_INDEX):
                # The record may be about the messages behind it: those before it come first.
                yield from self._defined(small.rest())
            if record.opcode == mcap.MESSAGE and record.content:
                unchunked.append(record)
                unchunked_size += len(record.content)
            if unchunked and (record.opcode != mcap.MESSAGE or unchunked_size > _UNCHUNKED_BYTES):
                yield from self._defined((self._unchunked_block(unchunked),))
                unchunked, unchunked_size = [], 0
            try:
                for item in self._contents(record):
                    if isinstance(item, Block):
                        yield from self._defined(small.add_block(item))
                    else:
                        yield item
            except (mcap.DamagedRecord, BagError) as fault:
                framing.reject(record, str(fault))
        yield from self._defined(small.rest())
        if unchunked:
            yield from self._defined((self._unchunked_block(unchunked),))
        self._judge(framing)

    def _unchunked_block(self, records: list[Record]) -> Block:
        """Return the block of messages that stand outside chunks."""
        block = block_of_contents([record.content for record in records])
        self._report_undefined(records[0].offset, block, {})
        return block

    def _contents(self, record: Record) -> Iterator[Item]:
        """Read one top-level record and yield what it holds."""
        opcode, content = record.opcode, record.content
        self._note_record(record)
        if opcode == mcap.CHUNK:
            yield from self._chunk(record)
        elif opcode == mcap.MESSAGE_INDEX:
            self._message_index(record)
        elif opcode == mcap.ATTACHMENT:
            yield self._attachment(record)
        elif opcode == mcap.METADATA:
            yield self._metadata(record)
        elif opcode in (mcap.SCHEMA, mcap.CHANNEL):
            trust = None if self._framing.in_summary else DefinitionTrust.PLAIN_DATA
            self._framing.note_fields_end(record, self._define(record, opcode, content, trust))
        elif opcode == mcap.HEADER:
            self._parsed(Header, record)
        else:
            self._summary_record(record)

    def _note_record(self, record: Record) -> None:
        """Note a record, also for the index check; raises DamagedRecord if it is too large."""
        opcode = record.opcode
        if opcode == mcap.CHUNK:
            self._loss_unknown |= self._awaits_message_index
            self._chunk_counts, self._awaits_message_index = Counter(), True
        if self._index is not None:
            self._index.passed(record)
            if self._framing.in_summary and opcode not in (mcap.DATA_END, mcap.FOOTER):
                self._index.in_summary(record)
        if record.size and not record.content:
            self._loss_unknown |= opcode == mcap.MESSAGE
            what = f"a record has {record.size} bytes"
            raise mcap.DamagedRecord(limit_refusal(what, "chunk_bytes", record.size))
        if opcode not in _DATA:
            self._memory.check_record(record.content)

    def _chunk(self, record: Record) -> Iterator[Block]:
        chunk, end = mcap.parse_chunk(record.content)
        self._framing.note_fields_end(record, end)
        data = self._unpacker.chunk(chunk)
        trust = DefinitionTrust.CHECKED_DATA if chunk.crc else DefinitionTrust.PLAIN_DATA
        if self._index is not None:
            self._index.chunk(record, chunk)
        try:
            for block, others in split_chunk(data, self._limits.other_records):
                new = self._define_all(record, others, trust)
                self._report_undefined(record.offset, block, new)
                if self._index is not None:
                    self._index.messages(block)
                if self._chunk_counts is not None:
                    self._chunk_counts.update(block.counts())
                yield block
        except mcap.DamagedRecord:
            if self._index is not None:
                self._index.chunk_lost()
            raise
        self._chunk_counts, self._awaits_message_index = None, False

    def _define_all(
        self, record: Record, others: Others, trust: DefinitionTrust
    ) -> dict[int, int]:
        """Add the definitions in a chunk; return where those of new channels begin, by id."""
        begins: dict[int, int] = {}
        for begin, opcode, content in others:
            if opcode in (mcap.SCHEMA, mcap.CHANNEL):
                before = len(self._definitions.from_data)
                self._define(record, opcode, content, trust)
                if len(self._definitions.from_data) > before:
                    begins[int.from_bytes(content[:2], "little")] = begin
            elif opcode <= mcap.DATA_END:
                self._framing.damage(record.offset, f"a chunk holds a record {opcode}")
        return begins

    def _report_undefined(self, offset: int, block: Block, new: dict[int, int]) -> None:
        """Report messages that stand before their channel; ``new``: where new channels begin."""
        defined, numbers = self._definitions.from_data, block.counts().keys()
        channel = block.headers["channel"]
        late = {n for n in numbers & new.keys() if block.start[np.argmax(channel == n)] < new[n]}
        for number in (numbers - defined) | late:
            what = f"messages of channel {number} stand before its definition"
            self._framing.damage(offset, what)
            defined.add(number)

    def _message_index(self, record: Record) -> None:
        channel, entries, end = mcap.parse_message_index(record.content)
        self._framing.note_fields_end(record, end)
        if self._index is not None:
            self._index.message_index(record, channel, entries)
        if self._chunk_counts is not None:
            stated = len(entries) // mcap.INDEX_ENTRY
            self._lost[channel] += max(0, stated - self._chunk_counts[channel])
            self._awaits_message_index = False

    def _summary_record(self, record: Record) -> None:
        """Read a record of the summary, or one of an unknown kind."""
        opcode, index = record.opcode, self._index
        if opcode == mcap.STATISTICS:
            statistics = self._parsed(Statistics, record)
            if self._statistics is not None:
                raise mcap.DamagedRecord("there are two statistics")
            self._statistics = record.offset, statistics
        elif index is not None and opcode in INDEXES:
            found = self._parsed(INDEXES[opcode], record)
            index.compare(record, found, data_sound=self._framing.data_sound)
        elif index is not None and opcode == mcap.FOOTER:
            index.footer(record)

    def _parsed(self, kind: type[R], record: Record) -> R:
        """Return the fields of a record, and note where they end."""
        parsed, end = mcap.parse(kind, record.content)
        self._framing.note_fields_end(record, end)
        return parsed

    def _attachment(self, record: Record) -> Attachment:
        attachment, end = mcap.parse_attachment(record.content)
        self._framing.note_fields_end(record, end)
        if self._index is not None:
            self._index.attachment(record, attachment)
        name = attachment.name
        earlier = self.attachments.get(name, attachment)
        changed = earlier.data != attachment.data
        if changed and self._memory.reserve(("replaced", name), len(earlier.data)):
            self.replaced[name] = earlier
        if self._memory.reserve(("attachment", name), len(attachment.data)):
            self.attachments[name] = attachment
        if name == names.DEFINITIONS:
            for channel in parse_definitions(attachment.data):
                self._definitions.add_copy(channel)
        return attachment

    def _metadata(self, record: Record) -> Metadata:
        metadata, end, fault = mcap.parse_texts(Metadata, record.content)
        self._framing.note_fields_end(record, end)
        if fault:
            self._framing.damage(record.offset, fault)
        if self._index is not None:
            self._index.metadata(record, metadata)
        self._memory.require(("metadata", metadata.name), cost_of_texts(metadata.metadata))
        self.metadata[metadata.name] = metadata.metadata
        return metadata

    def _define(
        self, record: Record, opcode: int, content: bytes, trust: DefinitionTrust | None
    ) -> int:
        """Add a schema or channel, unless ``trust`` is None; return where its fields end."""
        definition: Schema | Channel
        fault: str | None = None
        self._memory.check_record(content)
        if opcode == mcap.SCHEMA:
            schema, end = mcap.parse(Schema, content)
            definition, cost = schema, len(schema.data)
        else:
            channel, end, fault = mcap.parse_texts(Channel, content)
            definition, cost = channel, cost_of_texts(channel.metadata)
        if trust is not None:
            self._memory.require((opcode, definition.id, trust), cost)
            for what in filter(None, (fault, self._definitions.add(definition, trust))):
                self._framing.damage(record.offset, what)
        return end

    def _defined(self, blocks: tuple[Block, ...]) -> Iterator[Block]:
        """Count the messages and yield those whose channel is defined, as they were published."""
        for block in blocks:
            numbers = block.counts()
            missing = numbers.keys() - self.channels.keys()
            unknown = {number for number in missing if not self._definitions.recover(number)}
            if unknown:
                self._lost.update({n: numbers[n] for n in unknown})
                block = block.select(~np.isin(block.headers["channel"], list(unknown)))
            if len(block):
                self._count(block)
                yield from self._unpacked(block)

    def _unpacked(self, block: Block) -> Iterator[Block]:
        """Yield ``block``, unpacked where rosbag2 has compressed message by message."""
        encoding = self.channels[int(block.headers["channel"][0])].message_encoding
        if encoding != _CDR or not compression.looks_packed(block.payload(0)):
            yield block
            return
        broken = Counter[int]()
        yield from self._unpacker.messages(block, broken)
        if broken:
            self._broken += broken
            self._counts -= broken
            self._framing.damage(self.position, f"{broken.total()} compressed messages are broken")

    def _judge(self, framing: Framing) -> None:
        """Conclude, at the end of the file, what is damaged and what is missing."""
        if framing.damages and self.position == 0:
            raise BagError(f"{self.path} is not an MCAP file: nothing in it can be read")
        self._truncated = framing.truncated
        self._loss_unknown |= (
            self._awaits_message_index or framing.skipped or (framing.truncated is not None)
        )
        if self._index is not None and framing.data_sound and framing.truncated is None:
            self._index.complete(self.position)
        with_summary = self._definitions.numbers()
        self._definitions.recover_all(trusted=bool(framing.damages))
        if self._statistics is not None and framing.summary_sound:
            self._compare_statistics(framing, *self._statistics, with_summary)
        self._damages, self._index_faults = framing.damages, framing.index_faults

    def _compare_statistics(
        self, framing: Framing, offset: int, stated: Statistics, with_summary: tuple[int, int]
    ) -> None:
        """Judge by the statistics what is missing, or by sound data what in them is wrong."""
        if not framing.data_proven and (stated.channel_message_counts or not stated.message_count):
            self._stated_counts = stated.channel_message_counts
        if not framing.data_sound:
            return
        if self._index is not None:
            counts = self._counts + self._broken
            data = len(self._definitions.schema_ids), len(self._definitions.from_data)
            self._index.statistics(
                offset, stated, counts, self._span,
                schemas=(data[0], with_summary[0]), channels=(data[1], with_summary[1]),
            )  # fmt: skip
        stated_counts = self._stated_counts or {}
        if not framing.damages and (
            self._missing(stated_counts) or stated_counts.keys() - self.channels
        ):
            framing.damage(0, "fewer messages than the index of the file promises")

    def _missing(self, stated_counts: dict[int, int]) -> Counter[int]:
        return Counter(stated_counts) - self._counts - self._broken

    def _define_by_summary(self, file: BinaryIO, size: int) -> None:
        """Add schemas and channels from the summary of a complete file, before its data."""
        for record, checked in summary_definitions(file, size, self._limits.chunk_bytes):
            trust = DefinitionTrust.CHECKED_INDEX if checked else DefinitionTrust.PLAIN_INDEX
            try:
                self._define(record, record.opcode, record.content, trust)
            except mcap.DamagedRecord:
                continue


def _integers(texts: dict[str, str]) -> dict[str, int]:
    return {name: int(text) for name, text in texts.items() if _COUNT.fullmatch(text)}


_JOINED_BYTES: Final = 1 << 20
"""Small blocks are joined up to this size."""


class SmallBlocks:
    """Joins small blocks in order: handling a small block costs as much as a large one."""

    def __init__(self) -> None:
        self._blocks: list[Block] = []
        self._room = 0  # the first block goes at once: some readers need no more

    def add_block(self, block: Block) -> tuple[Block, ...]:
        """Add ``block``; return what has become large enough."""
        if len(block.data) >= _JOINED_BYTES:  # never copied
            return (*self.rest(), *((block,) if len(block) else ()))
        self._blocks.append(block)
        self._room -= len(block.data)
        return () if self._room > 0 else self.rest()

    def rest(self) -> tuple[Block, ...]:
        """Return what is left as one block, if anything is."""
        if not self._blocks:
            return ()
        blocks, self._blocks, self._room = self._blocks, [], _JOINED_BYTES
        return (join_blocks(blocks),)


_OVERHEAD: Final = 1000
"""Most bytes that an entry takes besides its content."""
_TEXT_OVERHEAD: Final = 150
"""Most bytes that a text takes besides its characters."""
_PARSING_FACTOR: Final = 4
"""Parsing a record takes at most this many times its size."""


class MemoryBudget:
    """Counts the bytes in memory by key; an entry replaces the previous one of its key."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._total = 0
        self._costs: dict[Hashable, int] = {}

    def check_record(self, content: bytes) -> None:
        """Raise DamagedRecord if parsing the record may take more memory than is allowed."""
        if len(content) > self._limit // _PARSING_FACTOR:
            what = f"definitions or metadata have {len(content)} bytes"
            raise DamagedRecord(limit_refusal(what, "kept_bytes", _PARSING_FACTOR * len(content)))

    def reserve(self, key: Hashable, size: int) -> bool:
        """Count ``size`` bytes under ``key``; False, and nothing counted, beyond the limit."""
        cost = size + _OVERHEAD
        total = self._total + cost - self._costs.get(key, 0)
        if total > self._limit:
            return False
        self._total, self._costs[key] = total, cost
        return True

    def require(self, key: Hashable, size: int) -> None:
        """Count ``size`` bytes under ``key``; raises DamagedRecord beyond the limit."""
        if not self.reserve(key, size):
            what = "definitions and metadata take too much memory"
            raise DamagedRecord(limit_refusal(what, "kept_bytes", 2 * (self._total + size)))


def cost_of_texts(texts: Mapping[str, str]) -> int:
    """Return about how many bytes of memory ``texts`` take."""
    return sum(len(key) + len(value) + _TEXT_OVERHEAD for key, value in texts.items())


T = TypeVar("T", Schema, Channel)

_QOS: Final = "offered_qos_profiles"
_HASH: Final = "topic_type_hash"
_NO_SCHEMA: Final = Schema(id=0, data=b"", encoding="", name="")


class DefinitionTrust(IntEnum):
    """The place of a definition, least trusted first: a checksum counts most, then the data."""

    PLAIN_INDEX = 0
    PLAIN_DATA = 1
    CHECKED_INDEX = 2
    CHECKED_DATA = 3


class Definitions:
    """Schemas and channels by id; ``channels`` holds those that the data define.

    Those that only the summary or a copy has are used when :meth:`recover` asks for them.
    """

    def __init__(self) -> None:
        self.channels: dict[int, ChannelDefinition] = {}
        self.schema_ids: set[int] = set()
        """Ids of the schemas that the data define."""
        self.from_data: set[int] = set()
        """Ids of the channels that the data define."""
        self._schemas: dict[int, tuple[DefinitionTrust, Schema]] = {}
        self._records: dict[int, tuple[DefinitionTrust, Channel]] = {}
        self._copies: dict[int, ChannelDefinition] = {}
        self._channels_of_schema: defaultdict[int, set[int]] = defaultdict(set)

    def add(self, record: Schema | Channel, trust: DefinitionTrust) -> str | None:
        """Add a schema or channel; return what is wrong with it, None if nothing is."""
        if isinstance(record, Schema):
            return self._add_schema(record, trust)
        return self._add_channel(record, trust)

    def add_copy(self, channel: ChannelDefinition) -> None:
        """Add a channel from a copy, which has a checksum of its own."""
        self._copies.setdefault(channel.channel_id, channel)

    def recover(self, number: int) -> bool:
        """Use another definition of a channel that the data do not define; False without any."""
        trust, record = self._records.get(number, (DefinitionTrust.PLAIN_INDEX, None))
        if number in self._copies and trust < DefinitionTrust.CHECKED_INDEX:
            self.channels[number] = self._copies[number]
        elif record is not None:
            self.channels[number] = self._resolved(record)
        return number in self.channels

    def recover_all(self, *, trusted: bool) -> None:
        """Use the other definitions of all channels; ``trusted``: those with a checksum only."""
        for number, (trust, _) in self._records.items():
            if number not in self.channels and (
                trust >= DefinitionTrust.CHECKED_INDEX or not trusted
            ):
                self.recover(number)
        for number in self._copies.keys() - self.channels.keys():
            self.recover(number)

    def numbers(self) -> tuple[int, int]:
        """Return the numbers of schemas and channels in data and summary together."""
        return len(self._schemas), len(self._records)

    def _add_schema(self, schema: Schema, trust: DefinitionTrust) -> str | None:
        if schema.id == 0:
            return "a schema has the id 0, which means none"
        if trust in (DefinitionTrust.PLAIN_DATA, DefinitionTrust.CHECKED_DATA):
            self.schema_ids.add(schema.id)
        fault = _add_trusted(self._schemas, schema, trust)
        for number in self._channels_of_schema[schema.id] & self.channels.keys():
            self.channels[number] = self._resolved(self._records[number][1])
        if not schema.encoding and schema.data:
            return fault or f"schema {schema.name!r} has no encoding"
        return fault

    def _add_channel(self, channel: Channel, trust: DefinitionTrust) -> str | None:
        in_data = trust in (DefinitionTrust.PLAIN_DATA, DefinitionTrust.CHECKED_DATA)
        fault = _add_trusted(self._records, channel, trust)
        self._channels_of_schema[channel.schema_id].add(channel.id)
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


def _add_trusted(
    known: dict[int, tuple[DefinitionTrust, T]], record: T, trust: DefinitionTrust
) -> str | None:
    """Add ``record`` unless one of its id is trusted more; return where the two disagree."""
    before = known.get(record.id)
    if before is None or before[0] < trust:
        known[record.id] = trust, record
    if before is None or before[1] == record:
        return None
    return f"two definitions of {type(record).__name__.lower()} {record.id} disagree"


_TAIL: Final = mcap.HEADER_SIZE + mcap.FOOTER_CONTENT + len(mcap.MAGIC)
"""Bytes from the footer to the end of a file."""
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
    # The CRC is the footer's last field and covers summary and footer up to there; 0: none.
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
