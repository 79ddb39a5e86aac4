"""Repair saves everything that can be read and leaves the original alone."""

from __future__ import annotations

import random
from hashlib import sha256
from pathlib import Path

import pytest
from bag_samples import STORE, TYPES, Run
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from rotcal_ros.bags import names
from rotcal_ros.bags.interrupted_files import InterruptedSession
from rotcal_ros.bags.mcap_records import CHUNK, MAGIC
from rotcal_ros.bags.reader import bag_files, check_files, read_blocks
from rotcal_ros.bags.repair import repair
from rotcal_ros.bags.settings import WriterSettings
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.recordings.replay import read_recording


def damaged(run_bag: Path, tmp_path: Path, cut: float = 1.0, flips: int = 0) -> Path:
    data = bytearray((run_bag / "run_0.mcap").read_bytes())
    data = data[: int(len(data) * cut)]
    chance = random.Random(7)
    for _ in range(flips):
        data[chance.randrange(100, len(data))] ^= 0x10
    path = tmp_path / "bad_0.mcap"
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(("cut", "flips"), [(0.6, 0), (1.0, 3), (0.9, 20)])
def test_repaired_bag_is_sound_and_holds_all_that_was_readable(
    run_bag: Path, tmp_path: Path, cut: float, flips: int
) -> None:
    path = damaged(run_bag, tmp_path, cut, flips)
    original = path.read_bytes()
    (before,) = check_files((path,))
    outcome = repair(path, tmp_path / "good")
    assert path.read_bytes() == original
    (after,) = outcome.after
    assert after.state == "complete"
    assert after.messages == before.messages > 0
    with AnyReader([tmp_path / "good"]) as reader:
        assert sum(1 for _ in reader.messages()) == before.messages
        for connection in reader.connections:
            role = connection.topic.rpartition("/")[2]
            assert connection.digest == STORE.hash_rihs01(TYPES[role])


def test_truncated_bag_solves_the_same_after_repair(
    run_bag: Path, simulated_run: Run, tmp_path: Path
) -> None:
    path = damaged(run_bag, tmp_path, cut=0.7)
    repair(path, tmp_path / "good")
    before, after = read_recording(path), read_recording(tmp_path / "good")
    assert after.observations == before.observations
    assert after.observations == tuple(simulated_run.observations[: len(after.observations)])
    assert len(after.observations) > 10


def test_schema_chunk_damaged_and_no_index(run_bag: Path, tmp_path: Path) -> None:
    data = bytearray((run_bag / "run_0.mcap").read_bytes()[:200_000])
    position = len(MAGIC)
    while data[position] != CHUNK:
        position += 9 + int.from_bytes(data[position + 1 : position + 9], "little")
    data[position + 300] ^= 0xFF
    path = tmp_path / "bad_0.mcap"
    path.write_bytes(data)
    (after,) = repair(path, tmp_path / "good").after
    assert after.state == "complete"
    assert after.topics["/cell/tracer_length"].messages > 1000
    assert "configuration.yaml" in read_recording(tmp_path / "good").attachments


def test_runs_stay_apart_and_losses_add_up(tmp_path: Path) -> None:
    for run, lost in ((0, 3), (1, 2)):
        earlier = InterruptedSession.read(tmp_path / "bag").files if run else None
        with BagWriter(tmp_path / "bag", WriterSettings(min_free_bytes=0), earlier=earlier) as bag:
            bag.note(names.RUN, {"number": run})
            channel = bag.channel("/a", "demo_msgs/msg/Blob", "uint8[] data\n")
            bag.write(channel, bytes([0, 1, 0, 0, run]), run, run)
            bag.note(names.LOSSES, {"lost /a": lost})
    (after,) = repair(tmp_path / "bag", tmp_path / "good").after
    assert after.losses_recorded == {"lost /a": 5}
    found = [
        (scan.metadata[names.RUN]["number"], block.payload(row)[-1])
        for scan, block in read_blocks(bag_files(tmp_path / "good"))
        if block is not None
        for row in range(len(block))
    ]
    assert found == [("0", 0), ("1", 1)]


def test_nothing_is_overwritten(run_bag: Path, tmp_path: Path) -> None:
    path = damaged(run_bag, tmp_path)
    (tmp_path / "good").mkdir()
    with pytest.raises(BagError, match="exists already"):
        repair(path, tmp_path / "good")


def test_sound_bag_keeps_sequence_and_times(run_bag: Path, tmp_path: Path) -> None:
    (verdict,) = repair(run_bag, tmp_path / "copy").before
    streams = []
    for folder in (run_bag, tmp_path / "copy"):
        with AnyReader([folder]) as reader:
            streams.append([(c.topic, t, bytes(d)) for c, t, d in reader.messages()])
    assert streams[0] == streams[1]
    (copied,) = bag_files(tmp_path / "copy")
    with copied.open("rb") as file:
        notes = {record.name: record.metadata for record in make_reader(file).iter_metadata()}
    record = notes["rotcal_repair"]
    assert record["run_0.mcap"] == verdict.describe()
    assert record["run_0.mcap sha256"] == sha256(verdict.path.read_bytes()).hexdigest()
    assert (record["run_0.mcap lost"], record["run_0.mcap damages"]) == ("{}", "[]")
    assert "complete" in verdict.describe()
