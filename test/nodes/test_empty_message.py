"""Publishing a message without fields in the cell does not stop the recording."""

import json
import sys
from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader

from rotcal_ros.bags.reader import bag_files, check_files
from rotcal_ros.bags.repair import repair

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

PUBLISHED = 40


def test_empty_messages_are_recorded_checked_and_repaired(cell, tmp_path):
    live = cell()
    live.start("recorder")
    script = str(Path(__file__).with_name("event_publisher.py"))
    live.processes.start("events", [sys.executable, script], piped=True)
    answer = json.loads(live.processes.children["events"].stdout.readline())
    assert (answer["started"], answer["stopped"]) == (True, True), answer["said"]
    (verdict,) = check_files(bag_files(live.bag))
    assert verdict.state == "complete"
    assert 0 < verdict.topics["/cell/event"].messages <= PUBLISHED
    (after,) = repair(live.bag, tmp_path / "good").after
    assert after.topics["/cell/event"].messages == verdict.topics["/cell/event"].messages
    for folder in (live.bag, tmp_path / "good"):
        with AnyReader([folder]) as reader:
            wanted = [c for c in reader.connections if c.topic == "/cell/event"]
            for connection, _, data in reader.messages(wanted):
                reader.deserialize(data, connection.msgtype)
