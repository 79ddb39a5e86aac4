"""A session as a whole: what is missing is found, whatever became of metadata.yaml."""

from __future__ import annotations

import errno
import os
import shutil
import struct
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
import yaml
from bag_samples import CONFIGURATION, open_writer
from rosbags.rosbag2 import Reader

from rotcal_ros.bags import names
from rotcal_ros.bags.interrupted_files import InterruptedSession
from rotcal_ros.bags.reader import bag_files, check_files
from rotcal_ros.bags.repair import reindex, repair
from rotcal_ros.bags.rosbag2_metadata import (
    OfferedQos,
    parse_description,
    qos_text,
    read_description,
)
from rotcal_ros.bags.session_identity import require_one_session, session_of
from rotcal_ros.bags.session_verdict import SessionVerdict, judge_session
from rotcal_ros.bags.settings import WriterSettings
from rotcal_ros.bags.writer import BagWriter, McapFile
from rotcal_ros.foundation.errors import BagError

SECOND_NS = 10**9


def judged(path: Path) -> SessionVerdict:
    return judge_session(path, check_files(bag_files(path)))


def put(writer: BagWriter, channel: int, begin: int, number: int = 6) -> None:
    for k in range(begin, begin + number):
        writer.write(channel, struct.pack("<4xQ", k), k * SECOND_NS, k * SECOND_NS)
        writer.tick(k * SECOND_NS)


@cache
def kept() -> Path:
    """Return a folder for bags that are written once and copied often."""
    return Path(tempfile.mkdtemp())


@pytest.fixture(scope="module", autouse=True)
def _cleared() -> Iterator[None]:
    yield
    shutil.rmtree(kept())
    kept.cache_clear()


def split(folder: Path, session: str = "s" * 32, begin: int = 0) -> Path:
    """Return a copy of a session of six files, one message each."""
    original = kept() / f"{session[:1]}{begin}" / folder.name
    if not original.exists():
        write_split(original, session, begin)
    shutil.copytree(original, folder)
    return folder


def resumed(folder: Path) -> Path:
    """Return a copy of a session of two runs; the first one was killed."""
    original = kept() / "resumed" / folder.name
    if not original.exists():
        write_resumed(original)
    shutil.copytree(original, folder)
    return folder


def write_split(folder: Path, session: str, begin: int) -> None:
    settings = WriterSettings(min_free_bytes=0, split_bytes=1)
    writer, channels = open_writer(folder, settings)
    with writer:
        writer.note(names.RUN, {"number": 0} | ({"session": session} if session else {}))
        put(writer, channels[names.TRACER_LENGTH], begin)
    assert len(bag_files(folder)) == 6


def write_resumed(folder: Path) -> None:
    writer, channels = open_writer(folder)
    writer.note(names.RUN, {"number": 0, "session": "r" * 32})
    put(writer, channels[names.TRACER_LENGTH], 0)
    writer.sync()
    writer._lock.release()  # as the system does when the process dies
    left = InterruptedSession.read(folder)
    with BagWriter(folder, WriterSettings(min_free_bytes=0), earlier=left.files) as again:
        left.close_before(again)
        again.note(names.RUN, {"number": 1, "session": left.session})
        channel = again.channel("/cell/other", "demo_msgs/msg/Blob", "uint8[] data\n")
        put(again, channel, 10)


def test_nothing_is_missing(tmp_path: Path) -> None:
    for folder in (split(tmp_path / "split"), resumed(tmp_path / "resumed")):
        verdict = judged(folder)
        assert verdict.sound, verdict
        assert verdict.repaired == ()
        with Reader(folder) as reader:
            assert sum(1 for _ in reader.messages()) == reader.message_count
    assert len(verdict.closed) == 1
    assert "bag" not in verdict.closed[0]
    assert "resumed_0.mcap was interrupted at byte" in verdict.closed[0]


@pytest.mark.parametrize("description", ["kept", "gone", "rebuilt"])
@pytest.mark.parametrize(("kind", "number"), [
    ("split", 0), ("split", 2), ("split", 5), ("resumed", 0), ("resumed", 1),
])  # fmt: skip
def test_a_missing_file_is_found(kind: str, number: int, description: str, tmp_path: Path) -> None:
    folder = (split if kind == "split" else resumed)(tmp_path / "bag")
    (folder / f"bag_{number}.mcap").unlink()
    if description != "kept":
        (folder / "metadata.yaml").unlink()
    if description == "rebuilt":
        reindex(folder)
        assert read_description(folder).names == tuple(f.name for f in bag_files(folder))
    missing = judged(folder).missing
    assert len(missing) == 1
    assert f"the file bag_{number}.mcap of the session is missing" in missing[0]


