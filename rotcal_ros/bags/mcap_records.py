"""The records of an MCAP file, parsed strictly: a field beyond its record raises DamagedRecord.

The file readers of the mcap package stop at the first fault and trust lengths, which a reader of
damaged files cannot do, so only its record classes are used. A record may be longer than its
present fields: :func:`parse` says where they end. Layout: https://mcap.dev/spec (all numbers
little-endian).
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from io import BytesIO
from typing import Any, Final, Protocol, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.records import Attachment, Channel, ChunkIndex, Metadata, Statistics

MAGIC: Final = b"\x89MCAP0\r\n"
HEADER_SIZE: Final = 9
"""Bytes before the content of a record: opcode and length."""
FOOTER_CONTENT: Final = 20
MESSAGE_FIXED: Final = 22
"""Bytes before the payload of a message: channel, sequence, log and publish time."""
INDEX_ENTRY: Final = 16
"""Bytes of an entry of a message index: log time, and offset in the unpacked chunk."""

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = range(1, 8)
CHUNK_INDEX, ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA = range(8, 13)
METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(13, 16)

record_header = struct.Struct("<BQ")
_index_header = struct.Struct("<HI")
_chunk_fixed = struct.Struct("<QQQI")
_MAP_ENTRY: Final = 10
"""Bytes of an entry of such a map: channel and number."""
_MAP_PLACE: Final[dict[type, int]] = {ChunkIndex: 32, Statistics: 42}
"""Where records that map channels to numbers say how many bytes the map has."""
_CHANNEL_IDS: Final = 1 << 16
"""There are no more: a channel id has two bytes."""


class DamagedRecord(Exception):  # noqa: N818 - not an error for the user, but a finding
    """A record that contradicts itself; caught by the scanner."""


class _Readable(Protocol):
    """A record class of the mcap package; its ``read`` returns the record, but does not say so."""

    @staticmethod
    def read(stream: ReadDataStream) -> Any: ...


R = TypeVar("R", bound=_Readable)
N = TypeVar("N", Channel, Metadata)

_BEFORE_TEXTS: Final[dict[type, tuple[int, int]]] = {Channel: (4, 2), Metadata: (0, 1)}
"""Fixed bytes, then texts, before the map of texts at the end of a record."""


@dataclass(frozen=True, slots=True)
class ChunkRecord:
    """A chunk: times in ns, ``packed`` its records as they stand in the file."""

    start_ns: int
    end_ns: int
    size: int
    crc: int
    compression: str
    packed: memoryview


class _Fields(ReadDataStream):
    """Reads the fields of a record one after the other, never beyond its end."""

    def __init__(self, content: bytes) -> None:
        super().__init__(BytesIO(content))
        self._size = len(content)

    def read(self, length: int) -> bytes:
        if self.count + length > self._size:
            raise DamagedRecord("a field reaches beyond the end of its record")
        return super().read(length)

    def read_prefixed_string(self) -> str:
        """Return the text that follows its length; the records of mcap call this."""
        try:
            return self.read(self.read4()).decode()
        except UnicodeDecodeError:
            raise DamagedRecord("a text is not UTF-8") from None


def parse(kind: type[R], content: bytes) -> tuple[R, int]:
    """Return a record of a class of the mcap package, and how many bytes its fields take.

    A map of channels to numbers has an entry for each channel at most.
    """
    if place := _MAP_PLACE.get(kind):
        size = int.from_bytes(content[place : place + 4], "little")
        if size % _MAP_ENTRY or size > _CHANNEL_IDS * _MAP_ENTRY:
            raise DamagedRecord("a map of channels has a broken size")
    fields = _Fields(content)
    record: R = kind.read(fields)
    return record, fields.count


def parse_texts(kind: type[N], content: bytes) -> tuple[N, int, str | None]:
    """Parse a channel or metadata, which end with a map of texts: record, end, any fault."""
    record, end = parse(kind, content)
    place, texts = _BEFORE_TEXTS[kind]
    for _ in range(texts + 1):
        place += 4 + int.from_bytes(content[place : place + 4], "little")
    return record, end, None if place == end else "a map of texts has a broken size"


def parse_attachment(content: bytes) -> tuple[Attachment, int]:
    """Parse an attachment and check its CRC; returns what :func:`parse` does."""
    attachment, end = parse(Attachment, content)
    crc = int.from_bytes(content[end - 4 : end], "little")
    if crc and crc != zlib.crc32(memoryview(content)[: end - 4]):
        raise DamagedRecord(f"the checksum of attachment {attachment.name!r} is wrong")
    return attachment, end


def parse_message_index(content: bytes) -> tuple[int, memoryview, int]:
    """Return channel id, entries (log time and offset, 8 bytes each) and end of the fields."""
    if len(content) < _index_header.size:
        raise DamagedRecord("a message index is too short")
    channel, size = _index_header.unpack_from(content)
    end = _index_header.size + size
    if size % INDEX_ENTRY or end > len(content):
        raise DamagedRecord("a message index has a broken entry")
    return channel, memoryview(content)[_index_header.size : end], end


def is_message_index(content: bytes) -> bool:
    """Return whether the length inside a record is that of a message index that fills it."""
    size = int.from_bytes(content[2:6], "little")
    return size % INDEX_ENTRY == 0 and len(content) == _index_header.size + size


def chunk_size(content: bytes) -> int:
    """Return the length that the chunk record beginning with ``content`` states, or 0.

    ``content`` may be cut off after the fixed fields. Zero means: this is not a chunk.
    """
    fixed = _chunk_fixed.size
    length = int.from_bytes(content[fixed : fixed + 4], "little")
    name = content[fixed + 4 : fixed + 4 + length] if length < 5 else None
    if name not in (b"", b"zstd", b"lz4") or len(content) < fixed + 12 + length:
        return 0
    packed = int.from_bytes(content[fixed + 4 + length : fixed + 12 + length], "little")
    return fixed + 12 + length + packed


def parse_chunk(content: bytes) -> tuple[ChunkRecord, int]:
    """Return a chunk without a copy of its records, and where its fields end."""
    end = chunk_size(content)
    if not end or end > len(content):
        raise DamagedRecord("the lengths in a chunk contradict each other")
    start_ns, end_ns, size, crc = _chunk_fixed.unpack_from(content)
    name = _chunk_fixed.size + 4
    length = int.from_bytes(content[name - 4 : name], "little")
    packed = memoryview(content)[name + length + 8 : end]
    compression = content[name : name + length].decode()
    return ChunkRecord(start_ns, end_ns, size, crc, compression, packed), end
