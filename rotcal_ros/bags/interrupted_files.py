"""Closes a file whose recorder died: what is missing is appended, no whole record changes.

The index at the end is made from the records before it. The bytes of a torn last record, which no
reader can use, stay in the file as an attachment: its first ``interrupted_at_byte`` bytes and that
attachment are the file as the interruption left it. While a file is being closed a journal lies
beside it, with which an interrupted closing is repeated.
"""

from __future__ import annotations

import json
import struct
import time
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import BinaryIO, Final

import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

from rotcal_ros.bags import names
from rotcal_ros.bags.mcap_records import (
    HEADER_SIZE,
    INDEX_ENTRY,
    MAGIC,
    parse,
    parse_message_index,
    record_header,
)
from rotcal_ros.bags.reader import bag_files, file_info, read_blocks
from rotcal_ros.bags.rosbag2_metadata import FileInfo
from rotcal_ros.bags.session_identity import file_head
from rotcal_ros.bags.storage_scan import FileVerdict
from rotcal_ros.bags.writer import LIBRARY, BagWriter
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.files import (
    remove_durably,
    replace_atomically,
    replace_tail,
    sync_file,
    write_durably,
)

JOURNAL_SUFFIX: Final = ".closing"


@dataclass(frozen=True)
class InterruptedSession:
    """What an interrupted session left: its ``files`` for the writer that continues it.

    ``session`` is its identity, empty if nothing says one. Nothing is changed before
    :meth:`close`.
    """

    files: tuple[FileInfo, ...] = ()
    session: str = ""
    open_ends: tuple[UnclosedEnd, ...] = ()

    @classmethod
    def read(cls, folder: Path) -> InterruptedSession:
        """Read the bag in ``folder``; raises BagError when there is none."""
        files = bag_files(folder)
        heads = (file_head(file) for file in files)
        session = next((head.session for head in heads if not head.is_anonymous), "")
        scans = [scan for scan, block in read_blocks(files) if block is None]
        ends = tuple(
            end for scan in scans if (end := find_unclosed_end(scan.verdict())) is not None
        )
        return cls(tuple(map(file_info, scans)), session, ends)

    def close_before(self, writer: BagWriter) -> None:
        """:meth:`close` for a writer that continues the session and watches its files."""
        self.close(writer.path.name)
        writer.watch_earlier_files()

    def close(self, continued_in: str = "") -> None:
        """Close the files that the interruption left open; the caller holds the folder's lock.

        There are two if the recorder died while it began a new file. Raises BagError if that
        fails: nothing is lost, and the next call does it again.
        """
        in_order = [file.name for file in self.files]
        following = dict(zip(in_order, [*in_order[1:], continued_in], strict=True))
        try:
            for end in self.open_ends:
                end.close(following[end.path.name])
        except OSError as error:
            raise BagError(
                f"cannot close {end.path}, which an interruption left open: "
                f"{error.strerror or error}; make room and the file writable, then go on"
            ) from error


@dataclass(frozen=True)
class UnclosedEnd:
    """An interrupted file of ``size`` bytes: whole records, then ``torn`` bytes of one."""

    path: Path
    size: int
    torn: bytes
    summary: SummarySection

    @property
    def end(self) -> int:
        """The byte at which the whole records end."""
        return self.summary.end

    def close(self, continued_in: str = "") -> None:
        """Append what is missing; ``continued_in`` is the file that continues the session, if any.

        Raises OSError when the disk fails; the next call on the same file does it again.
        """
        if self.path.stat().st_size != self.size:
            raise BagError(
                f"{self.path} has changed since it was read; end the program that writes it; "
                "nothing was done to it"
            )
        journal = _journal(self.path)
        sync_file(self.path)  # the journal relies on the bytes before it
        if not journal.exists():
            head = json.dumps({"end": self.end}).encode() + b"\n"
            replace_atomically(journal, lambda path: write_durably(path, head + self.torn))
        tail = self.summary.tail(self._note(continued_in), self.torn, LIBRARY)
        replace_tail(self.path, self.end, tail)
        remove_durably(journal)

    def _note(self, continued_in: str) -> records.Metadata:
        return records.Metadata(
            name=names.CONTINUED,
            metadata={
                **({"in": continued_in} if continued_in else {}),
                "interrupted_at_byte": str(self.end),
                "torn_bytes": str(len(self.torn)),
                "closed": f"{datetime.now(timezone.utc):%Y-%m-%dT%H:%M:%SZ}",
            },
        )