def test_a_death_while_splitting_leaves_nothing_missing(tmp_path: Path) -> None:
    """The next file is begun, the one before it has no end."""
    bag = tmp_path / "bag"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(McapFile, "finish", Mock(side_effect=OSError(errno.ENOSPC, "")))
        with pytest.raises(BagError, match="disk is full"):
            write_split(bag, "s" * 32, 0)
    assert [v.state for v in check_files(bag_files(bag))] == ["truncated", "truncated"]
    assert judged(bag).missing == ()
    left = InterruptedSession.read(bag)
    writer = BagWriter(bag, WriterSettings(min_free_bytes=0), earlier=left.files)
    with writer:
        left.close_before(writer)
    assert all(v.state == "complete" for v in check_files(bag_files(bag)))
    assert judged(bag).sound
    (bag / "metadata.yaml").unlink()
    (bag / "bag_1.mcap").unlink()
    assert "the session went on in it after bag_0.mcap" in judged(bag / "bag_0.mcap").missing[0]


def test_one_file_alone_is_a_part(tmp_path: Path) -> None:
    folder = resumed(tmp_path / "bag")
    assert "bag_0.mcap of the session was not read" in judged(folder / "bag_1.mcap").missing[0]
    assert "bag_1.mcap of the session was not read" in judged(folder / "bag_0.mcap").missing[0]


def test_a_renamed_or_moved_file_is_no_missing_one(tmp_path: Path) -> None:
    folder = split(tmp_path / "bag")
    (folder / "bag_3.mcap").rename(folder / "three.mcap")
    found = judged(folder)
    assert found.missing == ()
    (words,) = found.differing  # rosbag2 would not find it
    assert words.startswith("metadata.yaml lists bag_3.mcap, which is called three.mcap here")
    reindex(folder)
    assert judged(folder).sound
    writer, channels = open_writer(tmp_path / "single")
    with writer:
        put(writer, channels[names.PLAN], 0)
    moved = tmp_path / "table 7.mcap"
    shutil.copy(tmp_path / "single" / "single_0.mcap", moved)
    assert judged(moved).sound


def test_files_that_have_exchanged_their_names_are_told(tmp_path: Path) -> None:
    folder = split(tmp_path / "bag")
    (folder / "bag_1.mcap").rename(folder / "other")
    (folder / "bag_2.mcap").rename(folder / "bag_1.mcap")
    (folder / "other").rename(folder / "bag_2.mcap")
    found = judged(folder)
    assert found.missing == ()
    told = [text for text in found.differing if "exchanged their names" in text]
    assert [text.split()[0] for text in told] == ["bag_1.mcap", "bag_2.mcap"]


