"""Unpacks what is compressed in a bag, within the limits that a file has to keep.

Chunks of MCAP are compressed by zstd or lz4. rosbag2 compresses whole storage files (mode FILE) or
message by message (mode MESSAGE), both by zstd; other formats need plugins of rosbag2.
"""

from __future__ import annotations

import re
import tempfile
import threading
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path, PurePath
from typing import IO, BinaryIO, Final

import lz4.frame
import numpy as np
import zstandard

from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.mcap_records import ChunkRecord, DamagedRecord
from rotcal_ros.bags.rosbag2_metadata import METADATA_FILE
from rotcal_ros.bags.settings import ReadingLimits, limit_refusal
from rotcal_ros.bags.storage_scan import Damage
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.untrusted import open_plain

COMPRESSED: Final = ".zstd"
"""The ending of a storage file that is compressed as a whole, after that of its format."""
_FILE_STEP: Final = 1 << 12
"""Bytes of a file that are unpacked at once: up to so many are lost before a fault."""


def plain_name(path: PurePath) -> PurePath:
    """Return ``path`` without the ending of a file that is compressed as a whole."""
    return path.with_suffix("") if path.suffix.lower() == COMPRESSED else path


@contextmanager
def unpacked_storage_file(
    path: Path, limits: ReadingLimits
) -> Iterator[tuple[Path, Damage | None]]:
    """Yield where the plain storage file is, and the damage that ended its unpacking early.

    It is ``path`` itself; of one that is compressed as a whole, a temporary file with what can be
    unpacked. Raises OSError, and BagError where that is nothing, or would become too large.
    """
    if plain_name(path) == path:
        yield path, None
        return
    with open_plain(path) as file, tempfile.NamedTemporaryFile(prefix="rotcal_") as plain:
        damage = _unpack_file(file, plain, path, limits)
        plain.flush()
        yield Path(plain.name), damage


