"""What starts a second time, or publishes a plan of its own, does not end a calibration."""

import sys
from pathlib import Path

import pytest
from live_cell import SUITE, Client, wait_until

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

LATER = "env", "ROTCAL_SESSION=9000000000000000000-1"

LEFT_ALONE = "a plan on /cell/plan is not the planner's and was left alone (plan \"nobody's\""


def python(*arguments):
    cell = ("--ros-args", "-r", "__ns:=/cell")
    return [*LATER, sys.executable, *arguments, *cell]


def test_strays_are_refused_with_a_sentence_and_the_calibration_ends_as_ever(cell):
    live = cell("simulation.time_scale=8.0")
    live.start(*SUITE, "simulated_cell")
    publisher = python(str(Path(__file__).with_name("plan_publisher.py")))
    live.processes.start("stranger", publisher, piped=True)
    live.processes.tell("stranger", "anybody's")
    for node in ("capture", "solver"):
        live.wait_for_log(node, "a plan on /cell/plan cannot be used: the announced plan")
    client = live.client()
    client.wait_for_step(1)
    with live.held():
        live.processes.tell("stranger", "nobody's")
        for node in ("capture", "solver"):
            live.wait_for_log(node, LEFT_ALONE)
            assert "published by stranger" in live.log(node)
    live.processes.start("second", python("-m", "rotcal_ros.nodes.client"), piped=True)
    for node in ("capture", "recorder"):
        live.processes.start(f"stray {node}", python("-m", f"rotcal_ros.nodes.{node}"))
    client.wait_for_step(30)
    with live.held():
        refused = Client(live.processes, "second").wait_for("refused", "started")
        assert refused["event"] == "refused"
        assert "another calibration's nodes are at work here" in refused["reason"]
        strays = {"stray capture", "stray recorder"}
        wait_until(lambda: strays <= live.processes.ended().keys(), "the strays end")
    for stray in strays:
        assert live.processes.ended()[stray] == 2
        name = stray.removeprefix("stray ")
        assert f"node {name} runs already in /cell of ROS domain" in live.log(stray)
    outcome = client.result()
    assert outcome["error_code"] == 0, outcome["error_msg"]
    assert outcome["n_used"] == 59
    for node in ("capture", "solver"):
        assert "ERROR" not in live.log(node)