def find_unclosed_end(verdict: FileVerdict) -> UnclosedEnd | None:
    """Return how an interrupted file is closed; None when it is closed, or damaged.

    A damaged file is left as it is, and so is one that no recorder of ours wrote.
    """
    path = verdict.path
    journal = _journal(path)
    if verdict.state != "truncated":
        if verdict.state == "complete":
            remove_durably(journal)
        return None
    begun = _read_journal(journal)
    with path.open("rb") as file:
        summary = SummarySection.of(file, begun[0] if begun else verdict.damages[0].offset)
        file.seek(summary.end)
        torn = begun[1] if begun else file.read()
    return UnclosedEnd(path, path.stat().st_size, torn, summary) if summary.like_ours else None


def _journal(path: Path) -> Path:
    return path.with_name(path.name + JOURNAL_SUFFIX)


def _read_journal(journal: Path) -> tuple[int, bytes] | None:
    """Return, after an interrupted closing, where the data end and the torn bytes after them."""
    if not journal.is_file():
        return None
    head, _, torn = journal.read_bytes().partition(b"\n")
    return int(json.loads(head)["end"]), torn


PROFILE: Final = "ros2"
_MESSAGE: Final = struct.Struct("<HIQ")
"""Fields of a message: channel, sequence and log time."""


def _built(builder: RecordBuilder) -> bytes:
    """Return what was written so far and empty the builder."""
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


