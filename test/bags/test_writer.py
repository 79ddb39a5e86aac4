"""The writer: exclusive, durable, counted, split, and orderly when the disk fails."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from bag_samples import CONFIGURATION, START_NS, TYPES, open_writer, serialised, writer_settings

from rotcal_ros.bags import names
from rotcal_ros.bags.interrupted_files import InterruptedSession
from rotcal_ros.bags.mcap_scan import McapScan
from rotcal_ros.bags.reader import bag_files, check_files
from rotcal_ros.bags.rosbag2_metadata import FileInfo
from rotcal_ros.bags.settings import WriterSettings
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.files import DurableFile


def tracer_message(number: int) -> bytes:
    return serialised(
        TYPES[names.TRACER_LENGTH], stamp_ns=START_NS + number, sequence=number, length=0.25,
        length_std=1e-7, status=1,
    )  # fmt: skip


def fill(writer: BagWriter, channels: dict[str, int], count: int, first: int = 0) -> None:
    for number in range(first, first + count):
        time_ns = START_NS + number * 1_000_000
        writer.write(channels[names.TRACER_LENGTH], tracer_message(number), time_ns, time_ns)


def readable(path: Path) -> int:
    scan = McapScan(path)
    return sum(len(block) for block in scan.blocks())


def test_synced_messages_are_on_disk_before_close(tmp_path: Path) -> None:
    writer, channels = open_writer(tmp_path / "bag")
    fill(writer, channels, 10)
    assert readable(writer.path) == 0  # still in the open chunk
    writer.sync()
    assert readable(writer.path) == 10
    fill(writer, channels, 5)
    assert not writer.tick(0)  # starts the clock
    assert not writer.tick(400_000_000)
    assert readable(writer.path) == 10
    assert writer.tick(500_000_000)
    assert readable(writer.path) == 15
    writer.close()


def test_sync_calls_fsync_after_the_data_were_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer, channels = open_writer(tmp_path / "bag")
    fill(writer, channels, 3)
    sizes: list[int] = []
    real = os.fsync
    monkeypatch.setattr(os, "fsync", lambda fd: (sizes.append(os.fstat(fd).st_size), real(fd)))
    before = writer.path.stat().st_size
    writer.sync()
    assert sizes == [writer.path.stat().st_size]
    assert sizes[0] > before
    writer.close()


def test_existing_folder_is_refused_and_untouched(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "precious").write_text("old")
    with pytest.raises(BagError, match="exists already"):
        BagWriter(tmp_path / "bag")
    assert [p.name for p in (tmp_path / "bag").iterdir()] == ["precious"]


def test_resumed_session_goes_on_in_a_new_file(tmp_path: Path) -> None:
    writer, channels = open_writer(tmp_path / "bag")
    fill(writer, channels, 4)
    writer.sync()  # and never closed
    first = (tmp_path / "bag" / "bag_0.mcap").read_bytes()
    writer._lock.release()  # as the system does when the process dies
    earlier = InterruptedSession.read(tmp_path / "bag").files
    assert earlier == (
        FileInfo("bag_0.mcap", START_NS, START_NS + 3_000_000, {"/cell/tracer_length": 4}),
    )
    with BagWriter(tmp_path / "bag", WriterSettings(min_free_bytes=0), earlier=earlier) as again:
        assert again.path.name == "bag_1.mcap"
    assert (tmp_path / "bag" / "bag_0.mcap").read_bytes() == first
    metadata = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())
    information = metadata["rosbag2_bagfile_information"]
    assert information["relative_file_paths"] == ["bag_0.mcap", "bag_1.mcap"]
    assert information["message_count"] == 4
    assert [file["message_count"] for file in information["files"]] == [4, 0]


def test_metadata_is_there_from_the_start_and_complete_at_the_end(tmp_path: Path) -> None:
    writer, channels = open_writer(tmp_path / "bag")
    begun = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())
    assert begun["rosbag2_bagfile_information"]["relative_file_paths"] == ["bag_0.mcap"]
    fill(writer, channels, 7)
    writer.close()
    information = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())[
        "rosbag2_bagfile_information"
    ]
    assert information["version"] == 9
    assert information["message_count"] == 7
    assert information["starting_time"]["nanoseconds_since_epoch"] == START_NS
    assert information["duration"]["nanoseconds"] == 6_000_000
    assert information["ros_distro"] == "kilted"
    counts = {
        t["topic_metadata"]["name"]: t["message_count"]
        for t in information["topics_with_message_count"]
    }
    assert counts == writer.counts
    assert counts["/cell/tracer_length"] == 7
    assert not list((tmp_path / "bag").glob("*.tmp"))


@pytest.mark.slow
def test_split_files_stand_alone_and_lose_nothing(tmp_path: Path) -> None:
    settings = writer_settings(chunk_bytes=1024, split_bytes=10_000)
    writer, channels = open_writer(tmp_path / "bag", settings)
    with writer:
        for start in range(0, 300, 20):
            fill(writer, channels, 20, start)
            writer.sync()
    files = bag_files(tmp_path / "bag")
    assert len(files) > 2
    assert sum(v.messages for v in check_files(files)) == 300
    for file in files:
        scan = McapScan(file)
        list(scan.blocks())
        assert scan.attachments[names.CONFIGURATION].data == CONFIGURATION.encode()
        assert len(scan.channels) == len(TYPES)
    assert writer.counts["/cell/tracer_length"] == 300


def test_notes_are_in_the_file_and_the_last_one_counts(tmp_path: Path) -> None:
    writer, channels = open_writer(tmp_path / "bag")
    with writer:
        writer.note(names.LOSSES, {"tracer_length queue": 0})
        size = writer.path.stat().st_size
        writer.note(names.LOSSES, {"tracer_length queue": 0})
        assert writer.path.stat().st_size == size
        fill(writer, channels, 1)
        writer.note(names.LOSSES, {"tracer_length queue": 3})
    (verdict,) = check_files(bag_files(tmp_path / "bag"))
    assert verdict.losses_recorded == {"tracer_length queue": 3}


class FullDisk:
    """os.write with only ``room`` bytes left; writes as much as fits, like a real disk."""

    def __init__(self, room: int) -> None:
        self.room = room
        self.real = os.write

    def __call__(self, descriptor: int, data: memoryview) -> int:
        if self.room == 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written = self.real(descriptor, data[: self.room])
        self.room -= written
        return written


@pytest.mark.parametrize("room", [0, 1, 30, 200, 700, 1500, 4000])
def test_full_disk_keeps_all_whole_records(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room: int
) -> None:
    settings = writer_settings(chunk_bytes=1024)
    writer, channels = open_writer(tmp_path / "bag", settings)
    fill(writer, channels, 50)
    writer.sync()
    monkeypatch.setattr(os, "write", FullDisk(room))
    with pytest.raises(BagError, match="the disk is full"):
        fill(writer, channels, 5000, 50)
    monkeypatch.undo()
    (verdict,) = check_files((writer.path,))
    assert verdict.state == "truncated"
    assert verdict.damages[0].offset == verdict.size  # cut exactly behind a record
    assert verdict.messages >= 50
    with pytest.raises(BagError, match="closed"):
        writer.write(channels[names.TRACER_LENGTH], b"", 0, 0)
    writer.close()  # nothing to do, no second error


def test_little_free_space_stops_in_good_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer, channels = open_writer(tmp_path / "bag", WriterSettings(min_free_bytes=1000))
    fill(writer, channels, 5)
    monkeypatch.setattr("rotcal_ros.foundation.disk.free_bytes", lambda _: 999)
    with pytest.raises(BagError, match="keeps free"):
        writer.sync()
    (verdict,) = check_files((writer.path,))
    assert (verdict.state, verdict.messages) == ("complete", 5)


@pytest.mark.parametrize(
    ("code", "text"), [(errno.EROFS, "read-only"), (errno.EACCES, "not permitted")]
)
def test_folder_that_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, text: str
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(Path, "mkdir", refuse)
    with pytest.raises(BagError, match=text):
        BagWriter(tmp_path / "bag")


def test_durable_file_never_replaces(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("old")
    with pytest.raises(FileExistsError):
        DurableFile(tmp_path / "file")
    assert (tmp_path / "file").read_text() == "old"


CHILD = """
import resource, sys, time
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import test_writer
folder, limit = Path(sys.argv[2]), int(sys.argv[3])
settings = test_writer.writer_settings(chunk_bytes=1024)
writer, channels = test_writer.open_writer(folder, settings)
if limit:
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
try:
    for start in range(0, 100_000, 100):
        test_writer.fill(writer, channels, 100, start)
        writer.sync()
        print(start + 100, flush=True)