def test_a_repaired_copy_keeps_identity_and_what_was_lost(tmp_path: Path) -> None:
    folder = split(tmp_path / "bag")
    data = bytearray((folder / "bag_1.mcap").read_bytes())
    data = data[: len(data) // 2]
    (folder / "bag_1.mcap").write_bytes(data)
    (folder / "bag_4.mcap").unlink()
    repair(folder, tmp_path / "good")
    repair(tmp_path / "good", tmp_path / "better")
    for copy in (tmp_path / "good", tmp_path / "better"):
        assert session_of(copy) == session_of(folder) == "s" * 32
        verdict = judged(copy)
        gone, cut = verdict.missing
        assert "the file bag_4.mcap of the session is missing" in gone
        assert "bag_1.mcap holds 0 of the 1 messages" in cut
    (repaired,) = judged(tmp_path / "good").repaired
    assert "from bag_1.mcap: truncated at byte" in repaired


def described(folder: Path, **changes: Any) -> SessionVerdict:
    """Change entries of metadata.yaml and judge."""
    path = folder / "metadata.yaml"
    data = yaml.safe_load(path.read_text())
    data["rosbag2_bagfile_information"] |= changes
    path.write_text(yaml.safe_dump(data))
    return judged(folder)


def test_counts_and_times_that_differ_are_said(tmp_path: Path) -> None:
    folder = split(tmp_path / "bag")
    data = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    data["files"][2]["message_count"] = 5
    (short,) = described(folder, files=data["files"]).missing
    assert short.startswith("bag_2.mcap holds 1 of the 5 messages")
    data["files"][2]["message_count"] = 0
    (text,) = described(folder, files=data["files"]).differing
    assert "lists 0 messages in bag_2.mcap, it holds 1" in text
    data["files"][2]["message_count"] = 1
    assert described(folder, files=data["files"]).sound
    (text,) = described(folder, duration={"nanoseconds": 9 * SECOND_NS}).differing
    assert text == "metadata.yaml lists 9.000 s, the messages span 5.000 s"
    listed = [f"bag_{k}.mcap" for k in range(5)]
    right = {"nanoseconds": 5 * SECOND_NS}
    (text,) = described(folder, duration=right, relative_file_paths=listed).differing
    assert text == "metadata.yaml does not list bag_5.mcap"


BROKEN = {
    "empty": "",
    "binary": "\udcff\udcfe",
    "list": "[1, 2]",
    "deep": "[" * 100_000,
    "laughs": "a: &a [x,x,x,x,x,x,x,x]\n" + "".join(
        f"{chr(98 + k)}: &{chr(98 + k)} [{','.join(['*' + chr(97 + k)] * 9)}]\n" for k in range(9)
    ),
    "tag": "!!python/object/apply:os.system ['true']",
    "version": "rosbag2_bagfile_information: {version: 10}",
    "negative": "rosbag2_bagfile_information: {version: -1}",
    "cut": "rosbag2_bagfile_information:\n  version: 9\n  relative_file_paths:\n    - bag_0.mc",
    "types": "rosbag2_bagfile_information: {version: 5, message_count: x, relative_file_paths: 3}",
    "path": "rosbag2_bagfile_information: {version: 5, message_count: 0,"
    " duration: {nanoseconds: 0}, starting_time: {nanoseconds_since_epoch: 0},"
    " relative_file_paths: ['..']}",
    "date": "rosbag2_bagfile_information: 2026-99-99",
}  # fmt: skip


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_description_is_one_line_and_reindex_heals_it(kind: str, tmp_path: Path) -> None:
    folder = resumed(tmp_path / "bag")
    path = folder / "metadata.yaml"
    path.write_bytes(BROKEN[kind].encode(errors="surrogateescape"))
    broken = path.read_bytes()
    (text,) = judged(folder).differing
    assert "metadata.yaml" in text
    assert "rotcal bag reindex" in text
    assert "\n" not in text
    outcome = reindex(folder)
    assert outcome.old is not None
    assert outcome.old.read_bytes() == broken
    assert judged(folder).sound
    with Reader(folder) as reader:
        assert sum(1 for _ in reader.messages()) == reader.message_count == 12


def test_a_description_that_is_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    folder = resumed(tmp_path / "bag")
    (folder / "metadata.yaml").unlink()
    os.mkfifo(folder / "metadata.yaml")
    assert "metadata.yaml" in judged(folder).differing[0]


V1 = """rosbag2_bagfile_information:
  version: 1
  storage_identifier: sqlite3
  relative_file_paths: [cell_bag/cell_bag_0.db3]
  duration: {nanoseconds: 4000000000}
  starting_time: {nanoseconds_since_epoch: 7}
  message_count: 3
  topics_with_message_count:
    - topic_metadata: {name: /a, type: std_msgs/msg/String, serialization_format: cdr}
      message_count: 3
"""
V5 = (
    V1.replace("version: 1", "version: 5").replace("cell_bag/", "")
    + """  compression_format: zstd
  compression_mode: FILE
  files:
    - path: cell_bag_0.db3
      starting_time: {nanoseconds_since_epoch: 7}
      duration: {nanoseconds: 4000000000}
      message_count: 3
"""
)


def test_old_versions_are_understood() -> None:
    old, humble = parse_description(V1, "v1"), parse_description(V5, "v5")
    assert old.names == humble.names == ("cell_bag_0.db3",)
    assert (old.files[0].messages, humble.files[0].messages) == (None, 3)
    assert (old.messages, old.topics, old.duration_ns) == (3, {"/a": 3}, 4 * SECOND_NS)
    assert (old.compression_mode, humble.compression_mode) == ("", "file")


def test_of_very_many_missing_files_the_first_are_named(tmp_path: Path) -> None:
    """One of them has a name that no file can have."""
    folder = split(tmp_path / "bag")
    data = yaml.safe_load((folder / "metadata.yaml").read_text())
    listed = data["rosbag2_bagfile_information"]["relative_file_paths"]
    listed += ["n" * 300, *(f"x{number}.mcap" for number in range(500))]
    (folder / "metadata.yaml").write_text(yaml.safe_dump(data))
    missing = judged(folder).missing
    assert len(missing) == 101
    assert missing[0].startswith(f"the file {'n' * 300} of the session is missing")
    assert missing[-1] == "and 401 more"
    data["rosbag2_bagfile_information"]["relative_file_paths"] = "bag_0.mcap"
    (folder / "metadata.yaml").write_text(yaml.safe_dump(data))
    assert "relative_file_paths is not a list" in judged(folder).differing[0]


def test_reindex_refuses_what_it_cannot_know(tmp_path: Path) -> None:
    folder = split(tmp_path / "bag")
    before = (folder / "metadata.yaml").read_bytes()
    (folder / "bag_5.mcap").write_bytes((folder / "bag_5.mcap").read_bytes()[:-20])
    with pytest.raises(BagError, match=r"bag_5\.mcap is truncated.*rotcal bag repair"):
        reindex(folder)
    assert (folder / "metadata.yaml").read_bytes() == before
    with pytest.raises(BagError, match="is not a folder"):
        reindex(folder / "bag_0.mcap")
    assert not list(folder.glob("*.old*"))


@pytest.mark.parametrize("stated", [True, False])
def test_files_of_two_measurements_are_refused_and_named(stated: bool, tmp_path: Path) -> None:
    first = split(tmp_path / "one", "1" * 32 if stated else "")
    second = split(tmp_path / "two", "2" * 32 if stated else "", begin=100)
    require_one_session(bag_files(first))
    for file in bag_files(second):
        shutil.copy(file, first)
    with pytest.raises(BagError, match="files of 2 measurements") as error:
        require_one_session(bag_files(first))
    text = str(error.value)
    assert all(f"{name}_{k}.mcap" in text for name in ("one", "two") for k in range(6))
    assert "1970-01-01T00:01:40 UTC" in text


def test_a_copy_beside_its_original_is_refused(tmp_path: Path) -> None:
    folder = resumed(tmp_path / "bag")
    repair(folder, tmp_path / "good")
    shutil.copy(tmp_path / "good" / "good_0.mcap", folder)
    with pytest.raises(BagError, match="one is a copy of the other"):
        require_one_session(bag_files(folder))


def test_a_session_of_an_earlier_version_is_continued_as_one(tmp_path: Path) -> None:
    folder = split(tmp_path / "bag", "")
    left = InterruptedSession.read(folder)
    with BagWriter(folder, WriterSettings(min_free_bytes=0), earlier=left.files) as writer:
        left.close_before(writer)
        writer.note(names.RUN, {"number": 6, "session": left.session})
        writer.attach(names.CONFIGURATION, "application/yaml", CONFIGURATION.encode())
        put(writer, writer.channel("/a", "demo_msgs/msg/Blob", "uint8[] data\n"), 50)
    require_one_session(bag_files(folder))
    assert judged(folder).sound


def test_a_topic_with_more_publishers_than_before_is_one_connection_for_others(
    tmp_path: Path,
) -> None:
    folder, blob = tmp_path / "bag", ("/a", "demo_msgs/msg/Blob", "uint8[] data\n", "")
    before, later = (qos_text([OfferedQos(depth=10)] * publishers) for publishers in (3, 5))
    with BagWriter(folder, WriterSettings(min_free_bytes=0)) as writer:
        put(writer, writer.channel(*blob, before), 0)
    with BagWriter(
        folder, WriterSettings(min_free_bytes=0), earlier=InterruptedSession.read(folder).files
    ) as more:
        put(more, more.channel(*blob, later), 50)
    with Reader(folder) as reader:
        assert sum(1 for _ in reader.messages()) == reader.message_count > 0
