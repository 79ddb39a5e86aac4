"""What is asked of one bag by other verbs holds for many: parts, packed files, locked folders."""

import json
import sys
from pathlib import Path

import pytest
from bag_samples import Run, write_run
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from test_strange_paths import of_anybody

from rotcal_history.fleet.bag_search import find_bags
from rotcal_history.fleet.batch_solving import BagJob, solve_bag
from rotcal_ros.bags.settings import WriterSettings
from rotcal_ros.recordings.replay import read_recording


@pytest.mark.slow
def test_a_session_without_one_of_its_files_is_suspect(simulated_run: Run, tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    settings = WriterSettings(min_free_bytes=0, split_bytes=76_000)
    write_run(folder, simulated_run, settings, tick_every=200)
    (folder / "bag_7.mcap").unlink()
    recording = read_recording(folder)
    row = solve_bag(BagJob(str(folder), recording.configuration, str(tmp_path))).result
    assert row is not None
    assert row["verdict"] == "suspect"
    assert row["warnings"] == json.loads(recording.solve().to_json())["warnings"]


def test_a_packed_file_of_sqlite_is_a_bag(tmp_path: Path) -> None:
    folder = tmp_path / "theirs"
    writer = RosbagsWriter(folder, version=9, storage_plugin=StoragePlugin.SQLITE3)
    writer.set_compression(CompressionMode.FILE, CompressionFormat.ZSTD)
    with writer:
        pass
    assert (folder / "theirs.db3.zstd").exists()
    assert find_bags([str(tmp_path)]) == (str(folder),)


def test_a_folder_that_nobody_may_read_is_named_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "locked" / "inside").mkdir(parents=True)
    shown = "from rotcal_history.fleet.bag_search import find_bags; print(*find_bags([L]))"
    text = f"import os, sys; L = sys.argv[1]; os.access(L, os.R_OK) and sys.exit(77); {shown}"
    ended = of_anybody(tmp_path / "locked", [sys.executable, "-c", text])
    assert ended.stdout.strip() == str(tmp_path / "locked")
