"""One ball on a table over DDS: where the axis stands; the bag is solved to the same last bit."""

import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from live_cell import LiveCell

from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.configuration import changed, read_configuration
from rotcal_ros.recordings.replay import read_recording

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

DEMO = Path(__file__).parents[2] / "config" / "table_balls_demo.yaml"


def test_the_axis_is_found_live_and_the_bag_repeats_it_bit_for_bit(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    configuration = changed(read_configuration(DEMO), ("planner.preflight_timeout_s=30.0",))
    live = LiveCell(tmp_path, configuration)
    try:
        outcome = live.calibrate()
        text = (live.session / "result.json").read_text()
    finally:
        live.processes.end()
    assert outcome["error_code"] == 0, outcome["error_msg"]
    assert (outcome["n_used"], outcome["skipped_steps"]) == (25, [])
    result = Result.from_dict(json.loads(text))
    assert result.verdict == "ok", result.warnings
    axis, table = result.details["axis"], configuration.simulation.table
    (x, y, _), (a, b) = table.axis_offset_m, np.array(table.axis_tilt_arcsec) * ARCSEC
    height = configuration.plan.axis_m[2]
    away = np.array(axis["value"]) - [x + height * b, y - height * a, a, b]
    assert np.abs(away / axis["std"]).max() < 5.5
    assert read_recording(live.bag).solve().to_json() == text