def _unpack_file(
    file: BinaryIO, plain: IO[bytes], path: Path, limits: ReadingLimits
) -> Damage | None:
    """Unpack as much as possible; return the damage that stopped it before the end."""
    size = path.stat().st_size
    most = max(limits.unpacked_bytes, limits.unpacked_ratio * size)
    done = 0
    try:
        reader = zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)
        while part := reader.read(_FILE_STEP):
            done += len(part)
            if done > most:
                ratio = 2 * (done // max(1, size)) + 1
                raise BagError(
                    limit_refusal(f"{path} unpacks to too many bytes", "unpacked_ratio", ratio)
                )
            plain.write(part)
    except zstandard.ZstdError as error:
        if not done:
            raise BagError(
                f"{path} cannot be unpacked: {error}; copy it again from where it was recorded"
            ) from None
        what = f"the file cannot be unpacked after byte {done} of its content: {error}"
        return Damage(0, what)
    return None


_MAX_METADATA: Final = 16 << 20
_STATED: Final = re.compile(rb"^\s*compression_(mode|format):[ \t]*[\"']?(\w+)", re.MULTILINE)
_BLOCK_BYTES: Final = 4 << 20


def packed_one_by_one(mode: str, compression: str) -> bool:
    """Return whether the messages of a bag are compressed, each by itself.

    ``mode`` and ``compression`` are rosbag2's ``compression_mode`` and ``compression_format``.
    Raises BagError for a format that cannot be unpacked.
    """
    if mode.lower() != "message":
        return False
    if compression != "zstd":
        raise BagError(
            f"its messages are compressed one by one as {compression!r}, which cannot be read "
            "(zstd can); let 'ros2 bag convert' write it with compression_mode none"
        )
    return True


def declared_compression(file: Path) -> tuple[str, str]:
    """Return mode and format that ``metadata.yaml`` beside a storage file states, or two ''."""
    try:
        with open_plain(file.parent / METADATA_FILE) as metadata:
            return stated_compression(metadata.read(_MAX_METADATA))
    except OSError:
        return "", ""


def stated_compression(metadata: bytes) -> tuple[str, str]:
    """Return mode and format in the text of a ``metadata.yaml``; two '' when it has none.

    The text may be damaged or hostile: two of its lines are searched, it is not parsed as YAML.
    """
    stated = {match[1]: match[2].decode() for match in _STATED.finditer(metadata)}
    return stated.get(b"mode", ""), stated.get(b"format", "")


def looks_packed(message: bytes) -> bool:
    """Return whether ``message`` is compressed: CDR begins with 00, unlike any frame of zstd."""
    return message.startswith(zstandard.FRAME_HEADER) or bool(SKIPPABLE.match(message))


_LZ4_STEP: Final = 1 << 16
_ZSTD_STEP: Final = 512
SKIPPABLE: Final = re.compile(rb"[\x50-\x5f]\x2a\x4d\x18")
"""Begins a frame that is to be skipped."""
_CUT_OFF: Final = "a compressed frame is cut off"


class Unpacker:
    """Unpacks the chunks and messages of one file of ``size`` bytes."""

    def __init__(self, limits: ReadingLimits, size: int) -> None:
        self._largest = limits.chunk_bytes
        self._left = max(limits.unpacked_bytes, limits.unpacked_ratio * size)
        self._ratio, self._size = limits.unpacked_ratio, max(1, size)
        self._unpacked = 0

    def chunk(self, chunk: ChunkRecord) -> bytes:
        """Return the records inside a chunk, checked against size and CRC.

        Raises DamagedRecord, also if the chunk is larger than the limits allow.
        """
        data = self._plain(chunk)
        if len(data) != chunk.size:
            raise DamagedRecord(f"a chunk holds {len(data)} bytes instead of {chunk.size}")
        # A checksum of 0 means that the writer did not compute one (MCAP).
        if chunk.crc and zlib.crc32(data) != chunk.crc:
            raise DamagedRecord("the checksum of a chunk is wrong")
        return data

    def message(self, data: bytes) -> bytes:
        """Return a message that was compressed by itself (zstd); raises DamagedRecord."""
        more = f"a message unpacks to more than {self._largest} bytes"
        beyond = limit_refusal(more, "chunk_bytes", 2 * self._largest)
        try:
            plain = _zstd(data, self._largest, beyond)
        except (zstandard.ZstdError, MemoryError) as error:
            raise DamagedRecord(f"a compressed message cannot be unpacked: {error}") from None
        self._grant(len(plain), "message")
        return plain

    def messages(self, block: Block, lost: Counter[int]) -> Iterator[Block]:
        """Yield the messages of ``block`` unpacked, a few megabytes at a time.

        Those that cannot be unpacked are left out and counted in ``lost``, by channel id.
        """
        rows: list[int] = []
        payloads: list[bytes] = []
        room = _BLOCK_BYTES
        for row, channel in enumerate(block.headers["channel"].tolist()):
            try:
                payloads.append(self.message(block.payload(row)))
            except DamagedRecord:
                lost[channel] += 1
                continue
            rows.append(row)
            room -= len(payloads[-1])
            if room <= 0:
                yield _with_payloads(block, rows, payloads)
                rows, payloads, room = [], [], _BLOCK_BYTES
        if rows:
            yield _with_payloads(block, rows, payloads)

    def _plain(self, chunk: ChunkRecord) -> bytes:
        if chunk.compression == "":
            return bytes(chunk.packed)
        self._grant(chunk.size, "chunk")
        beyond = f"a chunk unpacks to more than its {chunk.size} bytes"
        try:
            unpack = _zstd if chunk.compression == "zstd" else _lz4
            return unpack(chunk.packed, chunk.size, beyond)
        except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
            raise DamagedRecord(f"a chunk cannot be unpacked: {error}") from None

    def _grant(self, size: int, what: str) -> None:
        """Count ``size`` bytes as unpacked; raises DamagedRecord beyond a limit."""
        if size > self._largest:
            raise DamagedRecord(
                limit_refusal(f"a {what} claims {size} bytes", "chunk_bytes", size)
            )
        self._unpacked += size
        if self._unpacked > self._left:
            ratio = max(self._ratio + 1, -(-self._unpacked // self._size))
            raise DamagedRecord(
                limit_refusal("the file unpacks to too many bytes", "unpacked_ratio", ratio)
            )


def _with_payloads(block: Block, rows: list[int], payloads: list[bytes]) -> Block:
    """Return the messages ``rows`` of ``block`` with other payloads."""
    sizes = np.array([len(payload) for payload in payloads], np.int64)
    return Block(b"".join(payloads), np.cumsum(sizes) - sizes, sizes, block.headers[rows])


def _zstd(data: bytes | memoryview, largest: int, beyond: str) -> bytes:
    """Return what all frames of ``data`` hold (RFC 8878, 3.1); some are to be skipped.

    Raises ZstdError, and DamagedRecord with the words ``beyond`` above ``largest`` bytes.
    """
    size = zstandard.frame_content_size(data)  # -1: not stated
    if size > largest:
        raise DamagedRecord(beyond)
    if size > 0:
        with suppress(zstandard.ZstdError):  # there is more than this frame
            return _decompressors.zstd.decompress(
                data, max_output_size=size, allow_extra_data=False
            )
    return b"".join(_frames(data, largest, beyond))


def _frames(data: bytes | memoryview, room: int, beyond: str) -> Iterator[bytes]:
    """Yield what the frames of ``data`` hold, in steps; a step gives 32,768 times as much."""
    position = 0
    while position < len(data) or not data:
        if SKIPPABLE.match(data, position):
            # Magic number and length, 4 bytes each, then the content of a skippable frame.
            position += 8 + int.from_bytes(data[position + 4 : position + 8], "little")
            if position > len(data):
                raise DamagedRecord(_CUT_OFF)
            continue
        frame = _decompressors.zstd.decompressobj()
        while not frame.eof:
            # Small steps bound what a hostile frame can unpack to before the limit is checked.
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
    """One for each thread: making one takes longer than unpacking a small chunk."""

    def __init__(self) -> None:
        self.zstd = zstandard.ZstdDecompressor()


_decompressors: Final = _Decompressors()


def _lz4(packed: memoryview, size: int, beyond: str) -> bytes:
    """Return what is packed; a step of the input gives 255 times as much at most."""
    decompressor, data = lz4.frame.LZ4FrameDecompressor(), BytesIO()
    for begin in range(0, len(packed), _LZ4_STEP):
        data.write(decompressor.decompress(packed[begin : begin + _LZ4_STEP]))
        if decompressor.eof:
            break
        if data.tell() > size:
            raise DamagedRecord(beyond)
    return data.getvalue()
