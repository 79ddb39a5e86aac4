"""Somebody takes, swaps or cuts the files of a bag while it is recorded: that ends it."""

import os
import shutil

import pytest

from rotcal_ros.bags.interrupted_files import InterruptedSession
from rotcal_ros.bags.reader import check_files
from rotcal_ros.bags.settings import WriterSettings
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.foundation import disk
from rotcal_ros.foundation.errors import BagError

SETTINGS = WriterSettings(min_free_bytes=0, split_bytes=1)


@pytest.fixture
def bag(tmp_path):
    """Return a writer that has begun its second file, and a function that goes on writing."""
    writer = BagWriter(tmp_path / "session" / "bag", SETTINGS)
    channel = writer.channel("/cell/a", "std_msgs/msg/Float64", "float64 data")

    def go_on():
        writer.write(channel, bytes(12), 1, 1)
        writer.sync()

    go_on()
    assert writer.path.name == "bag_1.mcap"
    yield writer, go_on
    writer.close()


def swap(path):
    data = path.read_bytes()
    path.rename(path.with_name("kept"))
    path.write_bytes(data)


def append(path):
    with path.open("ab") as file:
        file.write(b"somebody else")


def move_the_session(path):
    path.parents[1].rename(path.parents[2] / "moved")


def put_the_session_back_copied(path):
    session = path.parents[1]
    move_the_session(path)
    shutil.copytree(session.with_name("moved"), session)


DEEDS = {
    "delete": (os.unlink, "no longer there"),
    "swap": (swap, "not the file that was recorded"),
    "empty": (lambda path: os.truncate(path, 0), "somebody changed it"),
    "cut": (lambda path: os.truncate(path, path.stat().st_size - 1), "somebody changed it"),
    "append": (append, "somebody changed it"),
    "move": (move_the_session, "somebody deleted or moved it or its folder"),
    "remove": (lambda path: shutil.rmtree(path.parents[1]), "no longer there"),
    "copy": (put_the_session_back_copied, "not the file that was recorded"),
}


@pytest.mark.parametrize("number", [0, 1], ids=["finished file", "growing file"])
@pytest.mark.parametrize("deed", DEEDS)
def test_no_sync_succeeds_afterwards(bag, deed, number):
    writer, go_on = bag
    do, words = DEEDS[deed]
    do(writer.folder / f"bag_{number}.mcap")
    with pytest.raises(BagError, match=words):
        go_on()
    with pytest.raises(BagError, match="closed"):
        go_on()


@pytest.mark.parametrize("end", ["sync", "close"])
def test_it_is_noticed_without_a_new_message_and_at_the_end(bag, end):
    writer, _ = bag
    writer.path.unlink()
    with pytest.raises(BagError, match="no longer there"):
        getattr(writer, end)()


def test_a_moved_bag_ends_behind_a_whole_record(bag, tmp_path):
    writer, go_on = bag
    move_the_session(writer.path)
    with pytest.raises(BagError, match="no longer there"):
        go_on()
    first, second = check_files(tuple(sorted((tmp_path / "moved" / "bag").glob("*.mcap"))))
    assert (first.state, first.messages) == ("complete", 1)
    assert (second.state, second.messages) == ("truncated", 1)
    assert second.damages[0].offset == second.size


def test_the_files_of_the_earlier_run_are_watched_too(tmp_path):
    folder = tmp_path / "bag"
    BagWriter(folder, SETTINGS).close()
    writer = BagWriter(folder, SETTINGS, earlier=InterruptedSession.read(folder).files)
    (folder / "bag_0.mcap").unlink()
    with pytest.raises(BagError, match=r"bag_0\.mcap is no longer there"):
        writer.sync()


def test_a_folder_that_goes_while_it_is_looked_at_is_gone_and_not_read_only(tmp_path, monkeypatch):
    writer = BagWriter(tmp_path / "bag", SETTINGS)
    ask = disk.may_write

    def gone_before(path):
        shutil.rmtree(path)
        return ask(path)

    monkeypatch.setattr(disk, "may_write", gone_before)
    with pytest.raises(BagError, match="no longer there"):
        writer.sync()
