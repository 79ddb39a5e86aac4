"""A ball plate through I++ DME over TCP: the real nodes, the adapter, and a server of its own."""

import json
import re
import sys

import numpy as np
import pytest
from known_truth import normalized_errors
from live_cell import SUITE, LiveCell, wait_until

from rotcal_ros.catalogue import prepare
from rotcal_ros.catalogue.configuration import changed, read_configuration
from rotcal_ros.recordings.replay import read_recording
from rotcal_ros.results import Result

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

SHORT = (
    "plan.plate.grid=12",
    "plan.plate.ball_steps=[0, 1, 3, 5, 8, 9]",
    "plan.rounds=1",
    "plan.points_per_ball=6",
    "planner.preflight_timeout_s=20.0",
    "capture.temperature_expected=false",
    "simulation.plate.grid=12",
    "simulation.plate.ball_steps=[0, 1, 3, 5, 8, 9]",
    "simulation.touch_probe.points_per_ball=6",
    "simulation.time_scale=1000.0",
    "dme.home=true",
    "dme.settle_s=0.01",
    "dme.idle_period_s=0.05",
)


@pytest.fixture
def cell(tmp_path, monkeypatch):
    """Return a live cell whose machine is behind I++ DME, without a simulated_cell."""
    import os
    from pathlib import Path

    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    demo = Path(__file__).parents[2] / "config" / "ball_plate_demo.yaml"
    configuration = changed(read_configuration(demo), SHORT)
    live = LiveCell(tmp_path, configuration)
    command = [sys.executable, "-m", "rotcal_ros.cli.main", "dme", "serve", str(live.file)]
    live.processes.start("server", [*command, "--port", "0"])
    wait_until(lambda: "I++ DME" in live.log("server"), "the server listens")
    port = re.search(r"127\.0\.0\.1:(\d+)", live.log("server"))[1]
    live.file.write_text(changed(configuration, (f"dme.port={port}",)).text, encoding="utf-8")
    yield live
    live.processes.end()


def test_the_truth_is_found_through_tcp_and_the_bag_repeats_it(cell):
    cell.start(*SUITE, "dme_adapter")
    outcome = cell.client().result()
    assert outcome["error_code"] == 0, outcome["error_msg"] + cell.log("dme_adapter")
    assert outcome["n_used"] == 78
    assert outcome["skipped_steps"] == []

    recording = read_recording(cell.bag)
    text = (cell.session / "result.json").read_text()
    assert recording.solve().to_json() == text
    result = Result.from_dict(json.loads(text))
    calibration = prepare(read_configuration(cell.file))
    errors = np.abs(normalized_errors(calibration, result))
    assert len(errors) > 60
    assert np.mean(errors <= 1.0) > 0.88  # 95 % expected, of about 70 values
    assert errors.max() < 2.2
