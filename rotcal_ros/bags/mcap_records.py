"""The records of an MCAP file, parsed strictly: every byte accounted for, or DamagedRecord.

The file readers of the mcap package stop at the first fault and trust lengths; a salvage reader
must do neither, so only the package's record classes are used. Layout: https://mcap.dev/spec
(all numbers little-endian).
"""

from __future__ import annotations

import struct
import threading
import zlib
from io import BytesIO
from typing import Final, TypeVar

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.records import Attachment, Channel, Chunk, Header, Metadata, Schema, Statistics

R = TypeVar("R", Attachment, Channel, Chunk, Header, Metadata, Schema, Statistics)

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
_index_header = struct.Struct("<HI")
_CHUNK_FIXED: Final = 28
"""Bytes of a chunk before the name of its compression."""


class DamagedRecord(Exception):  # noqa: N818 - not an error for the user, but a finding
    """A record that contradicts itself; caught by the scanner."""


class _Fields(ReadDataStream):
    """Gives the fields of a record one after the other and never reads beyond its end."""

    def __init__(self, content: bytes) -> None:
        super().__init__(BytesIO(content))
        self._size = len(content)

    def read(self, length: int) -> bytes:
        if self.count + length > self._size:
            raise DamagedRecord("a field reaches beyond the end of its record")
        return super().read(length)

    def read_prefixed_string(self) -> str:
        """Return the text that follows its length; the records of mcap call this."""
        return decoded(self.read(self.read4()))


def decoded(text: bytes) -> str:
    """Return ``text`` as a string; raises DamagedRecord when it is not UTF-8."""
    try:
        return text.decode()
    except UnicodeDecodeError:
        raise DamagedRecord("a text is not UTF-8") from None


def parse(kind: type[R], content: bytes) -> R:
    """Return a record of a class of the mcap package; only a header may have further fields."""
    fields = _Fields(content)
    record: R = kind.read(fields)
    if fields.count != len(content) and kind is not Header:
        raise DamagedRecord("a record is longer than its fields")
    return record


def parse_attachment(content: bytes) -> Attachment:
    """Parse an attachment and check its CRC."""
    attachment = parse(Attachment, content)
    crc = int.from_bytes(content[-4:], "little")
    if crc and crc != zlib.crc32(memoryview(content)[:-4]):
        raise DamagedRecord(f"the checksum of attachment {attachment.name!r} is wrong")
    return attachment


def parse_message_index(content: bytes) -> tuple[int, int]:
    """Return channel id and number of messages of a message index that fills its record."""
    channel, size = _index_header.unpack_from(content)
    if size % 16:
        raise DamagedRecord("a message index has a broken entry")
    return channel, size // 16


def chunk_size(content: bytes) -> int:
    """Return how long the chunk record that begins with ``content`` says to be, or 0.

    ``content`` may be cut off after the fixed fields. Zero means: this is no chunk.
    """
    fixed = _CHUNK_FIXED
    length = int.from_bytes(content[fixed : fixed + 4], "little")
    name = content[fixed + 4 : fixed + 4 + length]
    if name not in (b"", b"zstd", b"lz4") or len(content) < fixed + 12 + length:
        return 0
    packed = int.from_bytes(content[fixed + 4 + length : fixed + 12 + length], "little")
    return fixed + 12 + length + packed


def is_chunk(content: bytes, length: int) -> bool:
    """Tell whether the lengths inside a record agree that it is a chunk ``length`` bytes long."""
    return length > 0 and chunk_size(content) == length


def unpack_chunk(chunk: Chunk) -> bytes:
    """Return the records inside a chunk, checked against size and CRC."""
    size = chunk.uncompressed_size
    if size > MAX_RECORD:
        raise DamagedRecord(f"a chunk claims {size} bytes, more than {MAX_RECORD}")
    try:
        data = _decompress(chunk)
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise DamagedRecord(f"a chunk cannot be unpacked: {error}") from None
    if len(data) != size:
        raise DamagedRecord(f"a chunk holds {len(data)} bytes instead of {size}")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise DamagedRecord("the checksum of a chunk is wrong")
    return data


class _Unpackers(threading.local):
    """One for each thread: to make one takes longer than to unpack a small chunk."""

    def __init__(self) -> None:
        self.zstd = zstandard.ZstdDecompressor()


_unpackers: Final = _Unpackers()


def _decompress(chunk: Chunk) -> bytes:
    """Unpack without ever allocating more than the chunk's own size."""
    if chunk.compression == "":
        return chunk.data
    if chunk.compression == "zstd":
        unpacker = _unpackers.zstd.stream_reader(chunk.data)
        zstd_data: bytes = unpacker.read(chunk.uncompressed_size)
        return zstd_data if not unpacker.read(1) else b""
    lz4_data: bytes = lz4.frame.LZ4FrameDecompressor().decompress(
        chunk.data, max_length=chunk.uncompressed_size + 1
    )
    return lz4_data
