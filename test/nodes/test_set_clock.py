"""The system clock is set in the middle of a calibration: by NTP, by a person, in one process."""

import json
import os
import shutil

import numpy as np
import pytest
from jumping_clock import JumpingClock
from live_cell import SUITE

from rotcal_ros.foundation.results import Result
from rotcal_ros.methods.configuration import parse_configuration
from rotcal_ros.methods.simulation.table import true_deviations
from rotcal_ros.recordings.replay import read_recording

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = [
    pytest.mark.ros,
    pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler for the clock"),
]

EVERYWHERE = (*SUITE, "simulated_cell", "client")
CASES = [(-45.0, EVERYWHERE)]
if os.environ.get("ROTCAL_LONG_TESTS"):
    CASES += [(by_s, EVERYWHERE) for by_s in (1.0, -1.0, 45.0, 3600.0, -3600.0)]
    CASES += [(by_s, (node,)) for by_s in (45.0, -45.0) for node in (*SUITE, "simulated_cell")]
    CASES += [(-1.0, ("simulated_cell",)), (-3600.0, ("simulated_cell", "capture"))]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("by_s", "where"), CASES, ids=lambda v: v if isinstance(v, float) else f"{len(v)}-{v[0]}"
)
def test_a_set_clock_hinders_no_calibration(cell, tmp_path, by_s, where):
    live, clock = cell(), JumpingClock(tmp_path)
    usual = live.processes.environment
    set_too = {**usual, **clock.environment}
    for node in (*SUITE, "simulated_cell"):
        live.processes.environment = set_too if node in where else usual
        live.start(node)
    live.processes.environment = set_too if "client" in where else usual
    client = live.client()
    client.wait_for_step(10)
    clock.jump(by_s)
    told = f"the system clock jumped by {by_s:+.1f} s at "
    if abs(by_s) >= 30.0:
        client.wait_for("warning", where=lambda event: event["text"].startswith(told))
    outcome = client.result()
    assert outcome["error_code"] == 0, outcome["error_msg"]
    assert outcome["verdict"] == "ok"
    assert outcome["n_used"] == 59
    for node in set(where) - {"client"}:
        assert told in live.log(node)

    recording = read_recording(live.bag)
    text = (live.session / "result.json").read_text()
    assert recording.same_as_recorded
    again = recording.with_warnings(Result.from_dict(json.loads(text)))
    assert recording.solve().to_json() == again.to_json()
    warned = [w for w in recording.warnings() if w.startswith(told)]
    assert len(warned) == ("recorder" in where)

    result = Result.from_dict(json.loads(text))
    settings = parse_configuration(live.file.read_text()).simulation
    error = result.deviations["ECC"] - true_deviations(settings.table, result.angles)["ECC"]
    assert np.all(np.abs(error - error[0]) <= 5 * result.std["ECC"] + 1e-12)
