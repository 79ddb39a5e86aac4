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
from collections.abc import Callable, Iterator
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
from rotcal_ros.bags.settings import LARGEST_MESSAGE, ReadingLimits, refusal
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
def open_storage_file(path: Path, limits: ReadingLimits) -> Iterator[BinaryIO]:
    """Open a storage file; one that is compressed as a whole is unpacked into a temporary file.

    Of a file that is cut off, the part that can be unpacked is used. Raises OSError, and BagError
    if nothing can be unpacked or the result would be too large.
    """
    with open_plain(path) as file:
        if plain_name(path) == path:
            yield file
            return
        with tempfile.TemporaryFile() as plain:
            _unpack_file(file, plain, path, limits)
            yield plain


@contextmanager
def unpacked_storage_file(
    path: Path, limits: ReadingLimits
) -> Iterator[tuple[Path, Damage | None]]:
    """Yield where the plain storage file is, and the damage that ended its unpacking early.

    It is ``path`` itself or a temporary file. Raises what :func:`open_storage_file` does.
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
                    refusal(f"{path} unpacks to too many bytes", "unpacked_ratio", ratio)
                )
            plain.write(part)
    except zstandard.ZstdError as error:
        if not done:
            raise BagError(f"{path} cannot be unpacked: {error}") from None
        what = f"the file cannot be unpacked after byte {done} of its content: {error}"
        return Damage(0, what)
    return None


Unpack = Callable[[bytes], bytes]
"""Returns the message in compressed bytes; raises DamagedRecord."""

_MAX_METADATA: Final = 16 << 20
_STATED: Final = re.compile(rb"^\s*compression_(mode|format):[ \t]*[\"']?(\w+)", re.MULTILINE)
_BLOCK_BYTES: Final = 4 << 20


def decompressor(mode: str, compression: str) -> Unpack | None:
    """Return the function that unpacks the messages of a bag; None if they are not compressed.

    ``mode`` and ``compression`` are rosbag2's ``compression_mode`` and ``compression_format``.
    Raises BagError for a format that cannot be unpacked.
    """
    if mode.lower() != "message":
        return None
    if compression != "zstd":
        raise BagError(
            f"its messages are compressed one by one as {compression!r}, which cannot be read "
            "(zstd can); let 'ros2 bag convert' write it with compression_mode none"
        )
    return _unpack_message


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
    """Return whether ``message`` is compressed, declared or not.

    CDR begins with 00, unlike any frame of zstd.
    """
    return message.startswith(zstandard.FRAME_HEADER) or bool(SKIPPABLE.match(message))


def unpacked_messages(block: Block, unpack: Unpack, lost: Counter[int]) -> Iterator[Block]:
    """Yield the messages of ``block`` unpacked, a few megabytes at a time.

    Those that cannot be unpacked are left out and counted in ``lost``, by channel id.
    """
    rows: list[int] = []
    payloads: list[bytes] = []
    room = _BLOCK_BYTES
    for row, channel in enumerate(block.headers["channel"].tolist()):
        try:
            payloads.append(unpack(block.payload(row)))
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


def _with_payloads(block: Block, rows: list[int], payloads: list[bytes]) -> Block:
    """Return the messages ``rows`` of ``block`` with other payloads."""
    sizes = np.array([len(payload) for payload in payloads], np.int64)
    return Block(b"".join(payloads), np.cumsum(sizes) - sizes, sizes, block.headers[rows])


def _unpack_message(data: bytes) -> bytes:
    beyond = f"a message unpacks to more than {LARGEST_MESSAGE} bytes"
    return zstd_message(data, LARGEST_MESSAGE, beyond)


_LZ4_STEP: Final = 1 << 16
_ZSTD_STEP: Final = 512
SKIPPABLE: Final = re.compile(rb"[\x50-\x5f]\x2a\x4d\x18")
"""Begin of a frame that is to be skipped."""
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
    """Return the content of all frames of ``data`` (RFC 8878, 3.1), without skippable ones.

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
    """Yield the content of the frames of ``data`` in steps.

    A step gives at most 32,768 times as much.
    """
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


def _zstd(packed: memoryview, size: int) -> bytes:
    """Return the unpacked bytes, hardly more than ``size``; one frame in one step."""
    claimed = zstandard.frame_content_size(packed)
    # -1 stands for a frame that does not state its size; the limits below hold for it too.
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
    """Return the unpacked bytes; a step of the input gives at most 255 times as much."""
    decompressor, data = lz4.frame.LZ4FrameDecompressor(), BytesIO()
    for begin in range(0, len(packed), _LZ4_STEP):
        data.write(decompressor.decompress(packed[begin : begin + _LZ4_STEP]))
        if decompressor.eof:
            break
        if data.tell() > size:
            raise DamagedRecord(f"a chunk unpacks to more than its {size} bytes")
    return data.getvalue()
