"""A calibration that stops when its goal is reached, killed on the way and resumed; its bag."""

import json
import re
import signal

import numpy as np
import pytest
from click.testing import CliRunner
from live_cell import wait_until

from rotcal_ros.cli.main import rotcal as rotcal_verbs
from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.recordings.replay import read_recording

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

GOAL = (
    "planner.policy=until_goal",
    "planner.goal_arcsec=9.0",
    "planner.expected_std_m=2.5e-7",
    "simulation.faults.spike_probability=0.0",
    "simulation.faults.dropout_probability=0.0",
)


@pytest.mark.slow
def test_a_killed_run_is_resumed_to_its_goal_and_the_bag_says_why(rotcal, tmp_path):
    folder, log = tmp_path / "out", tmp_path / "first.log"
    first = rotcal("--output", folder, log=log, changes=GOAL)
    done = re.compile(r"(\d+) of \d+ steps")
    wait_until(lambda: max(map(int, done.findall(log.read_text())), default=0) >= 9, "9 steps")
    first.send_signal(signal.SIGKILL)
    first.wait(load_scaled_timeout(10))

    log = tmp_path / "second.log"
    second = rotcal("--resume", folder, "--json", log=log, changes=GOAL)
    # the noise goes by the clock: sound lengths look suspect (1) in one or two runs of a hundred
    assert second.wait(load_scaled_timeout(120)) in (0, 1), log.read_text()
    assert "the policy goes on choosing" in log.read_text()
    outcome = json.loads(log.with_suffix(".json").read_text())
    assert outcome["n_used"] >= 25  # five at each of five stations

    recording = read_recording(folder / "bag")
    by_run = {run: [c.choice for c in recording.choices if c.run == run] for run in (0, 1)}
    assert {choice.reason for choice in by_run[0]} == {"first sweep"}
    *on_the_way, last = by_run[1]
    joined = "completed step, measured again to join the runs"
    assert 1 <= sum(choice.reason == joined for choice in on_the_way) <= 8
    assert last.step is None
    assert last.reason.startswith("goal reached: U ")
    assert last.standing.uncertainty <= last.standing.goal
    assert len(recording.choices) < 70  # of 60 steps, eight of them twice
    assert recording.choices_that_differ() == ()
    assert CliRunner().invoke(rotcal_verbs, ["bag", "choices", str(folder / "bag")]).exit_code == 0
    assert recording.warnings() == ()
    text = (folder / "result.json").read_text()
    assert recording.solve().to_json() == text
    result, truth = json.loads(text), json.loads((folder / "truth.json").read_text())
    error = np.array(result["deviations"]["ECC"]) - truth["deviations"]["ECC"]
    assert np.all(np.abs(error - error[0]) <= 5 * np.array(result["std"]["ECC"]) + 1e-12)
