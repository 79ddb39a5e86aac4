"""The table moved by FollowJointTrajectory, and every way in which a controller fails at it."""

import json
import os
import sys

import pytest
from control_messages import built, environment
from lone_adapters import expect

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = [pytest.mark.ros, pytest.mark.long]  # make test-kilted runs it: messages are compiled

CASES = {
    "does well": ("30", "at rest at 30.000 deg"),
    "is preempted": ("90,10", "at rest at 10.000 deg"),
    "rejects goals": ("30", "joint 'rotary' of /drive: /drive rejected the goal of 30.0000 deg: "
                      "is it active"),
    "stalls": ("30", "/drive gave the goal up of 30.0000 deg: the tolerance of the goal was "
               "violated (error -5), not there\\x1b[2J in time"),
    "says succeeded": ("30", "3600 arcsec from where it was sent (30.0000 deg), and the "
                       "controller calls this succeeded"),
    "falls silent": ("30", "no feedback of the table for"),
}  # fmt: skip
"""What the controller does, the angles that it is sent to, and what is said then."""
GOAL_HASH = "RIHS01_8a9060704b269608f5a340934cc26e66869dd14bdac29e2e7fd9ec8b9882d205"
"""Of the goal as it is published (REP 2011)."""


@pytest.fixture(scope="module")
def installed():
    return built()


def test_the_messages_are_those_that_are_published(installed):
    described = installed / "share" / "control_msgs" / "action" / "FollowJointTrajectory.json"
    hashes = {
        h["type_name"]: h["hash_string"] for h in json.loads(described.read_text())["type_hashes"]
    }
    assert hashes["control_msgs/action/FollowJointTrajectory_Goal"] == GOAL_HASH


def test_every_way_in_which_a_goal_ends_is_believed_or_named(installed, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    expect(tmp_path, "goal_controller.py", CASES, environment(installed))
