"""What is wrong with an index is named, and costs no message."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest
import small_bag
from mcap_matrix import MAGIC

Change = Callable[[bytearray, int], None]
"""Changes the file, given where the content of a record begins."""


def records(data: bytes) -> list[tuple[int, int]]:
    """Return (opcode, offset) of the top-level records."""
    found, position = [], len(MAGIC)
    while position < len(data) - len(MAGIC):
        found.append((data[position], position))
        position += 9 + int.from_bytes(data[position + 1 : position + 9], "little")
    return found


def with_true_checksums(data: bytearray) -> bytes:
    """Return the file with both checksums made anew: only the index's content is wrong."""
    end = next(offset for opcode, offset in records(data) if opcode == 0x0F)
    data[end + 9 : end + 13] = struct.pack("<I", zlib.crc32(data[:end]))
    data[-12:-8] = struct.pack("<I", zlib.crc32(data[end + 13 : -12]))
    return bytes(data)


def add(position: int, size: int = 8, by: int = 1) -> Change:
    """Return a change that adds to the number at ``position`` of the content."""

    def change(data: bytearray, content: int) -> None:
        begin = content + position
        value = int.from_bytes(data[begin : begin + size], "little") + by
        data[begin : begin + size] = value.to_bytes(size, "little")

    return change


CASES = {
    "chunk, first time": (0x06, add(0), "times of a chunk"),
    "chunk, last time": (0x06, add(8), "times of a chunk"),
    "message index, channel": (0x07, add(0, 2, 40), "message index of channel"),
    "message index, time": (0x07, add(6), "message index of channel"),
    "message index, offset": (0x07, add(14), "message index of channel"),
    "chunk index, time": (0x08, add(0), "index of the chunk"),
    "chunk index, offset": (0x08, add(16), "where no chunk is"),
    "chunk index, length": (0x08, add(24), "index of the chunk"),
    "chunk index, place of an index": (0x08, add(38), "positions of the indexes"),
    "attachment index, offset": (0x0A, add(0), "where no attachment is"),
    "attachment index, length": (0x0A, add(8), "index of the attachment"),
    "attachment index, size": (0x0A, add(32), "index of the attachment"),
    "metadata index, offset": (0x0D, add(0), "where no metadata record is"),
    "metadata index, length": (0x0D, add(8), "index of the metadata record"),
    "statistics, messages": (0x0B, add(0), "73 messages, there are 72"),
    "statistics, schemas": (0x0B, add(8, 2), "6 schemas, there are 5"),
    "statistics, channels": (0x0B, add(10, 4), "7 channels, there are 6"),
    "statistics, attachments": (0x0B, add(14, 4), "3 attachments, there are 2"),
    "statistics, metadata": (0x0B, add(18, 4), "2 metadata records, there are 1"),
    "statistics, chunks": (0x0B, add(22, 4), "chunks, there are"),
    "statistics, first time": (0x0B, add(26), "times of the statistics"),
    "statistics, last time": (0x0B, add(34), "times of the statistics"),
    "statistics, one channel": (0x0B, add(48), "other messages of a channel"),
    "summary offset, place": (0x0E, add(1), "summary offset points"),
    "summary offset, length": (0x0E, add(9), "summary offset points"),
    "footer, summary": (0x02, add(0), "wrong summary"),
    "footer, offsets": (0x02, add(8), "wrong summary offsets"),
    "channel of the summary": (0x04, add(8, 1), "definitions of channel 1 disagree"),
    "schema of the summary": (0x03, add(6, 1), "definitions of schema 1 disagree"),
}


@pytest.mark.parametrize("case", CASES)
def test_each_fault_is_named_and_costs_nothing(case: str, tmp_path: Path) -> None:
    opcode, change, named = CASES[case]
    data = bytearray(small_bag.small_bag(enable_data_crcs=True))
    change(data, next(offset for kind, offset in records(data) if kind == opcode) + 9)
    (tmp_path / "bag.mcap").write_bytes(with_true_checksums(data))
    found = small_bag.read(tmp_path / "bag.mcap")
    assert found.messages == small_bag.truth()
    unclear = "disagree" in named  # nobody knows which of the two is right
    assert found.verdict.state == ("damaged" if unclear else "index wrong")
    said = found.verdict.describe()
    assert unclear or said.startswith("data sound, index wrong at byte"), said
    assert any(named in damage.what for damage in found.verdict.damages), found.verdict.damages
    assert found.verdict.lost == 0
    assert found.verdict.lost_exactly


def without(data: bytes, opcode: int) -> bytes:
    """Return the file without the first record of a kind in its summary, or in the data."""
    offset = next(offset for kind, offset in records(data) if kind == opcode)
    end = offset + 9 + int.from_bytes(data[offset + 1 : offset + 9], "little")
    return data[:offset] + data[end:]


def test_a_missing_message_index_is_named(tmp_path: Path) -> None:
    data = without(small_bag.small_bag(enable_data_crcs=True), 0x07)
    (tmp_path / "bag.mcap").write_bytes(with_true_checksums(bytearray(data)))
    found = small_bag.read(tmp_path / "bag.mcap")
    assert found.messages == small_bag.truth()
    assert "1 channels of a chunk have no index" in [d.what for d in found.verdict.damages]


@pytest.mark.parametrize("opcode", [0x08, 0x0A])
def test_an_index_that_leaves_something_out_is_named(opcode: int, tmp_path: Path) -> None:
    data = without(small_bag.small_bag(enable_data_crcs=True), opcode)
    (tmp_path / "bag.mcap").write_bytes(with_true_checksums(bytearray(data)))
    found = small_bag.read(tmp_path / "bag.mcap")
    assert found.messages == small_bag.truth()
    assert any("have no index" in damage.what for damage in found.verdict.damages)
