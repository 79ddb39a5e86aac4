"""A calibration that stops when its goal is reached, live, and its bag."""

import pytest

from rotcal_ros.recordings.replay import read_recording

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros


def test_the_goal_is_reached_with_fewer_steps_and_the_bag_says_why(cell):
    live = cell(
        "planner.policy=until_goal",
        "planner.goal_arcsec=9.0",
        "planner.expected_std_m=2.5e-7",
        "simulation.faults.spike_probability=0.0",
        "simulation.faults.dropout_probability=0.0",
    )
    outcome = live.calibrate()
    assert outcome["error_code"] == 0, outcome["error_msg"]

    recording = read_recording(live.bag)
    *made, last = [recorded.choice for recorded in recording.choices]
    assert last.step is None
    assert last.reason.startswith("goal reached: U ")
    assert last.standing.uncertainty <= last.standing.goal
    assert 25 <= outcome["n_used"] <= len(made) < 60
    assert recording.choices_that_differ() == ()
    assert recording.warnings() == ()
    assert recording.solve().to_json() == (live.session / "result.json").read_text()
