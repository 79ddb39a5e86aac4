"""Lengths while the table turns, live: a beam that breaks, and a goal that ends in mid-turn."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from live_cell import SUITE, live_cells

from rotcal_ros.cli.main import rotcal
from rotcal_ros.foundation.components import ROTATIONS
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.methods.configuration import parse_configuration
from rotcal_ros.methods.simulation.table import true_deviations

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

CANCELED = 607
CONFIG = Path(__file__).parents[2] / "config"
QUICK = (
    "plan.table_positions=18", "plan.table_step_deg=20.0", "plan.passing_deg=2.0",
    "planner.preflight_timeout_s=30.0", "capture.clock_tolerance_s=60.0",
    "capture.settle_time_s=0.5", "simulation.time_scale=1.0",
    "simulation.tracer.rate_hz=100.0", "simulation.table.feedback_rate_hz=50.0",
    "capture.window_samples=10",
)  # fmt: skip
ONE_TURN = 18 + 1
TURNS = 4 * 2
"""At one place of the tracer: of four targets, there and back."""


@pytest.mark.parametrize(
    ("demo", "places"), [("tracer_turning_demo.yaml", 1), ("tracer_six_turning_demo.yaml", 3)]
)
def test_a_broken_turn_is_made_again_and_one_that_was_interrupted_is_measured_as_a_whole(
    demo, places, tmp_path, monkeypatch
):
    cells = live_cells(tmp_path, monkeypatch, CONFIG / demo, QUICK)
    live = next(cells)(
        "simulation.faults.blocked_from_deg=95.0", "simulation.faults.blocked_to_deg=105.0",
        "simulation.faults.blocked_targets=[1]", "simulation.faults.blocked_times=1",
    )  # fmt: skip
    # in the first turn of the third target, at the second place if there are several
    inside = (TURNS * min(places - 1, 1) + 4) * ONE_TURN + 5
    try:
        live.start(*SUITE, "simulated_cell")
        first = live.client(person=True)
        first.wait_for_step(inside)
        first.cancel()
        canceled = first.result()
        assert canceled["error_code"] == CANCELED, canceled["error_msg"]
        start = int(canceled["error_msg"].rsplit("start_index ", 1)[1])
        second = live.client("second", start_index=start, person=True)
        outcome = second.result()
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
    assert again == list(range(leg, places * TURNS * ONE_TURN))
    if places > 1:  # nobody moves a tracer that stands where it stood
        names = [text.split(" on the table")[0] for text in (*first.asked, *second.asked)]
        assert [name.split(" (")[0] for name in names] == [
            f"fix the tracer at place {k} of 3" for k in (1, 2, 3)
        ]
    settings = parse_configuration(live.file.read_text()).simulation
    true = recording.calibration.method.gauge(
        result.angles, true_deviations(settings.table, result.angles)
    )
    centring = np.eye(18) - 1.0 / 18
    for name, matrix in result.covariance.items():
        std = np.sqrt((centring @ matrix @ centring).diagonal())
        error = centring @ (result.deviations[name] - true[name])
        assert np.abs(error / std).max() < 5.0, name
        assert std.max() < 1.0 * (ARCSEC if name in ROTATIONS else MICROMETRE), name
    assert_reported_and_exported(live.session / "result.json", result, tmp_path)


def assert_reported_and_exported(file, result, folder):
    """Assert that the report and the table for a controller show what was measured live."""
    page, tables = folder / "page.html", folder / "tables"
    export = ["export", str(file), "--to", "csv", "-o", str(tables), "--spacing", "20"]
    for words in (["report", str(file), "-o", str(page)], export):
        done = CliRunner().invoke(rotcal, words)
        assert done.exit_code == 0, done.output
    text = page.read_text()
    assert "Set-up in plan view" in text or "Places and targets" in text
    (table,) = tables.glob("*.csv")
    rows = np.genfromtxt(table, delimiter=",", names=True)[:18]
    both = result.directions["ECC"]
    for name, own in (("forward", both.forward), ("reverse", both.reverse)):
        wanted = (both.forward[0] - own) / ARCSEC
        assert rows[f"correction_{name}_arcsec"] == pytest.approx(wanted, abs=1e-5)
