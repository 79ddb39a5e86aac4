"""Messages are sorted by a time without holding them all."""

import tempfile
import tracemalloc

import numpy as np
import pytest

from rotcal_ros.bags import time_order
from rotcal_ros.bags.blocks import HEADER_TYPE, Block
from rotcal_ros.bags.time_order import BlockSorter


def blocks_of(keys, payloads, per_block):
    for begin in range(0, len(keys), per_block):
        part = payloads[begin : begin + per_block]
        size = np.array([len(p) for p in part], np.int64)
        headers = np.zeros(len(part), HEADER_TYPE)
        headers["sequence"] = np.arange(begin, begin + len(part))
        data = b"head" + b"".join(part)
        yield (
            Block(data, 4 + np.cumsum(size) - size, size, headers),
            keys[begin : begin + per_block],
        )


@pytest.mark.parametrize("together", [1, 64, 1 << 18])
@pytest.mark.parametrize("per_block", [1, 7, 1000])
def test_all_messages_come_by_their_keys_and_equal_ones_in_their_order(
    together, per_block, monkeypatch
):
    monkeypatch.setattr(time_order, "_PIECE", together)
    monkeypatch.setattr(time_order, "_ROWS", together)
    rng = np.random.default_rng(8)
    keys = rng.integers(0, 60, 300)
    payloads = [bytes(rng.integers(0, 256, rng.integers(0, 90), np.uint8)) for _ in keys]
    sorting = BlockSorter()
    for block, mine in blocks_of(keys, payloads, per_block):
        sorting.add(block, mine)
    found = [
        (int(b.headers["log_time"][row]), int(b.headers["sequence"][row]), b.payload(row))
        for b in sorting.blocks()
        for row in range(len(b))
    ]
    assert found == sorted((int(k), n, payloads[n]) for n, k in enumerate(keys))


def test_nothing_gives_nothing_and_needs_no_disk(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "not there"))
    assert list(BlockSorter().blocks()) == []


def test_messages_without_a_payload_are_sorted():
    sorting = BlockSorter()
    for block, mine in blocks_of(np.array([3, 1, 2]), [b""] * 3, 2):
        sorting.add(block, mine)
    (block,) = sorting.blocks()
    assert block.headers["log_time"].tolist() == [1, 2, 3]
    assert block.headers["sequence"].tolist() == [1, 2, 0]


@pytest.mark.slow
def test_messages_wait_on_the_disk():
    rng = np.random.default_rng(2)
    payload = bytes(1000)
    tracemalloc.start()
    sorting = BlockSorter()
    for _ in range(30):  # 30 MB
        for block, keys in blocks_of(rng.integers(0, 1 << 40, 1000), [payload] * 1000, 1000):
            sorting.add(block, keys)
    count = sum(len(block) for block in sorting.blocks())
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert count == 30_000
    assert peak < 20 << 20
