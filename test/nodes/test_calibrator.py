"""The client for scripts, against real nodes over DDS."""

import json
import os
import re
from dataclasses import FrozenInstanceError
from pathlib import Path

import pytest
from live_cell import DEMO, SUITE

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.methods.configuration import changed, read_configuration
from rotcal_ros.recordings.replay import read_recording
from rotcal_ros.ros import Calibrator, CalibratorError, GoalRefusedError

pytestmark = pytest.mark.ros

BAD_CONFIGURATION, NODE_LOST, CANCELED = 601, 603, 607
LIMIT_S = 60.0


@pytest.fixture(autouse=True)
def _environment():
    """Keep the variables that a calibrator sets for its process from other tests."""
    before = dict(os.environ)
    yield
    os.environ.clear()
    os.environ.update(before)


@pytest.fixture
def calibrator():
    with Calibrator("/cell") as made:
        yield made


def follow(calibrator, enough=lambda feedback: False):
    """Return every feedback until the end, or until there is enough."""
    seen = []
    while not calibrator.is_done(1.0):
        feedback = calibrator.feedback()
        if feedback is None or (seen and feedback is seen[-1]):
            continue
        seen.append(feedback)
        if enough(feedback):
            break
    return seen


def test_a_script_calibrates_and_loads_the_result(cell, calibrator):
    live = cell()
    live.start(*SUITE, "simulated_cell")
    calibrator.wait_until_ready(LIMIT_S)
    calibrator.start(live.file)
    with pytest.raises(CalibratorError, match="a calibration is running"):
        calibrator.start(live.file)
    seen = follow(calibrator)
    assert {f.total for f in seen} == {60}
    assert [f.step for f in seen] == sorted(f.step for f in seen)
    assert [f.accepted for f in seen] == sorted(f.accepted for f in seen)
    assert seen[0].activity.startswith("preflight")
    assert seen[0].time_left_s is None
    assert any(f.time_left_s is not None and f.time_left_s > 0.0 for f in seen)
    assert not any(f.instruction for f in seen)
    with pytest.raises(FrozenInstanceError):
        seen[0].step = 3

    outcome = calibrator.result()
    assert (outcome.error_code, outcome.canceled, outcome.verdict) == (0, False, "ok")
    assert (outcome.n_used, outcome.skipped_steps) == (59, (9,))
    assert Path(outcome.bag_folder) == live.bag
    assert Path(outcome.result_file) == live.session / "result.json"
    assert outcome.load().to_json() == (live.session / "result.json").read_text()
    assert calibrator.is_done()
    assert calibrator.result() is outcome


@pytest.mark.long  # test_live.py cancels and goes on
def test_cancel_leaves_a_valid_bag_and_the_next_goal_is_taken(cell, calibrator):
    live = cell("simulation.time_scale=4.0")
    live.start(*SUITE, "simulated_cell")
    calibrator.wait_until_ready(LIMIT_S)
    calibrator.start(read_configuration(live.file))
    follow(calibrator, lambda feedback: feedback.accepted >= 3)
    with Calibrator("/cell", name="other") as other:
        other.wait_until_ready(LIMIT_S)
        with pytest.raises(GoalRefusedError, match="the planner is calibrating: step"):
            other.start()
        with pytest.raises(CalibratorError, match="nothing is waiting to be resumed"):
            other.resume()
    calibrator.cancel()
    outcome = calibrator.result(LIMIT_S)
    assert outcome.canceled
    assert outcome.error_code == CANCELED
    assert "continue with start_index" in outcome.error_msg
    assert outcome.n_used >= 3
    with pytest.raises(DataError, match="no result: canceled at step"):
        outcome.load()
    recording = read_recording(Path(outcome.bag_folder))
    assert [v.state for v in recording.verdicts] == ["complete"]

    live.session.rename(live.folder / "first")
    text = live.file.read_text().replace("table_positions: 5", "table_positions: -5")
    calibrator.start(text)
    outcome = calibrator.result(LIMIT_S)
    assert outcome.error_code == BAD_CONFIGURATION
    assert "plan.table_positions: -5 is out of range" in outcome.error_msg


def test_a_person_is_asked_once_for_every_work(cell, calibrator):
    live = cell()
    mirror = changed(
        read_configuration(DEMO.with_name("plane_mirror_demo.yaml")),
        (
            "plan.table_positions=5",
            "plan.positions_per_station=3",
            "plan.reflectors=1",
            "planner.preflight_timeout_s=30.0",
            "simulation.tracker.station_azimuths_deg=[22.5, 67.5]",
        ),
    )
    live.file.write_text(mirror.text)
    live.start(*SUITE, "simulated_cell")
    calibrator.wait_until_ready(LIMIT_S)
    calibrator.start(mirror.text)
    asked = []
    while not calibrator.is_done():
        feedback = calibrator.feedback()
        if feedback is not None and feedback.instruction:
            asked.append(feedback.instruction)
            calibrator.resume()
    outcome = calibrator.result()
    assert (outcome.error_code, outcome.verdict) == (0, "ok"), outcome.error_msg
    assert [text[:26] for text in asked] == [
        "put the tracker at place 1",
        "put the tracker at place 2",
    ]


def test_a_script_that_is_interrupted_stops_the_cell(cell):
    live = cell("simulation.time_scale=4.0")
    live.start(*SUITE, "simulated_cell")

    def interrupted():
        with Calibrator("/cell") as calibrator:
            calibrator.wait_until_ready(LIMIT_S)
            calibrator.start(live.file)
            follow(calibrator, lambda feedback: feedback.accepted >= 2)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert "canceled at step" in live.log("planner")
    assert [v.state for v in read_recording(live.bag).verdicts] == ["complete"]


@pytest.mark.long  # test_attach.py: so does a lost terminal
def test_a_closed_calibrator_leaves_its_goal_to_the_planner(cell):
    live = cell()
    live.start(*SUITE, "simulated_cell")
    calibrator = Calibrator("/cell")
    calibrator.wait_until_ready(LIMIT_S)
    calibrator.start(live.file)
    calibrator.close()
    live.wait_for_log("planner", "calibration done, verdict ok")
    result = json.loads((live.session / "result.json").read_text())
    assert result["n_observations"] == 59


def test_a_killed_planner_ends_the_wait(cell, calibrator):
    live = cell("simulation.time_scale=4.0")
    live.start(*SUITE, "simulated_cell")
    calibrator.wait_until_ready(LIMIT_S)
    calibrator.start(live.file)
    follow(calibrator, lambda feedback: feedback.accepted >= 1)
    live.kill("planner")
    outcome = calibrator.result(LIMIT_S)
    assert outcome.error_code == NODE_LOST
    assert re.fullmatch(
        r"node planner is lost; start it again, then continue with start_index \d+",
        outcome.error_msg,
    )


def test_what_cannot_work_is_said_with_a_way_out(calibrator, tmp_path):
    with pytest.raises(
        CalibratorError, match=r"no planner appeared in /cell within 0\.3 s: start"
    ):
        calibrator.wait_until_ready(0.3)
    for ask in (calibrator.is_done, calibrator.result):
        with pytest.raises(CalibratorError, match=r"call start\(\) first"):
            ask()
    with pytest.raises(ConfigurationError, match=r"cannot read the configuration .*none\.yaml"):
        calibrator.start(tmp_path / "none.yaml")
    calibrator.cancel()
    assert calibrator.feedback() is None
