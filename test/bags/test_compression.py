"""Compressed chunks and messages (rosbag2's mode MESSAGE), against zstandard and rosbags."""

from __future__ import annotations

import struct
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import zstandard

from rotcal_ros.bags.blocks import HEADER_TYPE, Block
from rotcal_ros.bags.compression import (
    Unpacker,
    declared_compression,
    looks_packed,
    packed_one_by_one,
    stated_compression,
)
from rotcal_ros.bags.mcap_records import ChunkRecord, DamagedRecord
from rotcal_ros.bags.settings import DEFAULT_LIMITS
from rotcal_ros.foundation.errors import BagError

MESSAGE = b"\0\1\0\0" + b"length" * 5000


@pytest.mark.parametrize("size_stated", [True, False])
def test_a_message_is_unpacked_whole_or_refused(size_stated: bool) -> None:
    packed = zstandard.ZstdCompressor(write_content_size=size_stated).compress(MESSAGE)
    unpack = Unpacker(DEFAULT_LIMITS, 1 << 20).message
    assert unpack(packed) == MESSAGE
    for cut in (0, 1, 5, len(packed) // 2, len(packed) - 1):
        with pytest.raises(DamagedRecord):
            unpack(packed[:cut])


ONE, TWO = MESSAGE[:7000], MESSAGE[7000:]
SKIPPED = struct.pack("<II", 0x184D2A57, 5) + b"hello"


def frame(data: bytes, *, stated: bool = True) -> bytes:
    return zstandard.ZstdCompressor(write_content_size=stated).compress(data)


SEVERAL = {
    "two frames": frame(ONE) + frame(TWO),
    "the first without its size": frame(ONE, stated=False) + frame(TWO),
    "one to be skipped first": SKIPPED + frame(MESSAGE),
    "one to be skipped last": frame(MESSAGE) + SKIPPED,
    "one to be skipped between": frame(ONE) + SKIPPED + frame(TWO),
    "an empty one first": frame(b"") + frame(MESSAGE),
    "many": b"".join(frame(MESSAGE[k : k + 5]) for k in range(0, len(MESSAGE), 5)),
}


@pytest.mark.parametrize("how", SEVERAL)
def test_every_frame_of_a_message_counts(how: str) -> None:
    """RFC 8878, 3.1."""
    unpack = Unpacker(DEFAULT_LIMITS, 1 << 20).message
    assert unpack(SEVERAL[how]) == MESSAGE
    for broken in (SEVERAL[how][:-1], SEVERAL[how] + b"more"):
        with pytest.raises(DamagedRecord):
            unpack(broken)
    assert looks_packed(SEVERAL[how])


def test_frames_together_are_not_larger_than_a_message_may_be() -> None:
    unpack = Unpacker(DEFAULT_LIMITS, 1 << 20).message
    with pytest.raises(DamagedRecord, match="more than 50331648"):
        unpack(frame(bytes(30 << 20)) * 2)


@pytest.mark.parametrize("size_stated", [True, False])
def test_a_bomb_is_not_unpacked(size_stated: bool) -> None:
    unpack = Unpacker(DEFAULT_LIMITS, 1 << 20).message
    bomb = zstandard.ZstdCompressor(write_content_size=size_stated).compress(bytes(60 << 20))
    assert len(bomb) < 20_000
    with pytest.raises(DamagedRecord, match="more than 50331648"):
        unpack(bomb)


@pytest.mark.parametrize("mode", ["", "NONE", "none", "FILE", "file", "storage"])
def test_other_modes_leave_messages_as_they_are(mode: str) -> None:
    assert not packed_one_by_one(mode, "zstd")


def test_an_unknown_format_is_refused_with_its_name() -> None:
    with pytest.raises(BagError, match="'fake_comp'"):
        packed_one_by_one("MESSAGE", "fake_comp")


def test_a_block_keeps_its_headers_and_counts_what_is_lost() -> None:
    packed = [zstandard.compress(MESSAGE), b"\x28\xb5\x2f\xfdbroken", zstandard.compress(b"")]
    sizes = np.array([len(data) for data in packed])
    headers = np.zeros(3, HEADER_TYPE)
    headers["channel"], headers["log_time"] = (4, 5, 6), (7, 8, 9)
    lost = Counter[int]()
    (block,) = Unpacker(DEFAULT_LIMITS, 1 << 20).messages(
        Block(b"".join(packed), np.cumsum(sizes) - sizes, sizes, headers), lost
    )
    assert [block.payload(row) for row in range(len(block))] == [MESSAGE, b""]
    assert block.headers["log_time"].tolist() == [7, 9]
    assert lost == {5: 1}


@pytest.mark.parametrize(
    ("text", "stated"),
    [
        (b"information:\n  compression_format: zstd\n  compression_mode: MESSAGE\n",
         ("MESSAGE", "zstd")),
        (b'  compression_format: ""\n  compression_mode: ""\n', ("", "")),
        (b"compression_mode: 'FILE'", ("FILE", "")),
        (b"[" * 100_000, ("", "")), (b"", ("", "")), (b"\xff\0: compression_mode: x", ("", "")),
    ],
)  # fmt: skip
def test_what_metadata_states(text: bytes, stated: tuple[str, str], tmp_path: Path) -> None:
    assert stated_compression(text) == stated
    (tmp_path / "metadata.yaml").write_bytes(text)
    assert declared_compression(tmp_path / "bag_0.db3") == stated
    assert declared_compression(tmp_path / "none" / "bag_0.db3") == ("", "")


def packed(data, **options):
    return zstandard.ZstdCompressor(**options).compress(data)


def unpacked(data, size):
    chunk = ChunkRecord(0, 0, size, 0, "zstd", memoryview(data))
    return Unpacker(DEFAULT_LIMITS, 1 << 20).chunk(chunk)


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (packed(ONE), ONE),
        (packed(ONE) + packed(TWO), ONE + TWO),
        (SKIPPED + packed(ONE), ONE),
        (packed(ONE) + SKIPPED, ONE),
        (packed(ONE) + SKIPPED + packed(TWO), ONE + TWO),
        (packed(ONE, write_content_size=False) + packed(TWO), ONE + TWO),
    ],
)
def test_every_frame_counts(data, expected):
    assert unpacked(data, len(expected)) == expected


def test_the_stated_size_holds():
    with pytest.raises(DamagedRecord, match="more than its"):
        unpacked(packed(ONE) + packed(TWO), len(ONE) + 1)
    with pytest.raises(DamagedRecord):
        unpacked(packed(ONE)[:-9], len(ONE))
    bomb = packed(bytes(1 << 20)) * 50
    with pytest.raises(DamagedRecord):
        unpacked(bomb, (1 << 20) + 5)
