"""Sqlite3 bags that rosbag2 has compressed as a whole (mode FILE)."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml
import zstandard
from bag_samples import CONFIGURATION, STORE, TYPES, Run, encode
from click.testing import CliRunner
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from sqlite_bags import payloads, write_bag

from rotcal_ros.bags.reader import bag_files, check_files
from rotcal_ros.bags.repair import reindex, repair
from rotcal_ros.bags.session_verdict import judge_session
from rotcal_ros.bags.storage_scan import FileVerdict
from rotcal_ros.cli import main
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.recordings.replay import read_recording

MESSAGES = payloads(60)


@pytest.fixture
def plain(tmp_path: Path) -> bytes:
    write_bag(tmp_path / "plain.db3", MESSAGES)
    return (tmp_path / "plain.db3").read_bytes()


def read(path: Path, data: bytes) -> FileVerdict:
    path.write_bytes(data)
    return check_files(bag_files(path))[0]


def test_a_bag_written_by_rosbags_is_solved_as_it_was_recorded(
    simulated_run: Run, run_bag: Path, tmp_path: Path
) -> None:
    folder, setup = tmp_path / "theirs", tmp_path / "setup.yaml"
    setup.write_text(CONFIGURATION)
    writer = RosbagsWriter(folder, version=9, storage_plugin=StoragePlugin.SQLITE3)
    writer.set_compression(CompressionMode.FILE, CompressionFormat.ZSTD)
    with writer:
        connections = {
            role: writer.add_connection(f"/cell/{role}", type_name, typestore=STORE)
            for role, type_name in TYPES.items()
        }
        for time, observation in enumerate(simulated_run.observations):
            ((role, data),) = encode(observation)
            writer.write(connections[role], time, data)
    assert [file.name for file in bag_files(folder)] == ["theirs.db3.zstd"]
    run = CliRunner().invoke
    check = run(main.rotcal, ["bag", "check", str(folder)])
    assert (check.exit_code, "complete" in check.output) == (0, True), check.output
    known = json.loads(run(main.rotcal, ["bag", "info", str(folder), "--json"]).stdout)
    assert known["files"][0]["messages"] == 1 + time
    source = ["--from", "observations", "--setup", str(setup)]
    packed = json.loads(run(main.rotcal, ["solve", str(folder), *source, "--json"]).stdout)
    ours = json.loads(read_recording(run_bag, "observations").solve().to_json())
    for what in ("deviations", "std", "covariance"):
        assert packed[what] == ours[what]
    repair(folder, tmp_path / "good")
    with Reader(tmp_path / "good") as reader:
        assert reader.message_count == 1 + time


def test_frames_and_capitals_as_anybody_may_pack_it(plain: bytes, tmp_path: Path) -> None:
    halves = zstandard.compress(plain[:5000]) + zstandard.compress(plain[5000:])
    verdict = read(tmp_path / "BAG.DB3.ZSTD", halves)
    assert (verdict.describe(), verdict.messages) == ("complete", 60)


def test_what_is_left_of_a_cut_file_is_read(tmp_path: Path) -> None:
    write_bag(tmp_path / "plain.db3", payloads(4000))
    packed = zstandard.compress((tmp_path / "plain.db3").read_bytes())
    verdict = read(tmp_path / "bag.db3.zstd", packed[: len(packed) * 3 // 4])
    assert verdict.state == "damaged"
    assert 1000 < verdict.messages < 4000
    (after,) = repair(tmp_path / "bag.db3.zstd", tmp_path / "good").after
    assert (after.state, after.messages) == ("complete", verdict.messages)


def test_a_wrong_checksum_of_zstd_is_told(plain: bytes, tmp_path: Path) -> None:
    packed = bytearray(zstandard.ZstdCompressor(write_checksum=True).compress(plain))
    packed[-1] ^= 1
    verdict = read(tmp_path / "bag.db3.zstd", bytes(packed))
    assert verdict.state == "damaged"
    assert 40 < verdict.messages < 60
    assert "cannot be unpacked after byte" in verdict.describe()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"no zstd", "cannot be unpacked"),
        (b"", "it is empty"),
        (zstandard.compress(b""), "it is empty"),
        (zstandard.compress(bytes(300 << 20)), "reading.unpacked_ratio="),
    ],
    ids=["other", "nothing", "packed nothing", "bomb"],
)
def test_what_is_no_packed_database_is_refused(data: bytes, words: str, tmp_path: Path) -> None:
    with pytest.raises(BagError, match=words):
        read(tmp_path / "bag.db3.zstd", data)


@pytest.mark.parametrize(("ending", "storage"), [("db3", "sqlite3"), ("mcap", "mcap")])
def test_reindex_says_how_it_is_packed(
    ending: str, storage: str, plain: bytes, run_bag: Path, tmp_path: Path
) -> None:
    """rosbags refuses a folder whose metadata.yaml does not fit to its files."""
    folder = tmp_path / "bag"
    folder.mkdir()
    data = plain if ending == "db3" else (run_bag / "run_0.mcap").read_bytes()
    (folder / f"bag_0.{ending}.zstd").write_bytes(zstandard.compress(data))
    found = reindex(folder)
    with Reader(folder) as reader:
        assert reader.message_count == found.messages > 0
        assert (reader.compression_mode, reader.compression_format) == ("file", "zstd")
    known = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert known["storage_identifier"] == storage
    assert judge_session(folder, check_files(bag_files(folder))).sound
    (folder / f"bag_1.{ending}").write_bytes(data)
    with pytest.raises(BagError, match=r"others are not|one is a copy"):
        reindex(folder)
