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
    "planner.max_attempts=1",
    "capture.window_samples=20",
    "capture.settle_time_s=0.1",
    "cell.joint=C",
)
TOPIC_MISSING, GIVEN_UP = 602, 605
SENTENCES = {
    "no echo": (GIVEN_UP, "the machine must echo both from the order"),
    "degrees": (TOPIC_MISSING, "degrees? Publish radians"),
    "clock": (
        TOPIC_MISSING,
        "stamps of tracer_length are constantly 4.0 s behind those of joint_states",
    ),
    "deaf": (TOPIC_MISSING, "node wrong_machine cannot receive /cell/table_angle"),
}


@pytest.mark.parametrize(
    "wrong", SENTENCES if LONG else ["degrees", pytest.param("no echo", marks=pytest.mark.slow)]
)
def test_what_is_wrong_is_said(cell, wrong):
    code, sentence = SENTENCES[wrong]
    preflight_s = 8.0 if code == TOPIC_MISSING and wrong != "degrees" else 20.0
    waits_s = 60.0 if wrong == "degrees" else 2.0  # what is hopeless is not waited for
    live = cell(
        *PATIENT,
        f"planner.step_timeout_s={waits_s}",
        f"capture.step_timeout_s={0.75 * waits_s}",
        f"planner.preflight_timeout_s={preflight_s}",
    )
    live.start(*SUITE)
    script = str(Path(__file__).with_name("wrong_machine.py"))
    live.processes.start("machine", [sys.executable, script, wrong])
    outcome = live.client().result()
    assert outcome["error_code"] == code, outcome["error_msg"]
    assert sentence in outcome["error_msg"]
    assert sentence in live.log("capture") + live.log("planner")
