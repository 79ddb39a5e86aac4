"""A ball on a tilted table, and on one that turns, live; the bag repeats it to the last bit."""

import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from live_cell import SUITE, LiveCell, published

from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.configuration import changed, read_configuration
from rotcal_ros.methods.simulation.table import deviations
from rotcal_ros.recordings.replay import read_recording

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

CANCELED = 607
DEMO = Path(__file__).parents[2] / "config" / "table_balls_demo.yaml"


def test_both_axes_are_found_live_and_the_bag_repeats_them_bit_for_bit(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    tilts = [-60.0, 0.0, 50.0]
    configuration = changed(
        read_configuration(DEMO),
        (
            "plan.chain=AC", f"plan.tilts_deg={tilts}", f"simulation.balls.tilts_deg={tilts}",
            "plan.runs=1", "planner.preflight_timeout_s=30.0",
        ),
    )  # fmt: skip
    live = LiveCell(tmp_path, configuration)
    try:
        outcome, asked = live.calibrate_with_a_person()
        text = (live.session / "result.json").read_text()
    finally:
        live.processes.end()
    assert outcome["error_code"] == 0, outcome["error_msg"]
    assert (outcome["n_used"], outcome["skipped_steps"]) == (39, [])
    assert asked == [f"turn A to {tilt:g} deg" for tilt in tilts]
    result = Result.from_dict(json.loads(text))
    assert result.verdict == "ok", result.warnings
    axis, table = result.axes[0], configuration.simulation.table
    (x, y, _), (a, b) = table.axis_offset_m, np.array(table.axis_tilt_arcsec) * ARCSEC
    height = configuration.plan.axis_m[2]
    away = axis.value - [x + height * b, y - height * a, a, b]
    assert np.abs(away / axis.std).max() < 5.5
    tilting, true = result.axes[1], configuration.simulation.balls
    lean = np.array(true.tilting_lean_arcsec[1:]) * ARCSEC
    away = tilting.value - [*true.tilting_axis_m[1:], *lean]
    assert np.abs(away / tilting.std).max() < 5.5
    (location,) = published(live.bag, "/cell/axis_location")
    assert (location.header.frame_id, location.verdict, location.simulated) == ("machine", "ok", 1)
    turning, tilted = location.axes
    assert (turning.axis, tilted.axis) == ("C", "A")
    assert turning.names == ["XOC", "YOC", "AOC", "BOC"]
    there = [x, y, 0.0] + np.array([b, -a, 1.0]) * height  # of the true axis, at this height
    assert np.abs(turning.point[:2] - there[:2]).max() < 5.5 * turning.std[:2].max()
    assert turning.point[2] == turning.origin[2] == height
    assert np.abs(turning.direction - [b, -a, 1.0]).max() < 5.5 * turning.std[2:].max()
    assert turning.covariance.reshape(4, 4).diagonal() == pytest.approx(turning.std**2)
    assert tilted.point[0] == true.tilting_axis_m[0]
    assert read_recording(live.bag).solve().to_json() == text


TURNING = (
    "plan.measure=displacement", "plan.closing=false", "plan.turning_deg_s=[60.0, -60.0]",
    "plan.table_positions=6", "plan.table_step_deg=60.0", "plan.passing_deg=2.0",
    "simulation.table.feedback_rate_hz=50.0", "simulation.balls.nest_lag_s=1.5e-3",
    "simulation.time_scale=20.0", "planner.preflight_timeout_s=30.0",
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
