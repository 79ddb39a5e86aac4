"""One flipped bit anywhere costs what that bit covers, is reported, and repair saves the rest."""

from __future__ import annotations

import os
import random
from pathlib import Path

import pytest
import small_bag
from test_index_check import records

from rotcal_ros.bags.repair import repair
from rotcal_ros.foundation.errors import BagError

LONG = bool(os.environ.get("ROTCAL_LONG_TESTS"))
DATA = small_bag.small_bag(enable_data_crcs=True)
TRUTH = small_bag.truth()
PLACES = records(DATA)
CHUNK, SUMMARY = 0x06, next(offset for opcode, offset in PLACES if opcode == 0x0F)


def flips(count: int, seed: int, first: int = 0) -> list[int]:
    """Return places of bits, as many as there are, or ``count`` of them."""
    places = range(8 * first, 8 * len(DATA))
    return random.Random(seed).sample(places, min(len(places), count))


def flipped(bit: int) -> bytes:
    data = bytearray(DATA)
    data[bit // 8] ^= 1 << bit % 8
    return bytes(data)


def in_one_chunk(bit: int) -> int:
    """Return how many messages a bit covers at most: those of its chunk, if it is in one."""
    begins = [offset for _, offset in PLACES]
    place = max((i for i, begin in enumerate(begins) if begin <= bit // 8), default=0)
    return 16 if PLACES[place][0] == CHUNK else 0


@pytest.mark.slow
@pytest.mark.slow
def test_every_flip_is_told_and_costs_what_it_covers(tmp_path: Path) -> None:
    path = tmp_path / "flipped.mcap"
    for bit in flips(10**9 if LONG else 400, seed=1):
        path.write_bytes(flipped(bit))
        try:
            found = small_bag.read(path)
        except BagError:
            pytest.fail(f"bit {bit}: nothing could be read")
        lost = TRUTH - found.messages
        assert found.verdict.state != "complete", f"bit {bit}"
        assert not found.messages - TRUTH, f"bit {bit}: made up"
        assert lost.total() <= in_one_chunk(bit), f"bit {bit}"
        if found.verdict.lost_exactly:
            assert found.verdict.lost == lost.total(), f"bit {bit}"


def test_a_record_of_the_summary_never_becomes_a_message(tmp_path: Path) -> None:
    channels = [offset for opcode, offset in PLACES if opcode == 0x04]
    assert len(channels) == 6
    for offset in channels:
        (tmp_path / "flipped.mcap").write_bytes(flipped(8 * offset))
        found = small_bag.read(tmp_path / "flipped.mcap")
        assert (found.messages, found.verdict.state) == (TRUTH, "damaged")


def test_repair_saves_all_messages_whatever_happened_to_the_index(tmp_path: Path) -> None:
    path = tmp_path / "flipped.mcap"
    for number, bit in enumerate(flips(1000 if LONG else 12, seed=2, first=SUMMARY)):
        path.write_bytes(flipped(bit))
        (after,) = repair(path, tmp_path / f"good{number}").after
        assert after.state == "complete"
        assert small_bag.read(after.path).messages == TRUTH, f"bit {bit}"


def test_two_flips_in_chunk_and_index(tmp_path: Path) -> None:
    """The definitions are lost with the first chunk; a broken index gives no others."""
    path = tmp_path / "flipped.mcap"
    first = next(offset for opcode, offset in PLACES if opcode == CHUNK)
    for bit in random.Random(3).sample(range(8 * SUMMARY, 8 * len(DATA)), 60):
        data = bytearray(flipped(bit))
        data[first + 100] ^= 1
        path.write_bytes(data)
        found = small_bag.read(path)
        assert not found.messages - TRUTH, f"bit {bit}: made up"
        assert found.verdict.state == "damaged"
