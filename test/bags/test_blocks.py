"""Splitting chunks: with and without a loop the same answer, and nothing is made up."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rotcal_ros.bags import blocks
from rotcal_ros.bags.blocks import Block, join_blocks
from rotcal_ros.bags.mcap_records import CHANNEL, MESSAGE, DamagedRecord

headers = st.tuples(
    st.integers(0, 65535), st.integers(0, 2**32 - 1), st.integers(0, 2**63), st.integers(0, 2**63)
)
# Payloads full of bytes that look like records.
tricky = st.sampled_from([b"\x05", b"\x00", b"\x05" + struct.pack("<Q", 22), b"\x16", b"x"])
payloads = st.lists(tricky, max_size=8).map(b"".join)


MOST = 1000


def split_chunk(data: bytes, most: int = MOST) -> tuple[Block, blocks.Others]:
    """Return all pieces of a chunk as one."""
    pieces = list(blocks.split_chunk(data, most))
    others = [other for _, found in pieces for other in found]
    return join_blocks([block for block, _ in pieces] or [EMPTY]), others


EMPTY = Block(b"", np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, blocks.HEADER_TYPE))


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def message(header: tuple[int, int, int, int], payload: bytes) -> bytes:
    return record(MESSAGE, struct.pack("<HIQQ", *header) + payload)


@given(st.lists(st.tuples(headers, payloads), max_size=6), st.lists(st.integers(0, 6), max_size=2))
def test_messages_and_other_records_come_out_as_they_went_in(
    messages: list[tuple[tuple[int, int, int, int], bytes]], extra: list[int]
) -> None:
    parts = [message(header, payload) for header, payload in messages]
    for place in extra:
        parts.insert(place, record(CHANNEL, b"\x05other"))
    block, others = split_chunk(b"".join(parts))
    assert [block.payload(i) for i in range(len(block))] == [payload for _, payload in messages]
    assert block.headers.tolist() == [header for header, _ in messages]
    assert [other[1:] for other in others] == [(CHANNEL, b"\x05other")] * len(extra)


@pytest.mark.parametrize(
    "data",
    [
        b"\x05",
        record(MESSAGE, bytes(21)),
        record(MESSAGE, bytes(30))[:-1],
        record(MESSAGE, bytes(30)) + b"\x05\x01",
        struct.pack("<BQ", MESSAGE, 2**63) + bytes(40),
    ],
)
def test_chunk_that_is_not_filled_by_its_records(data: bytes) -> None:
    with pytest.raises(DamagedRecord):
        split_chunk(data)


def test_rows_of_equal_size() -> None:
    texts = [b"aa", b"bbb", b"cc", b"", b"ddd"]
    block, _ = split_chunk(b"".join(message((1, i, i, i), t) for i, t in enumerate(texts)))
    found = {
        int(row): raw.tobytes()
        for rows, group in block.equally_long()
        for row, raw in zip(rows, group, strict=True)
    }
    assert [found[i] for i in range(5)] == texts
    picked = block.select(np.array([4, 0]))
    assert [picked.payload(0), picked.payload(1)] == [b"ddd", b"aa"]
