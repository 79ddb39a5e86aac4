"""Blocks of messages: the records of one chunk as bytes with an index of arrays."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.arrays import Bools, Bytes, Ints
from rotcal_ros.bags.mcap_records import HEADER_SIZE, MESSAGE, DamagedRecord

HEADER_TYPE: Final = np.dtype(
    [("channel", "<u2"), ("sequence", "<u4"), ("log_time", "<u8"), ("publish_time", "<u8")]
)
"""What stands before the payload of a message; packed, 22 bytes."""

_WALKED: Final = 1 << 16
"""Bytes up to which going from record to record is quicker than looking at all at once."""
_length = struct.Struct("<Q")


@dataclass(frozen=True)
class Block:
    """Messages in file order.

    ``data`` holds them; message i has its payload at ``start[i]``, ``size[i]`` bytes long, and
    ``headers[i]`` (channel, sequence, log_time, publish_time; times in ns).
    """

    data: bytes
    start: Ints
    size: Ints
    headers: NDArray[np.void]

    def __len__(self) -> int:
        return len(self.start)

    def payload(self, index: int) -> bytes:
        """Return the serialised message number ``index``."""
        start = self.start[index]
        return self.data[start : start + self.size[index]]

    def counts(self) -> dict[int, int]:
        """Return the number of messages by channel id."""
        counts = np.bincount(self.headers["channel"])
        return {number: int(counts[number]) for number in np.flatnonzero(counts).tolist()}

    def select(self, rows: Bools | Ints) -> Block:
        """Return the block of some of the messages, in the same order."""
        return Block(self.data, self.start[rows], self.size[rows], self.headers[rows])

    def equally_long(self) -> Iterator[tuple[Ints, Bytes]]:
        """Yield (rows, bytes) for messages of equal size, bytes with shape (rows, size)."""
        raw = np.frombuffer(self.data, np.uint8)
        for size in np.unique(self.size):
            rows = np.flatnonzero(self.size == size)
            yield rows, gather(raw, self.start[rows], int(size))


def joined(blocks: Sequence[Block]) -> Block:
    """Return the messages of several blocks as one, in their order."""
    if len(blocks) == 1:
        return blocks[0]
    begins = np.cumsum([0, *(len(block.data) for block in blocks[:-1])])
    return Block(
        b"".join(block.data for block in blocks),
        np.concatenate([block.start + at for block, at in zip(blocks, begins, strict=True)]),
        np.concatenate([block.size for block in blocks]),
        np.concatenate([block.headers for block in blocks]),
    )


def gather(raw: Bytes, start: Ints, size: int) -> Bytes:
    """Return the bytes start[i]..start[i]+size of every i as rows of a (n, size) array."""
    if not len(start) or not size:
        return np.zeros((len(start), size), np.uint8)
    if len(raw) < size:
        raise DamagedRecord("a message reaches beyond its chunk")
    windows = np.ndarray((len(raw) - size + 1, size), np.uint8, raw, strides=(1, 1))
    chosen: Bytes = windows[start]
    return chosen


def block_of_records(data: bytes, contents: Ints, sizes: Ints) -> Block:
    """Return the block of the message records whose contents begin at ``contents``."""
    header_size = HEADER_TYPE.itemsize
    raw = np.frombuffer(data, np.uint8)
    headers = gather(raw, contents, header_size).view(HEADER_TYPE)[:, 0]
    return Block(data, contents + header_size, sizes - header_size, headers)


def split_chunk(data: bytes) -> tuple[Block, list[tuple[int, bytes]]]:
    """Return the messages of an unpacked chunk and its other records as (opcode, content).

    Raises DamagedRecord when the records do not fill the chunk exactly.
    """
    raw = np.frombuffer(data, np.uint8)
    begins = _only_messages(raw) if len(data) > _WALKED else None
    if begins is None:
        begins = _walk(data)
    sizes = np.diff(begins, append=len(data)) - HEADER_SIZE
    is_message = raw[begins] == MESSAGE
    if (sizes[is_message] < HEADER_TYPE.itemsize).any():
        raise DamagedRecord("a message of a chunk is too short")
    contents = begins + HEADER_SIZE
    others = [
        (data[content - HEADER_SIZE], data[content : content + size])
        for content, size in zip(
            contents[~is_message].tolist(), sizes[~is_message].tolist(), strict=True
        )
    ]
    return block_of_records(data, contents[is_message], sizes[is_message]), others


def _walk(data: bytes) -> Ints:
    """Return where the records of a chunk begin, going from one to the next."""
    positions: list[int] = []
    append, length_at = positions.append, _length.unpack_from
    position, end = 0, len(data)
    last_header = end - HEADER_SIZE
    while position <= last_header:
        append(position)
        position += HEADER_SIZE + length_at(data, position + 1)[0]
    if position != end:
        raise DamagedRecord("the records of a chunk do not fill it")
    return np.array(positions, np.int64)


def _only_messages(raw: Bytes) -> Ints | None:
    """Return where the records of a chunk begin if all are messages, without a loop; else None.

    Every byte that might be the opcode of a message is a candidate; those whose length leads
    to another candidate stay, and they must form one chain from the first byte to the last.
    """
    end = len(raw)
    begins = np.flatnonzero(raw[: max(0, end - HEADER_SIZE)] == MESSAGE)
    if not len(begins) or begins[0] != 0:
        return None
    lengths = gather(raw, begins + 1, 8).view("<u8")[:, 0]
    plausible = (lengths >= HEADER_TYPE.itemsize) & (lengths < end)
    begins, lengths = begins[plausible], lengths[plausible].astype(np.int64)
    ends = begins + HEADER_SIZE + lengths
    is_begin = np.zeros(end + 1, np.bool_)
    is_begin[begins] = is_begin[end] = True
    linked = is_begin[np.minimum(ends, end)] & (ends <= end)
    begins, ends = begins[linked], ends[linked]
    chained = (
        len(begins) > 0
        and begins[0] == 0
        and ends[-1] == end
        and np.array_equal(begins[1:], ends[:-1])
    )
    return begins if chained else None
