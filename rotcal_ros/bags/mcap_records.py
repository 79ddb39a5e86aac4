"""The records of an MCAP file, parsed strictly: every byte accounted for, or DamagedRecord.

The readers of the mcap package stop at the first fault and trust lengths; a salvage reader
must do neither. Layout: https://mcap.dev/spec (all numbers little-endian).
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from typing import Final

import lz4.frame
import zstandard

MAGIC: Final = b"\x89MCAP0\r\n"
HEADER_SIZE: Final = 9
"""Bytes before the content of a record: opcode and length."""
FOOTER_CONTENT: Final = 20
MAX_RECORD: Final = 128 * 1024 * 1024
"""Largest record, and largest unpacked chunk, that is taken into memory."""

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = range(1, 8)
CHUNK_INDEX, ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA = range(8, 13)
METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(13, 16)

record_header = struct.Struct("<BQ")
message_header = struct.Struct("<HIQQ")
_CHUNK_FIXED = struct.Struct("<QQQI")


class DamagedRecord(Exception):  # noqa: N818 - not an error for the user, but a finding
    """A record that contradicts itself; caught by the scanner."""


@dataclass(frozen=True, slots=True)
class Chunk:
    """A chunk, still packed."""

    start_ns: int
    end_ns: int
    size: int
    crc: int
    compression: str
    packed: bytes


@dataclass(frozen=True, slots=True)
class Schema:
    """A message definition."""

    schema_id: int
    name: str
    encoding: str
    text: str


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic with the id of its schema."""

    channel_id: int
    schema_id: int
    topic: str
    encoding: str
    metadata: dict[str, str]


@dataclass(frozen=True, slots=True)
class Attachment:
    """A file inside the file."""

    name: str
    media_type: str
    data: bytes
    log_time_ns: int


class _Cursor:
    """Reads fields one after the other and never beyond the end."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._position = 0

    def take(self, size: int) -> bytes:
        end = self._position + size
        if end > len(self._data):
            raise DamagedRecord("a field reaches beyond the end of its record")
        part = self._data[self._position : end]
        self._position = end
        return part

    def number(self, size: int) -> int:
        return int.from_bytes(self.take(size), "little")

    def text(self) -> str:
        try:
            return self.take(self.number(4)).decode()
        except UnicodeDecodeError:
            raise DamagedRecord("a text is not UTF-8") from None

    def text_map(self) -> dict[str, str]:
        inner = _Cursor(self.take(self.number(4)))
        texts: dict[str, str] = {}
        while inner._position < len(inner._data):
            key = inner.text()
            texts[key] = inner.text()
        return texts

    def finish(self) -> None:
        if self._position != len(self._data):
            raise DamagedRecord("a record is longer than its fields")


def parse_header(content: bytes) -> tuple[str, str]:
    """Return profile and library."""
    cursor = _Cursor(content)
    return cursor.text(), cursor.text()


def parse_schema(content: bytes) -> Schema:
    """Parse a schema record."""
    cursor = _Cursor(content)
    number, name, encoding = cursor.number(2), cursor.text(), cursor.text()
    text = cursor.text()
    cursor.finish()
    return Schema(number, name, encoding, text)


def parse_channel(content: bytes) -> Channel:
    """Parse a channel record."""
    cursor = _Cursor(content)
    number, schema = cursor.number(2), cursor.number(2)
    channel = Channel(number, schema, cursor.text(), cursor.text(), cursor.text_map())
    cursor.finish()
    return channel


def parse_attachment(content: bytes) -> Attachment:
    """Parse an attachment and check its CRC."""
    cursor = _Cursor(content)
    log_time, _created = cursor.number(8), cursor.number(8)
    name, media_type = cursor.text(), cursor.text()
    data = cursor.take(cursor.number(8))
    crc = cursor.number(4)
    cursor.finish()
    if crc and crc != zlib.crc32(memoryview(content)[:-4]):
        raise DamagedRecord(f"the checksum of attachment {name!r} is wrong")
    return Attachment(name, media_type, data, log_time)


def parse_metadata(content: bytes) -> tuple[str, dict[str, str]]:
    """Return name and entries of a metadata record."""
    cursor = _Cursor(content)
    name, entries = cursor.text(), cursor.text_map()
    cursor.finish()
    return name, entries


def parse_message_index(content: bytes) -> tuple[int, int]:
    """Return channel id and number of messages of a message index."""
    cursor = _Cursor(content)
    channel, size = cursor.number(2), cursor.number(4)
    cursor.take(size)
    cursor.finish()
    if size % 16:
        raise DamagedRecord("a message index has a broken entry")
    return channel, size // 16


def parse_statistics(content: bytes) -> dict[int, int]:
    """Return the number of messages per channel id."""
    cursor = _Cursor(content)
    cursor.take(8 + 2 + 4 + 4 + 4 + 4 + 8 + 8)
    size = cursor.number(4)
    counts = {cursor.number(2): cursor.number(8) for _ in range(size // 10)}
    cursor.finish()
    return counts


def chunk_size(content: bytes) -> int:
    """Return how long the chunk record that begins with ``content`` says to be, or 0.

    ``content`` may be cut off after the fixed fields. Zero means: this is no chunk.
    """
    fixed = _CHUNK_FIXED.size
    length = int.from_bytes(content[fixed : fixed + 4], "little")
    name = content[fixed + 4 : fixed + 4 + length]
    if name not in (b"", b"zstd", b"lz4") or len(content) < fixed + 12 + length:
        return 0
    packed = int.from_bytes(content[fixed + 4 + length : fixed + 12 + length], "little")
    return fixed + 12 + length + packed


def is_chunk(content: bytes, length: int) -> bool:
    """Tell whether the lengths inside a record agree that it is a chunk ``length`` bytes long."""
    return length > 0 and chunk_size(content) == length


def parse_chunk(content: bytes) -> Chunk:
    """Parse a chunk without unpacking it."""
    cursor = _Cursor(content)
    start, end, size, crc = _CHUNK_FIXED.unpack(cursor.take(_CHUNK_FIXED.size))
    compression = cursor.text()
    packed = cursor.take(cursor.number(8))
    cursor.finish()
    return Chunk(start, end, size, crc, compression, packed)


def unpack_chunk(chunk: Chunk) -> bytes:
    """Return the records inside a chunk, checked against size and CRC."""
    if chunk.size > MAX_RECORD:
        raise DamagedRecord(f"a chunk claims {chunk.size} bytes, more than {MAX_RECORD}")
    try:
        data = _decompress(chunk)
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise DamagedRecord(f"a chunk cannot be unpacked: {error}") from None
    if len(data) != chunk.size:
        raise DamagedRecord(f"a chunk holds {len(data)} bytes instead of {chunk.size}")
    if chunk.crc and zlib.crc32(data) != chunk.crc:
        raise DamagedRecord("the checksum of a chunk is wrong")
    return data


def _decompress(chunk: Chunk) -> bytes:
    """Unpack without ever allocating more than the chunk's own size."""
    if chunk.compression == "":
        return chunk.packed
    if chunk.compression == "zstd":
        unpacker = zstandard.ZstdDecompressor().stream_reader(chunk.packed)
        zstd_data: bytes = unpacker.read(chunk.size)
        return zstd_data if not unpacker.read(1) else b""
    if chunk.compression == "lz4":
        lz4_data: bytes = lz4.frame.LZ4FrameDecompressor().decompress(
            chunk.packed, max_length=chunk.size + 1
        )
        return lz4_data
    raise DamagedRecord(f"a chunk is packed by the unknown method {chunk.compression!r}")
