"""The table moved by FollowJointTrajectory, and every way in which a controller fails at it."""

import json
import os
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest
from control_messages import built, environment
from live_cell import wait_until

from rotcal_ros.sessions.domains import free_domain
from rotcal_ros.sessions.environment import node_environment
from rotcal_ros.sessions.processes import Processes

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

HERE = Path(__file__).parent
CONFIGURATION = """/**:
  ros__parameters:
    cell: {joint: rotary}
    table_adapter: {controller: /drive, speed_deg_s: 60.0, acceleration_deg_s2: 360.0,
                    silence_s: 0.7}
"""
CASES = {
    "does well": ("30", "at rest at 30.000 deg"),
    "is preempted": ("90,10", "at rest at 10.000 deg"),
    "rejects goals": ("30", "/drive rejected the goal of 30.0000 deg: is it active"),
    "stalls": ("30", "/drive gave the goal up of 30.0000 deg: the tolerance of the goal was "
               "violated (error -5), 'not there\\\\x1b[2J in time'"),
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
    file = tmp_path / "cell.yaml"
    file.write_text(CONFIGURATION)
    with ExitStack() as stack:
        logs = {}
        for wrong, (angles, _) in CASES.items():
            folder = logs[wrong] = tmp_path / wrong
            folder.mkdir()
            domain = {"ROS_DOMAIN_ID": str(free_domain())}  # each has a robot of its own
            variables = {**node_environment(), **environment(installed), **domain}
            processes = stack.enter_context(Processes(folder, variables))
            for name, command in {
                "drive": [str(HERE / "goal_controller.py"), wrong, "0"],
                "adapter": ["-m", "rotcal_ros.nodes.table_adapter"],
                "orders": [str(HERE / "order_publisher.py"), angles],
            }.items():
                own = ["--params-file", str(file)] if name == "adapter" else []
                processes.start(
                    name, [sys.executable, *command, "--ros-args", "-r", "__ns:=/cell", *own]
                )
        for wrong, (_, said) in CASES.items():
            logged = [logs[wrong] / f"{name}.log" for name in ("adapter", "orders")]
            wait_until(
                lambda: any(said in log.read_text() for log in logged),  # noqa: B023
                f"{wrong}: {[log.read_text() for log in logged]}",
            )
            errors = logged[0].read_text().count("[ERROR]")
            assert errors == (0 if said.startswith("at rest") else 1), logged[0].read_text()
            if errors:
                assert "joint 'rotary' of /drive: " in logged[0].read_text()
