"""The index at the end of an MCAP file, made again from the records before it."""

from __future__ import annotations

import time
import zlib
from collections import Counter
from dataclasses import dataclass, field
from typing import Final

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from rotcal_ros.bags import mcap_records as mcap
from rotcal_ros.bags import names
from rotcal_ros.bags.blocks import Block, split_chunk
from rotcal_ros.bags.framing import Record

PROFILE: Final = "ros2"
_MAGIC_CRC: Final = zlib.crc32(mcap.MAGIC)


@dataclass
class Contents:
    """What the index at the end of a file says: collected from its records, in one pass."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    attachments: list[AttachmentIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)
    counts: Counter[int] = field(default_factory=Counter)
    header: bool = False
    data_end: int | None = None
    crc: int = 0
    last: Block | None = None
    _last_begins: int = 0

    def take(self, record: Record) -> None:
        """Take in one top-level record; raises DamagedRecord for one that contradicts itself."""
        if self.data_end is not None:
            return
        if record.opcode == mcap.DATA_END:
            self.data_end = record.offset
            return
        head = mcap.record_header.pack(record.opcode, len(record.content))
        self.crc = zlib.crc32(record.content, zlib.crc32(head, self.crc or _MAGIC_CRC))
        length = len(head) + len(record.content)
        if record.opcode == mcap.CHUNK:
            self._chunk(record, length)
        elif record.opcode == mcap.MESSAGE_INDEX and self.chunks:
            channel, _ = mcap.parse_message_index(record.content)
            self.chunks[-1].message_index_offsets[channel] = record.offset
            self.chunks[-1].message_index_length += length
        elif record.opcode == mcap.ATTACHMENT:
            self._attachment(record.offset, length, mcap.parse_attachment(record.content))
        elif record.opcode == mcap.METADATA:
            name = mcap.parse(Metadata, record.content).name
            self.metadata.append(MetadataIndex(record.offset, length, name))
        elif record.opcode == mcap.HEADER:
            self.header = True
        elif record.opcode == mcap.MESSAGE:
            raise mcap.DamagedRecord("a message outside of chunks: not a file of this recorder")
        else:
            self._definition(record.opcode, record.content)

    def tail(self, end: int, note: Metadata, torn: bytes, library: str) -> bytes:
        """Return all that stands behind byte ``end`` of the closed file."""
        data = RecordBuilder()
        if end < len(mcap.MAGIC):
            data.write(mcap.MAGIC)
        if not self.header:
            Header(PROFILE, library).write(data)
        self._missing_indexes(data, end)
        begin = end + data.count
        note.write(data)
        self.metadata.append(MetadataIndex(begin, end + data.count - begin, note.name))
        if torn:
            now_ns = time.time_ns()
            attachment = Attachment(now_ns, now_ns, names.TORN, "application/octet-stream", torn)
            begin = end + data.count
            attachment.write(data)
            self._attachment(begin, end + data.count - begin, attachment)
        written = data.end()
        known = self.crc or (_MAGIC_CRC if end else 0)
        DataEnd(zlib.crc32(written, known)).write(data)
        return written + (ended := data.end()) + self._summary(end + len(written) + len(ended))

    def _chunk(self, record: Record, length: int) -> None:
        chunk = mcap.parse(Chunk, record.content)
        self.last, others = split_chunk(mcap.unpack_chunk(chunk))
        self._last_begins = record.offset + length
        for opcode, inner in others:
            self._definition(opcode, inner)
        self.counts.update(self.last.counts())
        self.chunks.append(
            ChunkIndex(
                message_start_time=chunk.message_start_time,
                message_end_time=chunk.message_end_time,
                chunk_start_offset=record.offset,
                chunk_length=length,
                message_index_offsets={},
                message_index_length=0,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                uncompressed_size=chunk.uncompressed_size,
            )
        )

    def _definition(self, opcode: int, content: bytes) -> None:
        if opcode == mcap.SCHEMA:
            schema = mcap.parse(Schema, content)
            self.schemas.setdefault(schema.id, schema)
        elif opcode == mcap.CHANNEL:
            channel = mcap.parse(Channel, content)
            self.channels.setdefault(channel.id, channel)

    def _attachment(self, offset: int, length: int, attachment: Attachment) -> None:
        self.attachments.append(
            AttachmentIndex(
                offset=offset,
                length=length,
                create_time=attachment.create_time,
                log_time=attachment.log_time,
                data_size=len(attachment.data),
                name=attachment.name,
                media_type=attachment.media_type,
            )
        )

    def _missing_indexes(self, data: RecordBuilder, end: int) -> None:
        """Write the message indexes that the interruption kept from following the last chunk."""
        if self.last is None:
            return
        index, block = self.chunks[-1], self.last
        missing = [n for n in block.counts() if n not in index.message_index_offsets]
        if not missing or self._last_begins + index.message_index_length != end:
            return
        begins = block.start - mcap.message_header.size - mcap.HEADER_SIZE
        for channel in missing:
            rows = block.headers["channel"] == channel
            times = block.headers["log_time"][rows].tolist()
            index.message_index_offsets[channel] = end + data.count
            entries = list(zip(times, begins[rows].tolist(), strict=True))
            MessageIndex(channel, entries).write(data)
        index.message_index_length += data.count

    def _summary(self, start: int) -> bytes:
        """Return summary, summary offsets, footer and magic of a file whose data end at start."""
        groups: tuple[tuple[Opcode, list[McapRecord]], ...] = (
            (Opcode.SCHEMA, [*self.schemas.values()]),
            (Opcode.CHANNEL, [*self.channels.values()]),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, [*self.chunks]),
            (Opcode.ATTACHMENT_INDEX, [*self.attachments]),
            (Opcode.METADATA_INDEX, [*self.metadata]),
        )
        summary, offsets = RecordBuilder(), []
        for opcode, records in groups:
            begin = summary.count
            for record in records:
                record.write(summary)
            if records:
                offsets.append(SummaryOffset(opcode, start + begin, summary.count - begin))
        offsets_start = start + summary.count
        for offset in offsets:
            offset.write(summary)
        text = summary.end()
        Footer(start, offsets_start, 0).write(summary)
        footer = summary.end()[:-4]
        crc = zlib.crc32(footer, zlib.crc32(text))
        return text + footer + crc.to_bytes(4, "little") + mcap.MAGIC

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self.attachments),
            channel_count=len(self.channels),
            channel_message_counts=dict(self.counts),
            chunk_count=len(self.chunks),
            message_count=sum(self.counts.values()),
            message_start_time=min((c.message_start_time for c in self.chunks), default=0),
            message_end_time=max((c.message_end_time for c in self.chunks), default=0),
            metadata_count=len(self.metadata),
            schema_count=len(self.schemas),
        )
