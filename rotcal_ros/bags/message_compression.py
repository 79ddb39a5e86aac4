"""rosbag2's compression message by message: what a bag declares, and the messages unpacked.

rosbag2 knows one format, zstd; others are plugins of somebody else.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import numpy as np
import zstandard

from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.mcap_records import DamagedRecord
from rotcal_ros.bags.reading_limits import LARGEST_MESSAGE
from rotcal_ros.bags.unpacking import SKIPPABLE, zstd_message
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.untrusted import open_plain

Unpack = Callable[[bytes], bytes]
"""Returns the message in compressed bytes; raises DamagedRecord."""

METADATA_FILE: Final = "metadata.yaml"
_MAX_METADATA: Final = 16 << 20
_STATED: Final = re.compile(rb"^\s*compression_(mode|format):[ \t]*[\"']?(\w+)", re.MULTILINE)
_BLOCK_BYTES: Final = 4 << 20


def decompressor(mode: str, compression: str) -> Unpack | None:
    """Return what unpacks the messages of a bag; None where they are as they were published.

    ``mode`` and ``compression`` are rosbag2's ``compression_mode`` and ``compression_format``.
    Raises BagError for a format that nobody here can unpack.
    """
    if mode.lower() != "message":
        return None
    if compression != "zstd":
        raise BagError(
            f"its messages are compressed one by one as {compression!r}, which cannot be read "
            "(zstd can); let 'ros2 bag convert' write it with compression_mode none"
        )
    return _unpack_zstd


def declared_compression(file: Path) -> tuple[str, str]:
    """Return mode and format that ``metadata.yaml`` beside a storage file states, or two ''."""
    try:
        with open_plain(file.parent / METADATA_FILE) as metadata:
            return stated_compression(metadata.read(_MAX_METADATA))
    except OSError:
        return "", ""


def stated_compression(metadata: bytes) -> tuple[str, str]:
    """Return mode and format in the text of a ``metadata.yaml``; two '' when it has none.

    Two lines of a text that may be damaged or hostile are searched, not parsed as YAML.
    """
    stated = {match[1]: match[2].decode() for match in _STATED.finditer(metadata)}
    return stated.get(b"mode", ""), stated.get(b"format", "")


def looks_packed(message: bytes) -> bool:
    """Tell whether ``message`` is compressed, declared or not: CDR never begins like zstd."""
    return message.startswith(zstandard.FRAME_HEADER) or bool(SKIPPABLE.match(message))


def unpacked(block: Block, unpack: Unpack, lost: Counter[int]) -> Iterator[Block]:
    """Yield the messages of ``block`` unpacked, few megabytes at a time.

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
            yield _block(block, rows, payloads)
            rows, payloads, room = [], [], _BLOCK_BYTES
    if rows:
        yield _block(block, rows, payloads)


def _block(block: Block, rows: list[int], payloads: list[bytes]) -> Block:
    sizes = np.array([len(payload) for payload in payloads], np.int64)
    return Block(b"".join(payloads), np.cumsum(sizes) - sizes, sizes, block.headers[rows])


def _unpack_zstd(data: bytes) -> bytes:
    beyond = f"a message unpacks to more than {LARGEST_MESSAGE} bytes"
    return zstd_message(data, LARGEST_MESSAGE, beyond)