except test_writer.BagError as error:
    print(error, flush=True)
"""


def start_child(folder: Path, limit: int) -> subprocess.Popen[str]:
    arguments = [sys.executable, "-c", CHILD, str(Path(__file__).parent), str(folder), str(limit)]
    return subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True)


@pytest.mark.parametrize("syncs", [1, 7])
def test_killed_process_leaves_everything_that_was_synced(tmp_path: Path, syncs: int) -> None:
    with start_child(tmp_path / "bag", 0) as child:
        assert child.stdout is not None
        synced = [int(child.stdout.readline()) for _ in range(syncs)][-1]
        child.kill()
    (verdict,) = check_files(bag_files(tmp_path / "bag"))
    assert verdict.state in ("truncated", "complete")
    assert verdict.messages >= synced
    assert (tmp_path / "bag" / "metadata.yaml").exists()


def test_real_size_limit_of_the_system(tmp_path: Path) -> None:
    with start_child(tmp_path / "bag", 40_000) as child:
        assert child.stdout is not None
        *counts, last = child.stdout.read().splitlines()
    assert "has reached the size" in last
    (verdict,) = check_files(bag_files(tmp_path / "bag"))
    assert verdict.messages >= int(counts[-1]) > 0
    assert verdict.damages[0].offset == verdict.size <= 40_000
