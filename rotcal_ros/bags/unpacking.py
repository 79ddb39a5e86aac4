"""Unpacking compressed bytes, never more than a file may ask for."""

from __future__ import annotations

import threading
import zlib
from io import BytesIO
from typing import Final

import lz4.frame
import zstandard

from rotcal_ros.bags.mcap_records import ChunkRecord, DamagedRecord
from rotcal_ros.bags.reading_limits import ReadingLimits, refusal

_LZ4_STEP: Final = 1 << 16


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
        try:
            claimed = zstandard.frame_content_size(data)
            if claimed < 0:  # rosbag2 always says how large a message is
                raise DamagedRecord("a compressed message does not say its size")
            self._grant(claimed, "message")
            return _zstd(memoryview(data), claimed)
        except zstandard.ZstdError as error:
            raise DamagedRecord(f"a message cannot be unpacked: {error}") from None

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


class _Decompressors(threading.local):
    """One for each thread: to make one takes longer than to unpack a small chunk."""

    def __init__(self) -> None:
        self.zstd = zstandard.ZstdDecompressor()


_decompressors: Final = _Decompressors()


def _zstd(packed: memoryview, size: int) -> bytes:
    """Return what is packed, at most ``size`` bytes; in one step, which needs no window."""
    claimed = zstandard.frame_content_size(packed)
    if claimed > size:
        raise DamagedRecord(f"a frame claims {claimed} bytes instead of {size}")
    data: bytes = _decompressors.zstd.decompress(packed, max_output_size=max(1, size))
    return data


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
