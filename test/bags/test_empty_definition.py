"""A message without fields, std_msgs/Empty, has a definition of no bytes: that is no damage."""

from __future__ import annotations

from pathlib import Path

import pytest
from bag_samples import STORE, open_writer
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from rotcal_ros.bags.reader import check_files
from rotcal_ros.bags.repair import repair

EMPTY = "std_msgs/msg/Empty"
DATA = bytes(STORE.serialize_cdr(STORE.types[EMPTY](), EMPTY))


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    writer, _ = open_writer(tmp_path / "bag")
    with writer:
        channel = writer.channel("/cell/event", EMPTY, "", STORE.hash_rihs01(EMPTY))
        for number in range(3):
            writer.write(channel, DATA, number, number)
    return tmp_path / "bag"


def read_by_others(folder: Path) -> None:
    """Assert that rosbags and mcap read the three messages."""
    with AnyReader([folder]) as reader:
        wanted = [c for c in reader.connections if c.topic == "/cell/event"]
        found = [reader.deserialize(data, c.msgtype) for c, _, data in reader.messages(wanted)]
    assert [type(message).__name__ for message in found] == ["std_msgs__msg__Empty"] * 3
    (path,) = folder.glob("*.mcap")
    with path.open("rb") as file:
        mcap = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        assert len(list(mcap.iter_decoded_messages(topics=["/cell/event"]))) == 3


def test_it_is_checked_repaired_and_read_by_others(bag: Path, tmp_path: Path) -> None:
    read_by_others(bag)
    (verdict,) = check_files(tuple(bag.glob("*.mcap")))
    assert verdict.state == "complete"
    assert verdict.topics["/cell/event"].messages == 3
    (after,) = repair(bag, tmp_path / "good").after
    assert after.topics["/cell/event"].messages == 3
    read_by_others(tmp_path / "good")
