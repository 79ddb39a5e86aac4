"""Blocks of messages: the records of one chunk as bytes with an index of arrays."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.bags.mcap_records import HEADER_SIZE, MESSAGE, DamagedRecord, record_header

Indices = NDArray[np.int64]

HEADER_TYPE: Final = np.dtype(
    [
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
"""What stands before the payload of a message; packed, 22 bytes."""


@dataclass(frozen=True)
class Block:
    """Messages in file order.

    ``data`` holds them; message i has its payload at ``start[i]``, ``size[i]`` bytes long, and
    ``headers[i]`` (channel, sequence, log_time, publish_time; times in ns).
    """

    data: bytes
    start: Indices
    size: Indices
    headers: NDArray[np.void]

    def __len__(self) -> int:
        return len(self.start)

    def payload(self, index: int) -> bytes:
        """Return the serialised message number ``index``."""
        start = self.start[index]
        return self.data[start : start + self.size[index]]

    def select(self, rows: NDArray[np.bool_] | Indices) -> Block:
        """Return the block of some of the messages, in the same order."""
        return Block(self.data, self.start[rows], self.size[rows], self.headers[rows])

    def equally_long(self) -> Iterator[tuple[Indices, NDArray[np.uint8]]]:
        """Yield (rows, bytes) for messages of equal size, bytes with shape (rows, size)."""
        raw = np.frombuffer(self.data, np.uint8)
        for size in np.unique(self.size):
            rows = np.flatnonzero(self.size == size)
            yield rows, gather(raw, self.start[rows], int(size))


def gather(raw: NDArray[np.uint8], start: Indices, size: int) -> NDArray[np.uint8]:
    """Return the bytes start[i]..start[i]+size of every i as rows of a (n, size) array."""
    if not len(start) or not size:
        return np.zeros((len(start), size), np.uint8)
    windows = np.lib.stride_tricks.sliding_window_view(raw, size)
    return windows[start]


def block_of_records(data: bytes, positions: list[int], sizes: list[int]) -> Block:
    """Return the block of the message records whose contents begin at ``positions``."""
    content = np.asarray(positions, np.int64)
    header_size = HEADER_TYPE.itemsize
    raw = np.frombuffer(data, np.uint8)
    headers = gather(raw, content, header_size).view(HEADER_TYPE)[:, 0]
    return Block(data, content + header_size, np.asarray(sizes, np.int64) - header_size, headers)


def split_chunk(data: bytes) -> tuple[Block, list[tuple[int, bytes]]]:
    """Return the messages of an unpacked chunk and its other records as (opcode, content).

    Raises DamagedRecord when the records do not fill the chunk exactly.
    """
    positions: list[int] = []
    sizes: list[int] = []
    others: list[tuple[int, bytes]] = []
    unpack = record_header.unpack_from
    position, end = 0, len(data)
    last_header = end - HEADER_SIZE
    while position <= last_header:
        opcode, length = unpack(data, position)
        position += HEADER_SIZE
        if opcode == MESSAGE:
            positions.append(position)
            sizes.append(length)
        else:
            others.append((opcode, data[position : position + length]))
        position += length
    if position != end or (sizes and min(sizes) < HEADER_TYPE.itemsize):
        raise DamagedRecord("the records of a chunk do not fill it")
    return block_of_records(data, positions, sizes), others
