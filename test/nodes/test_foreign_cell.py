"""Instruments of somebody else, live: calibrated against their truth, and again from the bag."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from live_cell import SUITE, LiveCell

from rotcal_ros.api.reading import read_result
from rotcal_ros.methods.configuration import dump_configuration, parse_configuration
from rotcal_ros.recordings.replay import read_recording

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

LONG = bool(os.environ.get("ROTCAL_LONG_TESTS"))
SCRIPT = Path(__file__).with_name("foreign_cell.py")
OWN_CELL = Path(__file__).parents[2] / "examples" / "own_cell" / "own_cell.yaml"
TOPIC_MISSING = 602
UNITS = {
    "length_unit": "mm", "angle_unit": "deg", "position_unit": "mm", "temperature_unit": "K",
}  # fmt: skip
SHOT = {
    "length_single_shot": True, "probe_single_shot": True, "length_trigger": "/tracer/measure",
    "length_clock_offset_s": 4.0,
}  # fmt: skip
MODES = {
    "stream": (UNITS, {"window_samples": 20}, 4.5e-8),
    "asked": ({**UNITS, **SHOT}, {"window_samples": 1}, 2e-7),
    "named": ({**UNITS, "length_field": "vector.x"}, {"window_samples": 20}, 4.5e-8),
    "bursts": ({**UNITS, "length_single_shot": True}, {"window_samples": 10}, 7e-8),
}


def configured(topics, capture, length_std_m=2e-7, **planner):
    groups = yaml.safe_load(OWN_CELL.read_text())["/**"]["ros__parameters"]
    method = groups.pop("method")
    groups |= {n: g for n, g in {"topics": topics, "planner": planner}.items() if g}
    groups["plan"]["table_positions"], groups["plan"]["table_step_deg"] = 5, 72.0
    groups["capture"] = {"settle_time_s": 0.05, **capture}
    groups["solver"]["length_std_m"] = length_std_m
    return parse_configuration(dump_configuration(method, groups))


@pytest.fixture
def foreign(tmp_path, monkeypatch):
    """Return a function that starts suite and foreign cell; all of it ends with the test."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    cells = []

    def start(mode, configuration):
        live = LiveCell(tmp_path, configuration)
        cells.append(live)
        live.start(*SUITE)
        live.processes.start("machine", [sys.executable, str(SCRIPT), mode])
        return live

    yield start
    for live in cells:
        live.processes.end()


@pytest.mark.slow
@pytest.mark.parametrize("mode", MODES if LONG else ["asked", "named"])
def test_the_truth_is_found_and_found_again(foreign, mode):
    sys.path.append(str(SCRIPT.parent))
    from foreign_cell import error_rad

    live = foreign(mode, configured(*MODES[mode]))
    outcome = live.client().result()
    assert outcome["error_code"] == 0, outcome["error_msg"] + live.log("capture")
    result = read_result(live.session / "result.json")
    truth = np.array([error_rad(angle) for angle in result.angles])
    off = result.deviations["ECC"] - (truth - truth[0])
    e_n = (off - off[0])[1:] / (2 * result.std["ECC"][1:])
    assert np.ptp(truth) > 4e-5
    assert np.abs(e_n).max() <= 1.5
    recording = read_recording(live.bag)
    assert recording.same_as_recorded, recording.warnings()
    assert recording.solve().to_json() == (live.session / "result.json").read_text()
    assert result.circumstances.temperature_c.lowest == pytest.approx(20.0)


def test_a_type_and_a_unit_that_cannot_be_are_named(foreign):
    live = foreign("type", configured({}, {}, preflight_timeout_s=2.0))
    failed = live.client().result()
    assert failed["error_code"] == TOPIC_MISSING, failed["error_msg"]
    said = failed["error_msg"]
    assert "std_msgs/msg/String cannot be used" in said
    assert "std_msgs/msg/Float64" in said
