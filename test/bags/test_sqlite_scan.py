"""Sqlite3 bags: of all versions, with what was left beside them, compressed, damaged, forged."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
import zstandard
from bag_samples import START_NS, STORE, serialised
from rosbags.highlevel import AnyReader
from sqlite_bags import PAGE, payloads, write_bag

from rotcal_ros.bags import names
from rotcal_ros.bags.dropouts import MESSAGE_TYPE, Dropout
from rotcal_ros.bags.reader import bag_files, check_files, read_blocks
from rotcal_ros.bags.repair import repair
from rotcal_ros.bags.storage_scan import FileVerdict
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.recordings.missing_data import match_recorded_dropouts
from rotcal_ros.recordings.topics import Topics

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


def test_a_damaged_page_costs_the_rows_about_it_and_their_ids_count_them(path: Path) -> None:
    data = bytearray(path.read_bytes())
    (page,) = [at for at in range(0, len(data), PAGE) if MESSAGES[31] in data[at : at + PAGE]]
    data[page : page + PAGE] = bytes(PAGE)
    path.write_bytes(data)
    found, verdict = read(path)
    assert 0 < 60 - len(found) == verdict.lost < 30
    assert {MESSAGES[0], MESSAGES[59]} < set(found)
    assert found == [message for message in MESSAGES if message in found]
    assert verdict.describe().startswith("damaged at byte ")
    assert any("sqlite3 .recover may save more" in damage.what for damage in verdict.damages)
    (after,) = repair(path, path.parent / "good").after
    assert (after.state, after.messages) == ("complete", len(found))


def test_a_file_that_is_cut_off_is_read_as_far_as_it_goes(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: 12 * PAGE])
    found, verdict = read(path)
    assert found
    assert found == MESSAGES[: len(found)]
    assert verdict.state == "damaged"


@pytest.mark.parametrize("end", ["-wal", "-journal"])
def test_garbage_beside_it_is_no_part_of_it(end: str, path: Path) -> None:
    Path(f"{path}{end}").write_bytes(b"\x17garbage" * 500)
    assert read(path)[0] == MESSAGES


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


@pytest.mark.parametrize(
    "change",
    [
        "UPDATE topics SET name = CAST(x'2fff80' AS TEXT) WHERE id = 1",
        "UPDATE topics SET type = x'2f61'",
        "UPDATE topics SET offered_qos_profiles = CAST(x'ff' AS TEXT)",
        "UPDATE topics SET name = x''",
    ],
)
def test_a_topic_that_others_cannot_name_is_told(change: str, path: Path) -> None:
    with closing(sqlite3.connect(path)) as database, database:
        database.execute(change)
    found, verdict = read(path)
    assert found == MESSAGES
    assert "a name or type that is not UTF-8" in verdict.describe()
    (after,) = repair(path, path.parent / "good").after
    assert (after.state, after.messages) == ("complete", 60)


def test_a_topic_may_leave_out_all_but_name_and_type(path: Path) -> None:
    with closing(sqlite3.connect(path)) as database, database:
        database.executescript(
            "ALTER TABLE topics RENAME TO t; CREATE TABLE topics(id INTEGER PRIMARY KEY,"
            " name TEXT, type TEXT, serialization_format TEXT, offered_qos_profiles TEXT);"
            "INSERT INTO topics(id, name, type) SELECT id, name, type FROM t; DROP TABLE t"
        )
    assert read(path)[1].state == "complete"


def test_another_serialization_is_named_and_not_decoded(path: Path) -> None:
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("UPDATE topics SET serialization_format = 'cbor' WHERE id = 1")
        database.execute("UPDATE topics SET serialization_format = '' WHERE id = 2")
    ((scan, block), _) = read_blocks((path,))
    assert block is not None
    topics = Topics()
    parts = topics.split(block, scan, {})
    assert [part.role for part in parts] == [names.TEMPERATURE]
    assert topics.unreadable == {
        "/cell/tracer_length": "topic /cell/tracer_length: its messages are serialised as 'cbor', "
        "which cannot be read (cdr can); record it from ROS 2"
    }
    repair(path, path.parent / "good")
    ((scan, _), _) = read_blocks(bag_files(path.parent / "good"))
    encodings = {c.topic: c.message_encoding for c in scan.channels.values()}
    assert encodings == {"/cell/tracer_length": "cbor", "/cell/temperature": "cdr"}


def dropouts_message(**changes: str) -> bytes:
    """Return what the recorder says of three messages that are missing, with changes."""
    values = {"topic": "/cell/a", "from_ns": "7", "to_ns": "9", "count": "3", "reason": "a test",
              "gaps": "1", **changes}  # fmt: skip
    types = STORE.types
    pairs = [types["diagnostic_msgs/msg/KeyValue"](name, text) for name, text in values.items()]
    status = types["diagnostic_msgs/msg/DiagnosticStatus"](1, "/cell/a", "text", "", pairs)
    return serialised(MESSAGE_TYPE, stamp_ns=7, status=[status])


def test_the_dropouts_of_a_converted_bag_are_shown(path: Path) -> None:
    """What is not as the recorder writes it is no dropout, whatever numbers it has."""
    odd = ({"to_ns": "9" * 40}, {"count": "-1"}, {"gaps": "x"}, {"from_ns": "1" * 5000})
    with closing(sqlite3.connect(path)) as database, database:
        row = (3, "/cell/recorder/dropouts", MESSAGE_TYPE, "cdr", "", "")
        database.execute("INSERT INTO topics VALUES (?, ?, ?, ?, ?, ?)", row)
        for data in (dropouts_message(), *(dropouts_message(**change) for change in odd)):
            row = (3, START_NS, data)
            database.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES(?,?,?)", row)
    _, verdict = read(path)
    assert verdict.dropouts == (Dropout("/cell/a", 7, 9, 3, "a test"),)
    assert "3 messages missing between 1970-01-01" in verdict.dropouts[0].describe()
    assert match_recorded_dropouts((verdict,))[0].dropout == verdict.dropouts[0]


def test_dropouts_and_observations_of_somebody_else_are_passed_over(path: Path) -> None:
    """The definition of one is not there, that of the other another one."""
    with closing(sqlite3.connect(path)) as database, database:
        for number, name, type_name in (
            (3, "/other/dropouts", MESSAGE_TYPE),
            (4, "/cell/observation", "rotcal_msgs/msg/Observation"),
            (5, "/cell/dropouts", MESSAGE_TYPE),
        ):
            row = (number, name, type_name, "cdr", "", "" if number < 5 else "good")
            database.execute("INSERT INTO topics VALUES (?, ?, ?, ?, ?, ?)", row)
            data = dropouts_message() if number == 5 else b"\0\1\0\0\0"
            row = (number, START_NS, data)
            database.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES(?,?,?)", row)
        text = STORE.generate_msgdef(MESSAGE_TYPE, ros_version=2)[0]
        for type_name, definition, type_hash in (
            (MESSAGE_TYPE, "uint8 status", ""),
            (MESSAGE_TYPE, text, "good"),
            ("rotcal_msgs/msg/Observation", "uint8 step", ""),
        ):
            row = (type_name, "ros2msg", definition, type_hash)
            database.execute("INSERT INTO message_definitions VALUES (NULL, ?, ?, ?, ?)", row)
    _, verdict = read(path)
    assert verdict.state == "complete"
    (found,) = match_recorded_dropouts((verdict,))
    assert found.steps == ()


def test_names_with_questions_and_hashes_in_them(path: Path, tmp_path: Path) -> None:
    odd = tmp_path / "a?b#c%20 d" / "bag_0.db3"
    odd.parent.mkdir()
    shutil.move(path, odd)
    assert read(odd)[0] == MESSAGES


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "it is empty"),
        (b"PK" * 4000, r"not a database; rotcal records MCAP, .* 'sqlite3 FILE .recover'"),
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
    assert len(set(found)) == len(found)
    assert verdict.state == "damaged"


def test_times_that_are_no_integers_are_counted_and_the_cure_named(tmp_path: Path) -> None:
    """Sqlite3 keeps what it is given; rosbag2 writes integers alone."""
    with closing(sqlite3.connect(tmp_path / "bag_0.db3")) as base, base:
        base.execute("CREATE TABLE topics (id INTEGER PRIMARY KEY, name, type,"
                     " serialization_format, offered_qos_profiles)")  # fmt: skip
        base.execute("CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id, timestamp, data)")
        base.execute("INSERT INTO topics VALUES (1, '/a', 'std_msgs/msg/String', 'cdr', '')")
        times = [1_000, "2000", 3_000.0, "1e400", 5_000, "soon", None]
        rows = [(1, time, f"row {number}".encode()) for number, time in enumerate(times)]
        base.executemany("INSERT INTO messages VALUES (NULL, ?, ?, ?)", rows)
    found, verdict = read(tmp_path / "bag_0.db3")
    assert found == [b"row 0", b"row 4"]
    assert (verdict.state, verdict.lost) == ("damaged", 5)
    assert (verdict.start_ns, verdict.end_ns) == (1_000, 5_000)
    told = " ".join(damage.what for damage in verdict.damages)
    assert "4 messages whose time is no integer (UPDATE" in told
    saved = repair(tmp_path / "bag_0.db3", tmp_path / "good")
    assert sum(v.messages for v in saved.after) == 2
