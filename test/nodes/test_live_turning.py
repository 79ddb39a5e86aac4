"""Lengths while the table turns, live: a beam that breaks, and a goal that ends in mid-turn."""

from pathlib import Path

import numpy as np
import pytest
from live_cell import SUITE, live_cells

from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.configuration import parse_configuration
from rotcal_ros.methods.simulation.table import true_deviations

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

CANCELED = 607
DEMO = Path(__file__).parents[2] / "config" / "tracer_turning_demo.yaml"
QUICK = (
    "plan.table_positions=18", "plan.table_step_deg=20.0", "plan.passing_deg=2.0",
    "planner.preflight_timeout_s=30.0", "capture.clock_tolerance_s=60.0",
    "capture.settle_time_s=0.5", "simulation.time_scale=1.0",
    "simulation.tracer.rate_hz=100.0", "simulation.table.feedback_rate_hz=50.0",
    "capture.window_samples=10",
)  # fmt: skip
ONE_TURN = 18 + 1


def test_a_broken_turn_is_made_again_and_one_that_was_interrupted_is_measured_as_a_whole(
    tmp_path, monkeypatch
):
    cells = live_cells(tmp_path, monkeypatch, DEMO, QUICK)
    live = next(cells)(
        "simulation.faults.blocked_from_deg=95.0", "simulation.faults.blocked_to_deg=105.0",
        "simulation.faults.blocked_targets=[1]", "simulation.faults.blocked_times=1",
    )  # fmt: skip
    try:
        live.start(*SUITE, "simulated_cell")
        first = live.client()
        first.wait_for_step(4 * ONE_TURN + 5)  # in the first turn of the third target
        first.cancel()
        canceled = first.result()
        assert canceled["error_code"] == CANCELED, canceled["error_msg"]
        start = int(canceled["error_msg"].rsplit("start_index ", 1)[1])
        outcome = live.client("second", start_index=start).result()
    finally:
        next(cells, None)
    assert outcome["error_code"] == 0, outcome["error_msg"]
    assert outcome["skipped_steps"] == []
    recording, result = live.repeated()
    assert result.verdict == "ok", result.warnings
    refused = [o for o in recording.observations if not o.accepted]
    assert {(o.target, o.station, o.table_position) for o in refused} == {(1, 0, 5)}
    assert "beam broken while the table passed" in refused[0].reason
    whole = [o for o in recording.observations if (o.target, o.station) == (1, 0) and o.attempt]
    assert [o.table_position for o in whole] == list(range(18))
    # the turn in which it was canceled is measured as a whole, from rest on
    leg = start // ONE_TURN * ONE_TURN
    again = [o.step for o in recording.observations if o.run == 1]
    assert start > leg
    assert again == list(range(leg, 8 * ONE_TURN))
    settings = parse_configuration(live.file.read_text()).simulation
    true = true_deviations(settings.table, result.angles)["ECC"]
    centring = np.eye(18) - 1.0 / 18
    std = np.sqrt((centring @ result.covariance["ECC"] @ centring).diagonal())
    error = centring @ (result.deviations["ECC"] - true)
    assert np.abs(error / std).max() < 5.0
    assert std.max() < 1.0 * ARCSEC
