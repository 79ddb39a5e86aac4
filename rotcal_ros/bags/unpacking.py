"""Unpacking compressed bytes, never more than a file may ask for."""

from __future__ import annotations

import re
import threading
import zlib
from collections.abc import Iterator
from contextlib import suppress
from io import BytesIO
from typing import Final

import lz4.frame
import zstandard

from rotcal_ros.bags.mcap_records import ChunkRecord, DamagedRecord
from rotcal_ros.bags.reading_limits import ReadingLimits, refusal

_LZ4_STEP: Final = 1 << 16
_ZSTD_STEP: Final = 512
SKIPPABLE: Final = re.compile(rb"[\x50-\x5f]\x2a\x4d\x18")
"""Begins a frame that is to be skipped."""
_CUT_OFF: Final = "a compressed message is cut off"


class Unpacker:
    """Unpacks the chunks and messages of one file of ``size`` bytes."""

    def __init__(self, limits: ReadingLimits, size: int) -> None:
        self._largest = limits.chunk_bytes
        self._left = max(limits.unpacked_bytes, limits.unpacked_ratio * size)
        self._ratio, self._size = limits.unpacked_ratio, max(1, size)
        self._unpacked = 0

    def chunk(self, chunk: ChunkRecord) -> bytes:
        """Return the records inside a chunk, checked against size and CRC.

        Raises DamagedRecord, also where the chunk is larger than the limits allow.
        """
        data = self._plain(chunk)
        if len(data) != chunk.size:
            raise DamagedRecord(f"a chunk holds {len(data)} bytes instead of {chunk.size}")
        if chunk.crc and zlib.crc32(data) != chunk.crc:
            raise DamagedRecord("the checksum of a chunk is wrong")
        return data

    def message(self, data: bytes) -> bytes:
        """Return a message that was compressed by itself (zstd); raises DamagedRecord."""
        more = f"a message unpacks to more than {self._largest} bytes"
        beyond = refusal(more, "chunk_bytes", 2 * self._largest)
        plain = zstd_message(data, self._largest, beyond)
        self._grant(len(plain), "message")
        return plain

    def _plain(self, chunk: ChunkRecord) -> bytes:
        if chunk.compression == "":
            return bytes(chunk.packed)
        self._grant(chunk.size, "chunk")
        try:
            if chunk.compression == "zstd":
                return _zstd(chunk.packed, chunk.size)
            return _lz4(chunk.packed, chunk.size)
        except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
            raise DamagedRecord(f"a chunk cannot be unpacked: {error}") from None

    def _grant(self, size: int, what: str) -> None:
        """Count ``size`` bytes as unpacked; raises DamagedRecord beyond a limit."""
        if size > self._largest:
            raise DamagedRecord(refusal(f"a {what} claims {size} bytes", "chunk_bytes", size))
        self._unpacked += size
        if self._unpacked > self._left:
            ratio = max(self._ratio + 1, -(-self._unpacked // self._size))
            raise DamagedRecord(
                refusal("the file unpacks to too many bytes", "unpacked_ratio", ratio)
            )


def zstd_message(data: bytes, largest: int, beyond: str) -> bytes:
    """Return what all frames of ``data`` hold (RFC 8878, 3.1); some are to be skipped.

    Raises DamagedRecord, with the words ``beyond`` above ``largest`` bytes.
    """
    try:
        size = zstandard.frame_content_size(data)  # -1: not stated
        if size > largest:
            raise DamagedRecord(beyond)
        if size > 0:
            with suppress(zstandard.ZstdError):  # there is more than this frame
                return bytes(
                    _decompressors.zstd.decompress(
                        data, max_output_size=size, allow_extra_data=False
                    )
                )
        return b"".join(_frames(data, largest, beyond))
    except (zstandard.ZstdError, MemoryError) as error:
        raise DamagedRecord(f"a compressed message cannot be unpacked: {error}") from None


def _frames(data: bytes, room: int, beyond: str) -> Iterator[bytes]:
    """Yield what the frames of ``data`` hold, in steps; a step gives 32,768 times as much."""
    position = 0
    while position < len(data) or not data:
        if SKIPPABLE.match(data, position):
            position += 8 + int.from_bytes(data[position + 4 : position + 8], "little")
            if position > len(data):
                raise DamagedRecord(_CUT_OFF)
            continue
        frame = _decompressors.zstd.decompressobj()
        while not frame.eof:
            step = data[position : position + _ZSTD_STEP]
            if not step:
                raise DamagedRecord(_CUT_OFF)
            part = frame.decompress(step)
            position += len(step) - len(frame.unused_data)
            room -= len(part)
            if room < 0:
                raise DamagedRecord(beyond)
            yield part


class _Decompressors(threading.local):
    """One for each thread: to make one takes longer than to unpack a small chunk."""

    def __init__(self) -> None:
        self.zstd = zstandard.ZstdDecompressor()


_decompressors: Final = _Decompressors()


def _zstd(packed: memoryview, size: int) -> bytes:
    """Return what is packed, hardly more than ``size`` bytes; one frame in one step."""
    claimed = zstandard.frame_content_size(packed)
    if claimed > size:
        raise DamagedRecord(f"a frame claims {claimed} bytes instead of {size}")
    data = b""
    with suppress(zstandard.ZstdError):
        data = _decompressors.zstd.decompress(packed, max_output_size=max(1, size))
    if len(data) == size:
        return data
    with _decompressors.zstd.stream_reader(packed, read_across_frames=True) as reader:
        parts = []  # several frames, or some that are to be skipped
        while size >= 0 and (part := reader.read(size + 1)):
            parts.append(part)
            size -= len(part)
    return b"".join(parts)


def _lz4(packed: memoryview, size: int) -> bytes:
    """Return what is packed; a step of the input gives 255 times as much at most."""
    decompressor, data = lz4.frame.LZ4FrameDecompressor(), BytesIO()
    for begin in range(0, len(packed), _LZ4_STEP):
        data.write(decompressor.decompress(packed[begin : begin + _LZ4_STEP]))
        if decompressor.eof:
            break
        if data.tell() > size:
            raise DamagedRecord(f"a chunk unpacks to more than its {size} bytes")
    return data.getvalue()
