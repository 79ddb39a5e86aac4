"""Chunks of several zstd frames, or with some to be skipped: RFC 8878, 3.1."""

import struct

import pytest
import zstandard

from rotcal_ros.bags.compression import Unpacker
from rotcal_ros.bags.mcap_records import ChunkRecord, DamagedRecord
from rotcal_ros.bags.settings import DEFAULT_LIMITS

ONE, TWO = bytes(range(200)) * 30, b"second" * 400
SKIPPED = struct.pack("<II", 0x184D2A57, 5) + b"hello"


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
    with pytest.raises(DamagedRecord, match="instead of"):
        unpacked(packed(ONE) + packed(TWO), len(ONE) + 1)
    with pytest.raises(DamagedRecord):
        unpacked(packed(ONE)[:-9], len(ONE))
    bomb = packed(bytes(1 << 20)) * 50
    with pytest.raises(DamagedRecord):
        unpacked(bomb, (1 << 20) + 5)
