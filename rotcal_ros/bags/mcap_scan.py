"""Reading one MCAP file from begin to end, tolerantly: blocks of messages and a verdict."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Final

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
from rotcal_ros.bags.blocks import Block, Others, block_of_contents, split_chunk
from rotcal_ros.bags.definitions import parse_definitions
from rotcal_ros.bags.framing import Framing, Record
from rotcal_ros.bags.held import Held
from rotcal_ros.bags.index_check import IndexCheck
from rotcal_ros.bags.keeping import Keeping, cost_of_texts
from rotcal_ros.bags.mcap_definitions import Definitions, Trust
from rotcal_ros.bags.message_compression import (
    declared_compression,
    decompressor,
    looks_packed,
    unpacked,
)
from rotcal_ros.bags.reading_limits import DEFAULT_LIMITS, ReadingLimits, refusal
from rotcal_ros.bags.scan import Item, Scan
from rotcal_ros.bags.summary_section import summary_definitions
from rotcal_ros.bags.unpacking import Unpacker
from rotcal_ros.bags.verdict import Damage, FileVerdict, State
from rotcal_ros.bags.whole_file import opened
from rotcal_ros.errors import BagError

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
