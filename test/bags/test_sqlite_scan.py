"""Sqlite3 bags: of all versions, with what was left beside them, compressed, damaged, forged."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
import zstandard
from bag_samples import START_NS
from rosbags.highlevel import AnyReader
from sqlite_mutations import PAGE, payloads, write_bag

from rotcal_ros.bags.reader import check_files, read_blocks
from rotcal_ros.bags.repair import repair
from rotcal_ros.bags.verdict import FileVerdict
from rotcal_ros.errors import BagError

MESSAGES = payloads(60)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    write_bag(tmp_path / "bag_0.db3", MESSAGES)
    return tmp_path / "bag_0.db3"


def read(path: Path) -> tuple[list[bytes], FileVerdict]:
    found: list[bytes] = []
    for scan, block in read_blocks((path,)):
        if block is None:
            return found, scan.verdict()
        found += [block.payload(row) for row in range(len(block))]
    raise AssertionError


@pytest.mark.parametrize("version", [1, 2, 3, 4])
@pytest.mark.parametrize("page", [512, 4096, 65536])
def test_all_versions_and_page_sizes(version: int, page: int, tmp_path: Path) -> None:
    write_bag(tmp_path / "bag.db3", MESSAGES, version, page)
    found, verdict = read(tmp_path / "bag.db3")
    assert found == MESSAGES
    assert (verdict.state, verdict.lost_exactly) == ("complete", True)
    assert (verdict.start_ns, verdict.end_ns) == (START_NS, START_NS + 59)
    repair(tmp_path / "bag.db3", tmp_path / "good")
    with AnyReader([tmp_path / "good"]) as reader:
        assert [bytes(data) for _, _, data in reader.messages()] == MESSAGES
        profiles = [len(c.ext.offered_qos_profiles) for c in reader.connections]  # type: ignore[union-attr]
    assert profiles == ([0, 0] if version == 1 else [1, 1])


@pytest.mark.parametrize("page", [512, 4096, 65536])
def test_leaf_pages_are_enough(page: int, tmp_path: Path) -> None:
    """Without the first page nothing says how large pages are, nor where a table begins."""
    write_bag(tmp_path / "bag.db3", MESSAGES, page=page)
    data = (tmp_path / "bag.db3").read_bytes()
    (tmp_path / "bag.db3").write_bytes(bytes(100) + data[100:])
    found, verdict = read(tmp_path / "bag.db3")
    assert found == MESSAGES
    assert verdict.state == "damaged"
    assert not verdict.lost_exactly


def test_missing_rows_are_counted_by_their_ids(path: Path) -> None:
    data = bytearray(path.read_bytes())
    (page,) = [at for at in range(0, len(data), PAGE) if MESSAGES[31] in data[at : at + PAGE]]
    data[page : page + PAGE] = bytes(PAGE)
    path.write_bytes(data)
    found, verdict = read(path)
    assert 0 < 60 - len(found) == verdict.lost
    assert found == [message for message in MESSAGES if message in found]
    assert verdict.sentence().startswith("damaged at byte ")


@pytest.mark.parametrize("left", ["-wal", "-journal"])
def test_what_was_left_beside_is_heeded_in_a_copy(left: str, path: Path, tmp_path: Path) -> None:
    """A write-ahead log has 10 messages more; a hot journal takes a half-written one back."""
    crash = tmp_path / "crash"
    crash.mkdir()
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        mode = "WAL" if left == "-wal" else "DELETE"
        database.execute(f"PRAGMA journal_mode = {mode}")
        database.execute("PRAGMA cache_size = 1")
        database.execute("BEGIN")
        for number in range(10 if left == "-wal" else 2000):
            row = (1, START_NS + 100 + number, MESSAGES[1])
            database.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES(?,?,?)", row)
        if left == "-wal":
            database.execute("COMMIT")
        for file in tmp_path.glob("bag_0.db3*"):
            shutil.copy(file, crash)
    assert (crash / f"bag_0.db3{left}").stat().st_size
    before = {file.name: file.read_bytes() for file in crash.iterdir()}
    found, verdict = read(crash / "bag_0.db3")
    assert found == MESSAGES + [MESSAGES[1]] * 10 * (left == "-wal")
    assert verdict.state == "complete"
    assert {file.name: file.read_bytes() for file in crash.iterdir()} == before


@pytest.mark.parametrize("declared", [True, False])
def test_messages_compressed_one_by_one(declared: bool, tmp_path: Path) -> None:
    packed = [zstandard.compress(message) for message in MESSAGES]
    write_bag(tmp_path / "bag_0.db3", [*packed[:-1], packed[-1][:-1]])
    if declared:
        text = "  compression_format: zstd\n  compression_mode: MESSAGE\n"
        (tmp_path / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n{text}")
    found, verdict = read(tmp_path / "bag_0.db3")
    assert found == MESSAGES[:-1]
    assert (verdict.state, verdict.lost) == ("damaged", 1)
    repair(tmp_path / "bag_0.db3", tmp_path / "good")
    with AnyReader([tmp_path / "good"]) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)


def test_a_compression_that_nobody_knows_is_refused_and_nothing_repaired(path: Path) -> None:
    (path.parent / "metadata.yaml").write_text(
        "compression_format: lzma\ncompression_mode: MESSAGE"
    )
    for action in (lambda: check_files((path,)), lambda: repair(path, path.parent / "good")):
        with pytest.raises(BagError, match=r"bag_0.db3: its messages .* 'lzma'"):
            action()


def test_names_with_questions_and_hashes_in_them(path: Path, tmp_path: Path) -> None:
    odd = tmp_path / "a?b#c%20 d" / "bag_0.db3"
    odd.parent.mkdir()
    shutil.move(path, odd)
    assert read(odd)[0] == MESSAGES


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "it is empty"),
        (b"PK" * 4000, "no page of it holds a row"),
        (None, "it is a folder, expected a file"),
    ],
)
def test_what_is_no_database_is_refused(content: bytes | None, words: str, tmp_path: Path) -> None:
    path = tmp_path / "odd.db3"
    path.write_bytes(content) if content is not None else path.mkdir()
    with pytest.raises(BagError, match=words):
        check_files((path,))


def test_a_tree_that_leads_to_a_page_again_and_again_ends(path: Path) -> None:
    """Every pointer of the tree of messages leads to the same page."""
    data = bytearray(path.read_bytes())
    for page in range(PAGE, len(data), PAGE):
        if data[page] != 5:
            continue
        count = int.from_bytes(data[page + 3 : page + 5], "big")
        for cell in range(count):
            at = page + int.from_bytes(data[page + 12 + 2 * cell : page + 14 + 2 * cell], "big")
            data[at : at + 4] = (page // PAGE + 1).to_bytes(4, "big")
    path.write_bytes(data)
    found, verdict = read(path)
    assert sorted(found) == sorted(MESSAGES)
    assert verdict.state == "damaged"
