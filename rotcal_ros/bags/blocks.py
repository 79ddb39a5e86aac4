"""Blocks of messages: the bytes of a chunk, and where each message stands in them, as arrays."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.bags.mcap_records import HEADER_SIZE, MESSAGE, DamagedRecord
from rotcal_ros.foundation.arrays import Bools, Bytes, Ints

HEADER_TYPE: Final = np.dtype(
    [("channel", "<u2"), ("sequence", "<u4"), ("log_time", "<u8"), ("publish_time", "<u8")]
)
"""The fields before the payload of a message; packed, 22 bytes."""

_LOOP_BYTES: Final = 1 << 16
"""Up to this size a loop over the records is quicker than numpy over all bytes."""
_PIECE: Final = 1 << 20
"""Bytes of a chunk that are split together."""
_UNFILLED: Final = "the records of a chunk do not fill it"
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
            yield rows, gather_rows(raw, self.start[rows], int(size))


def join_blocks(blocks: Sequence[Block]) -> Block:
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


def gather_rows(raw: Bytes, start: Ints, size: int) -> Bytes:
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
    headers = gather_rows(raw, contents, header_size).view(HEADER_TYPE)[:, 0]
    return Block(data, contents + header_size, sizes - header_size, headers)


def block_of_contents(contents: Sequence[bytes]) -> Block:
    """Return the block of messages whose records were read one by one."""
    sizes = np.array([len(content) for content in contents], np.int64)
    return block_of_records(b"".join(contents), np.cumsum(sizes) - sizes, sizes)


Others = list[tuple[int, int, bytes]]
"""Records that are not messages: begin in the chunk, opcode and content."""


def split_chunk(data: bytes, most_others: int) -> Iterator[tuple[Block, Others]]:
    """Yield the messages of an unpacked chunk and its other records, piece by piece.

    All blocks share ``data``; the memory beside it does not grow with the chunk. Raises
    DamagedRecord, after the sound records, if the records do not fill the chunk exactly, if a
    message is too short, or if more than ``most_others`` are not messages.
    """
    raw = np.frombuffer(data, np.uint8)
    position = 0
    fault: str | None = None
    while position < len(data) and fault is None:
        begins, position, fault = _piece(data, raw, position)
        sizes = np.diff(begins, append=position) - HEADER_SIZE
        is_message = raw[begins] == MESSAGE
        most_others -= len(begins) - int(np.count_nonzero(is_message))
        if most_others < 0:
            fault = "a chunk has too many records that are not messages"
            begins, is_message = begins[:0], is_message[:0]
        whole = is_message & (sizes[: len(begins)] >= HEADER_TYPE.itemsize)
        if (whole != is_message).any():
            fault = "a message of a chunk is too short"
        contents, sizes = begins + HEADER_SIZE, sizes[: len(begins)]
        others = [
            (content - HEADER_SIZE, data[content - HEADER_SIZE], data[content : content + size])
            for content, size in zip(
                contents[~is_message].tolist(), sizes[~is_message].tolist(), strict=True
            )
        ]
        yield block_of_records(data, contents[whole], sizes[whole]), others
    if fault is not None:
        raise DamagedRecord(fault)


def _piece(data: bytes, raw: Bytes, first: int) -> tuple[Ints, int, str | None]:
    """Return where the records of the next piece begin, where the last ends, and any fault."""
    stop = min(len(data), first + _PIECE)
    if stop - first > _LOOP_BYTES:
        begins, end = _only_messages(raw, first, stop)
        if len(begins):
            return begins, end, None
    return _piece_by_loop(data, first, stop)


def _piece_by_loop(data: bytes, first: int, stop: int) -> tuple[Ints, int, str | None]:
    """Do as :func:`_piece` by a loop from one record to the next."""
    positions: list[int] = []
    append, length_at = positions.append, _length.unpack_from
    position, last = first, min(stop - 1, len(data) - HEADER_SIZE)
    while position <= last:
        append(position)
        position += HEADER_SIZE + length_at(data, position + 1)[0]
    fault = None
    if position > len(data):
        position, fault = positions.pop(), _UNFILLED
    elif position < stop:
        fault = _UNFILLED
    return np.array(positions, np.int64), position, fault


def _only_messages(raw: Bytes, first: int, stop: int) -> tuple[Ints, int]:
    """Return where records begin if all are messages, and the last end, without a loop.

    Every byte that might be the opcode of a message is a candidate; those whose length leads to
    another candidate stay, and they must form one chain from the first byte to the last. If they
    do not, nothing is returned.
    """
    none = np.zeros(0, np.int64), first
    begins = first + np.flatnonzero(raw[first : min(stop, len(raw) - HEADER_SIZE)] == MESSAGE)
    if not len(begins) or begins[0] != first:
        return none
    lengths = gather_rows(raw, begins + 1, 8).view("<u8")[:, 0]
    plausible = (lengths >= HEADER_TYPE.itemsize) & (lengths < len(raw))
    begins, lengths = begins[plausible], lengths[plausible].astype(np.int64)
    ends = begins + HEADER_SIZE + lengths
    is_begin = np.zeros(stop - first + 1, np.bool_)
    is_begin[begins - first] = is_begin[-1] = True
    linked = is_begin[np.minimum(ends, stop) - first] & (ends <= len(raw))
    begins, ends = begins[linked], ends[linked]
    chained = (
        len(begins) > 0
        and begins[0] == first
        and ends[-1] >= stop
        and np.array_equal(begins[1:], ends[:-1])
    )
    return (begins, int(ends[-1])) if chained else none
