"""A ball plate over DDS: who joins a run, and set-up mistakes that show live."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from live_cell import SUITE, live_cells

from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.results import Result
from rotcal_ros.methods import prepare
from rotcal_ros.methods.configuration import read_configuration
from rotcal_ros.methods.simulation.table import true_deviations
from rotcal_ros.recordings.replay import read_recording

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

DEMO = Path(__file__).parents[2] / "config" / "ball_plate_demo.yaml"
SHORT = (
    "plan.plate.grid=12",
    "plan.plate.ball_steps=[0, 1, 3, 5, 8, 9]",
    "plan.rounds=1",
    "simulation.plate.grid=12",
    "simulation.plate.ball_steps=[0, 1, 3, 5, 8, 9]",
    "planner.preflight_timeout_s=20.0",
)


@pytest.fixture
def plate_cell(tmp_path, monkeypatch):
    """Return a function that makes a live cell with a small plate."""
    yield from live_cells(tmp_path, monkeypatch, DEMO, SHORT)


@pytest.mark.slow
def test_who_joins_a_run_is_named_and_left_alone_live_and_in_the_bag(plate_cell):
    """A second probe, a second table and forged observations, from the third step on."""
    live = plate_cell()
    live.start(*SUITE, "simulated_cell")
    client = live.client()
    client.wait_for_step(3)
    script = str(Path(__file__).with_name("second_probe.py"))
    with live.held():
        live.processes.start("second_probe", [sys.executable, script])
        live.wait_for_log("second_probe", "here")
    named = client.wait_for(
        "warning", where=lambda e: "probe_point: node second_probe publishes" in e["text"]
    )
    assert "are ignored" in named["text"]
    outcome = client.result()
    assert outcome["error_code"] == 0, outcome["error_msg"]
    assert "/cell/observation: node second_probe publishes" in live.log("planner")

    recording = read_recording(live.bag)
    text = (live.session / "result.json").read_text()
    assert recording.same_as_recorded
    again = recording.solve()
    known = json.loads(text)["warnings"]
    assert replace(again, warnings=tuple(known)).to_json() == text
    further = " ".join(set(again.warnings) - set(known))
    assert "messages on probe_point from a publisher that joined during the run" in further
    result = Result.from_dict(json.loads(text))
    calibration = prepare(read_configuration(live.file))
    settings = calibration.configuration.simulation
    truth = calibration.method.gauge(result.angles, true_deviations(settings.table, result.angles))
    error = (result.deviations["EXC"] - truth["EXC"]) / result.std["EXC"]
    assert np.abs(error).max() < 5.0
    beside = recording.verdicts[0].topics
    for topic in ("probe_point", "joint_states", "observation"):
        assert beside[f"/cell/recorder/{topic}_left_alone"].messages > 0


def test_a_shifted_plate_is_told_and_given_up_after_three_balls(plate_cell):
    live = plate_cell(
        "simulation.plate.azimuth_deg=10.0",
        "planner.max_attempts=1",
        "plan.cmm_positions=[0, 1, 2, 3, 4, 5]",
    )
    live.start(*SUITE, "simulated_cell")
    client = live.client()
    client.wait_for(
        "warning",
        where=lambda event: (
            "rejected in a row" in event["text"] and "plate mounted shifted" in event["text"]
        ),
    )
    outcome = client.result()
    assert outcome["error_code"] == 605, outcome["error_msg"]  # too few observations
    assert "3 steps running failed" in outcome["error_msg"]
    assert "plate mounted shifted" in outcome["error_msg"]
    assert outcome["n_used"] == 0
    assert "table position 0, target 0 rejected: " in live.log("capture")
    recording = read_recording(live.bag)
    assert len(recording.recorded) == 3
    with pytest.raises(DataError, match=r"3 of 3 like this: .*plate mounted shifted"):
        recording.solve()


@pytest.mark.long  # test_live.py asks it of a tracer
def test_the_parameters_of_the_nodes_are_enough(plate_cell):
    live = plate_cell("plan.cmm_positions=[0, 1, 2, 3, 4, 5]")
    live.start(*SUITE, "simulated_cell")
    client = live.client(configuration=None)
    assert client.wait_for_step(2)["total"] == 40
    client.cancel()
    assert client.result()["error_code"] == 607