def _records_in(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, begin and length of the content of every record in an unpacked chunk."""
    position, unpack = 0, record_header.unpack_from
    while position < len(data):
        opcode, length = unpack(data, position)
        yield opcode, position + HEADER_SIZE, length
        position += HEADER_SIZE + length


@dataclass
class SummarySection:
    """The index at the end of a file, collected from its records in one pass.

    It is for files of our recorder whose records are sound: all messages are in chunks.
    ``like_ours`` is False for any other file.
    """

    schemas: dict[int, records.Schema] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)
    chunks: list[records.ChunkIndex] = field(default_factory=list)
    attachments: list[records.AttachmentIndex] = field(default_factory=list)
    metadata: list[records.MetadataIndex] = field(default_factory=list)
    counts: Counter[int] = field(default_factory=Counter)
    end: int = 0
    header: bool = False
    like_ours: bool = True
    _crc: int = 0
    _last_chunk: bytes = b""

    @classmethod
    def of(cls, file: BinaryIO, end: int) -> SummarySection:
        """Collect from the data section of ``file``; its whole records end at byte ``end``."""
        summary = cls()
        file.seek(0)
        summary._crc = zlib.crc32(file.read(min(end, len(MAGIC))))
        summary.end = min(end, len(MAGIC))
        while summary.end + HEADER_SIZE <= end:
            head = file.read(HEADER_SIZE)
            opcode, length = record_header.unpack(head)
            if opcode == Opcode.DATA_END:
                break
            content = file.read(length)
            summary._crc = zlib.crc32(content, zlib.crc32(head, summary._crc))
            summary._add(opcode, content)
            summary.end += HEADER_SIZE + length
        return summary

    def _add(self, opcode: int, content: bytes) -> None:
        """Add one record of the data section, which begins at ``end``."""
        length = HEADER_SIZE + len(content)
        if opcode == Opcode.CHUNK:
            self._chunk(parse(records.Chunk, content)[0], length)
        elif opcode == Opcode.MESSAGE_INDEX and self.chunks:
            channel, entries, _ = parse_message_index(content)
            self.counts[channel] += len(entries) // INDEX_ENTRY
            self.chunks[-1].message_index_offsets[channel] = self.end
            self.chunks[-1].message_index_length += length
        elif opcode == Opcode.ATTACHMENT:
            self._attachment(self.end, length, parse(records.Attachment, content)[0])
        elif opcode == Opcode.METADATA:
            name = parse(records.Metadata, content)[0].name
            self.metadata.append(records.MetadataIndex(self.end, length, name))
        elif opcode == Opcode.HEADER:
            self.header = True
        else:
            self.like_ours = False

    def tail(self, note: records.Metadata, torn: bytes, library: str) -> bytes:
        """Return all that stands behind byte ``end`` of the closed file; call it once."""
        end, data = self.end, RecordBuilder()
        if end < len(MAGIC):
            data.write(MAGIC)
        if not self.header:
            records.Header(PROFILE, library).write(data)
        self._missing_indexes(data)
        begin = end + data.count
        note.write(data)
        self.metadata.append(records.MetadataIndex(begin, end + data.count - begin, note.name))
        if torn:
            now_ns = time.time_ns()
            attachment = records.Attachment(
                now_ns, now_ns, names.TORN, "application/octet-stream", torn
            )
            begin = end + data.count
            attachment.write(data)
            self._attachment(begin, end + data.count - begin, attachment)
        written = _built(data)
        records.DataEnd(zlib.crc32(written, self._crc)).write(data)
        return written + (ended := _built(data)) + self._summary(end + len(written) + len(ended))

    def _chunk(self, chunk: records.Chunk, length: int) -> None:
        packed = chunk.compression == "zstd"
        self.like_ours &= packed or not chunk.compression
        self._last_chunk = chunk.data
        if packed:
            self._last_chunk = zstandard.decompress(chunk.data, chunk.uncompressed_size)
        for opcode, begin, size in _records_in(self._last_chunk):
            if opcode == Opcode.SCHEMA:
                schema = parse(records.Schema, self._last_chunk[begin : begin + size])[0]
                self.schemas.setdefault(schema.id, schema)
            elif opcode == Opcode.CHANNEL:
                channel = parse(records.Channel, self._last_chunk[begin : begin + size])[0]
                self.channels.setdefault(channel.id, channel)
        self.chunks.append(
            records.ChunkIndex(
                message_start_time=chunk.message_start_time,
                message_end_time=chunk.message_end_time,
                chunk_start_offset=self.end,
                chunk_length=length,
                message_index_offsets={},
                message_index_length=0,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                uncompressed_size=chunk.uncompressed_size,
            )
        )

    def _attachment(self, offset: int, length: int, attachment: records.Attachment) -> None:
        self.attachments.append(
            records.AttachmentIndex(
                offset=offset,
                length=length,
                create_time=attachment.create_time,
                log_time=attachment.log_time,
                data_size=len(attachment.data),
                name=attachment.name,
                media_type=attachment.media_type,
            )
        )

    def _missing_indexes(self, data: RecordBuilder) -> None:
        """Write the message indexes that the interruption kept from following the last chunk."""
        if not self.chunks:
            return
        index = self.chunks[-1]
        if index.chunk_start_offset + index.chunk_length + index.message_index_length != self.end:
            return
        missing: dict[int, list[tuple[int, int]]] = {}
        for opcode, begin, _ in _records_in(self._last_chunk):
            if opcode == Opcode.MESSAGE:
                channel, _, log_time = _MESSAGE.unpack_from(self._last_chunk, begin)
                if channel not in index.message_index_offsets:
                    missing.setdefault(channel, []).append((log_time, begin - HEADER_SIZE))
        for channel, entries in missing.items():
            index.message_index_offsets[channel] = self.end + data.count
            records.MessageIndex(channel, entries).write(data)
            self.counts[channel] += len(entries)
        index.message_index_length += data.count

    def _summary(self, start: int) -> bytes:
        """Return summary, summary offsets, footer and magic of a file whose data end at start."""
        groups: tuple[tuple[Opcode, list[records.McapRecord]], ...] = (
            (Opcode.SCHEMA, [*self.schemas.values()]),
            (Opcode.CHANNEL, [*self.channels.values()]),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, [*self.chunks]),
            (Opcode.ATTACHMENT_INDEX, [*self.attachments]),
            (Opcode.METADATA_INDEX, [*self.metadata]),
        )
        summary, offsets = RecordBuilder(), []
        for opcode, group in groups:
            begin = summary.count
            for record in group:
                record.write(summary)
            if group:
                offsets.append(records.SummaryOffset(opcode, start + begin, summary.count - begin))
        offsets_start = start + summary.count
        for offset in offsets:
            offset.write(summary)
        text = _built(summary)
        records.Footer(start, offsets_start, 0).write(summary)
        # The CRC is the footer's last field and covers the summary and the footer up to there.
        footer = _built(summary)[:-4]
        crc = zlib.crc32(footer, zlib.crc32(text))
        return text + footer + crc.to_bytes(4, "little") + MAGIC

    def _statistics(self) -> records.Statistics:
        return records.Statistics(
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
