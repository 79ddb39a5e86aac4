"""A ball on a table that turns, live; the bag repeats it to the last bit."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest
from live_cell import SUITE, LiveCell

from rotcal_ros.methods.configuration import changed, read_configuration
from rotcal_ros.methods.simulation.table import deviations

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

CANCELED = 607
DEMO = Path(__file__).parents[2] / "config" / "table_balls_demo.yaml"


TURNING = (
    "plan.measure=displacement", "plan.closing=false", "plan.turning_deg_s=[60.0, -60.0]",
    "plan.table_positions=6", "plan.table_step_deg=60.0", "plan.passing_deg=2.0",
    "simulation.table.feedback_rate_hz=50.0", "simulation.balls.nest_lag_s=1.5e-3",
    "simulation.time_scale=5.0", "planner.preflight_timeout_s=30.0",
)  # fmt: skip


def test_a_lag_is_found_live_while_the_table_turns_and_in_the_bag_again(tmp_path, monkeypatch):
    """The nest is 1.5 ms late, at 60 deg/s 324 arcsec; both directions tell it from ECC.

    In the midst of a turn the calibration is canceled, then goes on.
    """
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    configuration = changed(read_configuration(DEMO), TURNING)
    live = LiveCell(tmp_path, configuration)
    try:
        live.start(*SUITE, "simulated_cell")
        first = live.client()
        first.wait_for_step(2)
        with live.held():  # else the turn may be over before it is heard
            first.cancel()
            canceled = first.result()
        assert canceled["error_code"] == CANCELED, canceled["error_msg"]
        start = int(canceled["error_msg"].rsplit("start_index ", 1)[1])
        outcome = live.client("second", start_index=start).result()
    finally:
        live.processes.end()
    assert outcome["error_code"] == 0, outcome["error_msg"]
    assert (outcome["n_used"], outcome["n_rejected"], outcome["skipped_steps"]) == (12, 0, [])
    recording, result = live.repeated()
    assert result.verdict == "ok", result.warnings
    assert {o.run for o in recording.observations} == {0, 1}
    lag = result.details["also"]["lag"]
    assert lag["value"][0] == pytest.approx(1.5e-3, abs=5.5 * lag["std"][0])
    assert lag["std"][0] < 5e-6
    true = deviations(configuration.simulation.table, np.array(result.angles))["ECC"]
    away = result.deviations["ECC"] - (true - true.mean())
    assert np.abs(away / result.std["ECC"]).max() < 5.5
