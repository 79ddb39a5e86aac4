"""A newcomer kills the calibration and goes on: the whole command, live."""

import json
import re
import signal

import numpy as np
import pytest
from live_cell import wait_until
from mcap.reader import SeekingReader
from rosbags.rosbag2 import Reader

from rotcal_ros.bags.session_identity import session_of
from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.recordings.replay import read_recording

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros


@pytest.mark.long  # test_until_goal_live.py resumes
def test_a_killed_run_is_resumed_to_a_true_result(rotcal, tmp_path):
    folder, log = tmp_path / "out", tmp_path / "first.log"
    shifts = ("simulation.tracer.zero_shift_um=1000.0",)
    first = rotcal("--output", folder, log=log, changes=shifts)
    bag = folder / "bag" / "bag_0.mcap"
    told = re.compile(r"(\d+) of 60 steps")
    wait_until(lambda: max(map(int, told.findall(log.read_text())), default=0) >= 24, "24 steps")
    first.send_signal(signal.SIGKILL)
    first.wait(load_scaled_timeout(10))

    log = tmp_path / "second.log"
    second = rotcal("--resume", folder, "--json", log=log, changes=shifts)
    assert second.wait(load_scaled_timeout(120)) == 0, log.read_text()
    outcome = json.loads(log.with_suffix(".json").read_text())
    assert outcome["n_used"] == 59
    assert set(outcome["files"]) >= {"bag", "result", "truth", "report", "compensation"}
    assert {p.name for p in bag.parent.glob("*.mcap")} == {"bag_0.mcap", "bag_1.mcap"}
    assert "done steps are measured again" in log.read_text()
    assert "gives another result" not in log.read_text()

    with Reader(folder / "bag") as reader:  # others read all of it at once
        assert sum(1 for _ in reader.messages()) == reader.message_count > 0
    with bag.open("rb") as file:
        reader = SeekingReader(file, validate_crcs=True)
        found = sum(1 for _ in reader.iter_messages())
        assert found == reader.get_summary().statistics.message_count > 0
    assert session_of(bag) == session_of(bag.with_name("bag_1.mcap"))

    result = json.loads((folder / "result.json").read_text())
    truth = json.loads((folder / "truth.json").read_text())
    (join,) = result["details"]["joins"]
    assert join["run"] == 1
    assert len(join["disagreement_m"]) == 8
    # The zero of the simulated tracer jumps from start to start.
    assert abs(join["offset_m"]) > 10 * join["offset_std_m"]
    error = np.array(result["deviations"]["ECC"]) - truth["deviations"]["ECC"]
    assert np.all(np.abs(error - error[0]) <= 5 * np.array(result["std"]["ECC"]) + 1e-12)

    recording = read_recording(folder / "bag")
    assert recording.same_as_recorded
    assert {o.run for o in recording.observations} == {0, 1}
    assert recording.solve().to_json() == (folder / "result.json").read_text()

    scatter = recording.calibration.trials(recording.observations)(np.random.default_rng(1), 500)
    np.testing.assert_allclose(scatter.std(axis=0)[1:], result["std"]["ECC"][1:], rtol=0.2)

    third = rotcal("--resume", folder, log=tmp_path / "third.log")
    assert third.wait(load_scaled_timeout(60)) == 2
    assert "is finished" in (tmp_path / "third.log").read_text()
