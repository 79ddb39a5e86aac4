"""The writing half of the recorder, in processes of its own that end at seeded moments.

Each case is a real process: the queue, the writer's thread and the file of the recorder, without
DDS. test/nodes/test_kill_graph.py does the same to the whole graph.
"""

import multiprocessing
import random
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from kill_writer import READING, TOPICS, record
from mcap.reader import SeekingReader
from rosbags.rosbag2 import Reader

from rotcal_ros.bags import names
from rotcal_ros.bags.reader import bag_files, check_files, read_blocks
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.foundation.machine_load import load_scaled_timeout

AT_ONCE = 4
KILLS = 16
"""Per test and batch: 122 deaths in all."""
LAST_SECOND_NS = 10**9
DEADLINE_S = 60.0


@dataclass
class Death:
    """What the parent knew when a recording process ended."""

    folder: Path
    ended_ns: int = 0
    receipts: list[int] = field(default_factory=list)
    last_word: tuple = ()


@pytest.fixture(scope="module")
def processes():
    """Return a context whose processes start in milliseconds, from a server without threads."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["kill_writer"])
    return context


def live(processes, folder, seed, number, **how):
    """Let a process record, end it by signal ``number`` at a moment drawn from ``seed``."""
    delay_s = random.Random(seed).uniform(0.0, 0.5)
    mine, theirs = processes.Pipe(duplex=False)
    process = processes.Process(target=record, args=(folder, theirs, how), daemon=True)
    process.start()
    theirs.close()
    death = Death(folder)
    end_s = None
    try:
        while process.is_alive() or mine.poll():
            if mine.poll(0.002):
                _listen(mine, death)
                end_s = end_s or time.monotonic() + delay_s
            if end_s is not None and number is not None and time.monotonic() >= end_s:
                death.ended_ns = time.monotonic_ns()
                process.kill() if number == "KILL" else process.terminate()
                number = None
    except EOFError:
        pass
    process.join(load_scaled_timeout(DEADLINE_S))
    return death


def _listen(mine, death):
    word = mine.recv()
    if word[0] == "receipt":
        death.receipts.append(word[1])
    else:
        death.last_word = word


def numbers(folder):
    """Return topic -> [(number, time of sending)] of all that can be read; it must be readable."""
    found = {topic: [] for topic in TOPICS}
    verdicts = []
    for scan, block in read_blocks(bag_files(folder)):
        if block is None:
            verdicts.append(scan.verdict())
            continue
        for row, channel in enumerate(block.headers["channel"].tolist()):
            reading = READING.unpack(block.payload(row))
            found[scan.channels[channel].topic].append(reading)
    return found, verdicts


def check(death):
    """Everything confirmed is there, nothing but the last second is missing, all in order."""
    found, verdicts = numbers(death.folder)
    assert all(verdict.state in ("complete", "truncated") for verdict in verdicts)
    observations = {number for number, _ in found[TOPICS[2]]}
    assert set(death.receipts) <= observations
    assert death.receipts == list(range(len(death.receipts)))
    for readings in found.values():
        assert [number for number, _ in readings] == list(range(len(readings)))
    last_ns = found[TOPICS[0]][-1][1]
    assert death.ended_ns - last_ns < LAST_SECOND_NS
    return verdicts


def many(function, count, first_seed):
    """Run cases side by side: they mostly wait."""
    with ThreadPoolExecutor(AT_ONCE) as pool:
        return list(pool.map(function, range(first_seed, first_seed + count)))


@pytest.mark.parametrize(
    "batch", [0, *(pytest.param(n, marks=pytest.mark.long) for n in range(1, 4))]
)
def test_kill_9_costs_nothing_that_was_confirmed(processes, tmp_path, batch):
    def case(seed):
        death = live(processes, tmp_path / str(seed) / "bag", seed, "KILL")
        assert death.receipts, "killed before the first receipt"
        check(death)

    many(case, KILLS, 1000 * batch)


@pytest.mark.slow
def test_kill_9_between_splits(processes, tmp_path):
    def case(seed):
        death = live(processes, tmp_path / str(seed) / "bag", seed, "KILL", split_bytes=2_000)
        return len(check(death))

    assert max(many(case, KILLS, 5000)) > 1


@pytest.mark.slow
def test_who_goes_on_closes_what_the_first_death_left_open(processes, tmp_path):
    """No whole record changes, and others' readers take the file as they take any."""

    def case(seed):
        folder = tmp_path / str(seed) / "bag"
        live(processes, folder, seed, "KILL")
        (first,) = bag_files(folder)
        left = first.read_bytes()
        (verdict,) = check_files((first,))
        second = live(processes, folder, seed + 1, "KILL", resume=True)
        after = bag_files(folder)
        assert len(after) == 2
        with first.open("rb") as file:
            reader = SeekingReader(file, validate_crcs=True)
            notes = {record.name: record.metadata for record in reader.iter_metadata()}
            torn = [a.data for a in reader.iter_attachments() if a.name == names.TORN]
            assert sum(1 for _ in reader.iter_messages()) == verdict.messages
        whole = int(notes[names.CONTINUED]["interrupted_at_byte"])
        assert first.read_bytes()[:whole] + b"".join(torn) == left
        assert notes[names.CONTINUED]["in"] == after[1].name
        with Reader(first) as reader:
            assert sum(1 for _ in reader.messages()) == verdict.messages
        (tmp_path / f"{seed}_second").mkdir()
        new = tmp_path / f"{seed}_second" / after[1].name
        new.write_bytes(after[1].read_bytes())
        second.folder = new
        check(second)

    many(case, KILLS // 2, 6000)


@pytest.mark.slow
def test_sigterm_closes_the_bag(processes, tmp_path):
    def case(seed):
        death = live(processes, tmp_path / str(seed) / "bag", seed, "TERM")
        assert death.last_word[0] == "closed"
        (verdict,) = check(death)
        assert verdict.state == "complete"
        assert verdict.topics[TOPICS[0]].messages == death.last_word[1]

    many(case, KILLS // 2, 7000)


@pytest.mark.slow
def test_a_jumping_clock_loses_nothing(processes, tmp_path):
    many(
        lambda seed: check(
            live(processes, tmp_path / str(seed) / "bag", seed, "KILL", clock=True)
        ),
        KILLS // 2,
        8000,
    )


@pytest.mark.slow
def test_a_disk_that_fills_up_ends_the_bag_behind_a_whole_record(processes, tmp_path):
    """The system allows no larger file (RLIMIT_FSIZE): the write fails like on a full disk."""

    def case(seed):
        limit = random.Random(seed).randrange(6_000, 40_000)
        death = live(processes, tmp_path / str(seed) / "bag", seed, None, file_limit=limit)
        kind, text = death.last_word
        assert kind == "error"
        assert "cannot write the bag" in text
        found, (verdict,) = numbers(death.folder)
        assert verdict.state == "truncated"
        assert not verdict.lost
        assert verdict.path.stat().st_size <= limit
        assert set(death.receipts) <= {number for number, _ in found[TOPICS[2]]}

    many(case, KILLS // 2, 9000)


def test_a_folder_without_the_right_to_write_is_one_clear_sentence(processes, tmp_path):
    tmp_path.chmod(0o555)
    try:
        death = live(processes, tmp_path / "bag", 1, None, nobody=True)
    finally:
        tmp_path.chmod(0o755)
    assert death.last_word == (
        "error",
        f"cannot write the bag {tmp_path / 'bag'}: writing is not permitted; what was synced "
        "before is safe, the last records may be missing; make room or choose another folder",
    )


def test_two_recorders_never_share_a_folder(tmp_path):
    with BagWriter(tmp_path / "bag"), pytest.raises(Exception, match="another process still"):
        BagWriter(tmp_path / "bag", earlier=())
