"""What starts a second time, or publishes a plan of its own, does not end a calibration."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from live_cell import SUITE, Client, wait_until

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
from rotcal_ros.foundation.node_state import UNHEARD
from rotcal_ros.nodes.client import json_client as client_module
from rotcal_ros.recordings.replay import read_recording

pytestmark = pytest.mark.ros

LATER = "env", "ROTCAL_SESSION=9000000000000000000-1"

LEFT_ALONE = "a plan on /cell/plan is not the planner's and was ignored (plan \"nobody's\""


def python(*arguments):
    cell = ("--ros-args", "-r", "__ns:=/cell")
    return [*LATER, sys.executable, *arguments, *cell]


@pytest.mark.slow
def test_strays_are_refused_with_a_sentence_and_the_calibration_ends_as_ever(cell):
    live = cell()
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
    live.processes.start("second", python("-m", "rotcal_ros.nodes.client.json_client"), piped=True)
    for node in ("capture", "recorder"):
        live.processes.start(f"stray {node}", python("-m", f"rotcal_ros.nodes.{node}.node"))
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
        assert f"node {name} already runs in /cell of ROS domain" in live.log(stray)
    outcome = client.result()
    assert outcome["error_code"] == 0, outcome["error_msg"]
    assert outcome["n_used"] == 59
    for node in ("capture", "solver"):
        assert "ERROR" not in live.log(node)
    recording = read_recording(live.bag)
    topics = recording.verdicts[0].topics
    assert topics["/cell/plan"].messages == 1
    assert topics["/cell/recorder/plan_left_alone"].messages == 1
    again, text = recording.solve(), (live.session / "result.json").read_text()
    known = tuple(json.loads(text)["warnings"])
    assert replace(again, warnings=known).to_json() == text


class PlannerOfOthers:
    """A calibrator that hears of the planner, and whose it is, only while it listens."""

    def __init__(self):
        self.node = SimpleNamespace(
            declare_parameter=lambda _name, value: SimpleNamespace(value=value)
        )
        self.health, self.others, self.goals = self, {}, []

    def listen(self, _seconds):
        self.others["planner"] = SimpleNamespace(session="one")

    def is_ready(self, _timeout_s):
        return bool(self.others)

    def node_state(self, _name):
        return UNHEARD

    def describe(self, _name):
        return "calibrating: step 3 of 60"

    def start(self, *goal):
        self.goals.append(goal)


def test_a_planner_heard_of_at_the_last_moment_is_still_asked_whose_it_is(capfd, monkeypatch):
    monkeypatch.setenv("ROTCAL_SESSION", "two")
    monkeypatch.setattr(client_module, "LISTEN_S", 0.0)
    others = PlannerOfOthers()
    client_module.Client(others, False).run()
    refused = [json.loads(line) for line in capfd.readouterr().out.splitlines()][-1]
    assert refused["event"] == "refused"
    assert "another calibration's nodes are at work here (node planner" in refused["reason"]
    assert others.goals == []
