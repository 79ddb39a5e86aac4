"""A bag that is shorter than it was, and shows it, gives no result that may be exported."""

import shutil
import sqlite3

import pytest
import yaml
from bag_samples import STORE, TYPES, encode, open_writer, writer_settings
from rosbags.rosbag2 import StoragePlugin, Writer

from rotcal_ros.bags.reader import bag_files, check_files
from rotcal_ros.bags.repair import repair
from rotcal_ros.bags.session_verdict import judge_session
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.recordings.replay import read_recording

ALL = 2000
"""Messages in the sample."""


def written(folder, run, **settings):
    """Return a closed bag with its metadata.yaml."""
    writer, channels = open_writer(folder, writer_settings(**settings))
    with writer:
        pairs = (pair for record in run.records for pair in encode(record))
        for time_ns, (role, data) in zip(range(0, ALL * 1000_000, 1000_000), pairs, strict=False):
            writer.write(channels[role], data, time_ns, time_ns)
            writer.tick(time_ns)
    return folder


def in_sqlite(folder, run):
    """Return the same messages as rosbags writes them into a database."""
    pairs = [pair for record in run.records for pair in encode(record)][:ALL]
    with Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        topics = {r: writer.add_connection(f"/{r}", k, typestore=STORE) for r, k in TYPES.items()}
        for number, (role, data) in enumerate(pairs):
            writer.write(topics[role], number * 1000_000, data)
    return folder


def is_short(path):
    """Return whether a result would be suspect, and that the reason is in words."""
    verdicts = check_files(bag_files(path))
    session = judge_session(path, verdicts)
    proven = [v for v in verdicts if v.shows_loss]
    assert all("messages lost" in v.describe() for v in proven)
    return bool(session.missing or proven)


def holds(path):
    return sum(v.messages for v in check_files(bag_files(path)))


def test_cut_at_any_byte_beside_its_metadata(simulated_run, tmp_path):
    bag = written(tmp_path / "bag", simulated_run, chunk_bytes=20_000)
    file = bag / "bag_0.mcap"
    data = file.read_bytes()
    assert not is_short(bag)
    short = 0
    for cut in range(3000, len(data), len(data) // 25):
        file.write_bytes(data[:cut])
        lost = holds(bag) < ALL
        short += lost
        assert is_short(bag) == is_short(file) == lost, cut
        if lost:
            file.rename(bag / "other.mcap")  # renamed, too
            assert is_short(bag)
            (bag / "other.mcap").rename(file)
    assert short > 15
    for number, cut in enumerate((len(data) // 3, len(data) // 2)):
        file.write_bytes(data[:cut])
        twice = tmp_path / f"{number}", tmp_path / f"{number} again"
        repair(bag, twice[0])
        repair(twice[0], twice[1])
        assert all(map(is_short, twice))


def test_alone_a_file_that_ends_within_messages_shows_it(simulated_run, tmp_path):
    bag = written(tmp_path / "bag", simulated_run, chunk_bytes=20_000)
    data = (bag / "bag_0.mcap").read_bytes()
    alone = tmp_path / "alone.mcap"
    within = 0
    for cut in range(3000, len(data), len(data) // 40):
        alone.write_bytes(data[:cut])
        (verdict,) = check_files((alone,))
        at = verdict.damages[0].offset
        in_chunk = verdict.state == "truncated" and at < cut and data[at] == 6
        within += in_chunk
        assert is_short(alone) == in_chunk, cut
    assert within > 20
    alone.write_bytes(data)
    assert not is_short(alone)


def test_a_hole_in_a_file_with_its_footer(simulated_run, tmp_path):
    bag = written(tmp_path / "bag", simulated_run, chunk_bytes=20_000)
    file = bag / "bag_0.mcap"
    data = bytearray(file.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 200] = bytes(200)
    file.write_bytes(data)
    (bag / "metadata.yaml").unlink()
    assert holds(bag) < ALL
    assert is_short(bag)
    repair(bag, tmp_path / "good")
    assert is_short(tmp_path / "good")


@pytest.mark.parametrize("description", ["kept", "gone"])
def test_an_earlier_file_of_several_that_was_cut(simulated_run, tmp_path, description):
    bag = written(tmp_path / "bag", simulated_run, chunk_bytes=2000, split_bytes=20_000)
    files = bag_files(bag)
    assert len(files) > 2
    assert not is_short(bag)
    if description == "gone":
        (bag / "metadata.yaml").unlink()
    whole = files[0].read_bytes()
    (verdict,) = check_files(files[:1])
    rows = [
        n
        for n in range(len(whole) // 2, len(whole))
        if whole[n : n + 9] == b"\x06" + whole[n + 1 : n + 9]
    ]
    files[0].write_bytes(whole[: rows[0]])  # before a chunk: the file itself shows nothing
    assert check_files(files[:1])[0].messages < verdict.messages
    assert is_short(bag)


@pytest.mark.parametrize("version", [4, 9])
def test_sqlite_beside_its_metadata(simulated_run, tmp_path, version):
    converted = in_sqlite(tmp_path / "converted", simulated_run)
    assert not is_short(converted)
    path = converted / "metadata.yaml"
    if version < 5:  # says only how many there are in all files
        described = yaml.safe_load(path.read_text())
        described["rosbag2_bagfile_information"].pop("files")
        path.write_text(yaml.safe_dump(described))
    assert not is_short(converted)
    (file,) = bag_files(converted)
    with sqlite3.connect(file) as database:
        database.execute(f"DELETE FROM messages WHERE id > {ALL // 2}")
    database.close()
    assert holds(converted) == ALL // 2
    assert is_short(converted)


def test_sqlite_cut_at_a_byte(simulated_run, tmp_path):
    (file,) = bag_files(in_sqlite(tmp_path / "converted", simulated_run))
    data = file.read_bytes()
    (tmp_path / "converted" / "metadata.yaml").unlink()
    read = 0
    for cut in range(len(data) // 4, len(data), len(data) // 8):
        file.write_bytes(data[:cut])
        try:
            assert is_short(tmp_path / "converted")
            read += 1
        except BagError:
            pass  # nothing can be read
    assert read


def test_its_result_is_suspect_with_the_reason_and_so_after_a_repair(
    simulated_run, run_bag, tmp_path
):
    bag = tmp_path / "bag"
    bag.mkdir()
    shutil.copy(run_bag / "run_0.mcap", bag / "run_0.mcap")
    shutil.copy(run_bag / "metadata.yaml", bag)
    whole = read_recording(bag)
    data = (bag / "run_0.mcap").read_bytes()
    (bag / "run_0.mcap").write_bytes(data[: 95 * len(data) // 100])
    repair(bag, tmp_path / "good")
    for path in (bag, tmp_path / "good"):
        recording = read_recording(path)
        assert 0 < len(recording.observations) < len(whole.observations)
        result = recording.solve()
        assert result.verdict == "suspect"
        assert any(
            "messages that metadata.yaml lists: it was cut off" in w for w in result.warnings
        )
