"""Two circles over DDS: a person shifts the reference; the bag is solved to the same last bit."""

import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from live_cell import SUITE, LiveCell

from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.configuration import changed, read_configuration
from rotcal_ros.methods.simulation.table import true_deviations
from rotcal_ros.recordings.replay import read_recording

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

DEMO = Path(__file__).parents[2] / "config" / "angle_comparison_demo.yaml"
BOTH = (
    "plan.bidirectional=true",
    "planner.preflight_timeout_s=30.0",
    "simulation.table.backlash_arcsec=1.5",
)


def test_both_circles_are_found_from_both_sides_and_again_from_the_bag(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    configuration = changed(read_configuration(DEMO), BOTH)
    live = LiveCell(tmp_path, configuration)
    try:
        live.start(*SUITE, "simulated_cell")
        client, asked = live.client(), []
        while (event := client.wait_for("paused", "result"))["event"] == "paused":
            asked.append(event["instruction"])
            live.processes.tell("client", "resume")
    finally:
        live.processes.end()
    assert event["error_code"] == 0, event["error_msg"]
    assert [text.split(":")[0] for text in asked] == [f"setting {k} of 3" for k in range(3)]
    assert event["n_used"] == 3 * 2 * 13
    text = (live.session / "result.json").read_text()
    result = Result.from_dict(json.loads(text))
    assert result.verdict == "ok", result.warnings
    both = result.directions["ECC"]
    assert np.abs((both.reversal + 1.5 * ARCSEC) / both.reversal_std).max() < 5.0
    true = true_deviations(configuration.simulation.table, both.angles)["ECC"]
    error = both.forward - both.forward[0] - true
    assert (np.abs(error) < 5.0 * result.std["ECC"].max()).all()
    assert read_recording(live.bag).solve().to_json() == text
