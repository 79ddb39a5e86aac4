"""A cell of somebody else with one thing wrong: a sentence says so, and the goal ends with it."""

import os
import sys
from pathlib import Path

import pytest
from live_cell import SUITE

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

LONG = bool(os.environ.get("ROTCAL_LONG_TESTS"))
PATIENT = (
    "planner.step_timeout_s=2.0",
    "planner.max_attempts=1",
    "planner.preflight_timeout_s=8.0",
    "capture.step_timeout_s=1.5",
    "capture.window_samples=20",
    "capture.settle_time_s=0.1",
    "cell.joint=C",
)
SENTENCES = {
    "no echo": (605, "the machine must echo both of the order"),
    "degrees": (605, "degrees? Publish radians"),
    "no velocity": (602, "joint C has no velocity"),
    "clock": (602, "stamps of tracer_length are constantly 4.0 s behind those of joint_states"),
    "deaf": (602, "node wrong_machine hears nothing on /cell/table_angle"),
}


@pytest.mark.parametrize("wrong", SENTENCES if LONG else ["no echo"])
def test_what_is_wrong_is_said(cell, wrong):
    live = cell(*PATIENT)
    live.start(*SUITE)
    script = str(Path(__file__).with_name("wrong_machine.py"))
    live.processes.start("machine", [sys.executable, script, wrong])
    outcome = live.client().result()
    code, sentence = SENTENCES[wrong]
    assert outcome["error_code"] == code, outcome["error_msg"]
    assert sentence in outcome["error_msg"]
    assert sentence in live.log("capture") + live.log("planner")
