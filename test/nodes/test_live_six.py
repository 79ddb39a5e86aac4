"""Six deviations over DDS: a person fixes the tracer at three places, once at a wrong one."""

from pathlib import Path

import numpy as np
import pytest
from live_cell import live_cells

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.configuration import parse_configuration
from rotcal_ros.methods.simulation.table import true_deviations

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

DEMO = Path(__file__).parents[2] / "config" / "tracer_six_demo.yaml"
SHORT = (
    "plan.table_positions=3",
    "plan.table_step_deg=120.0",
    "plan.bidirectional=true",
    "plan.box_points=[2, 2, 2]",
    "planner.preflight_timeout_s=30.0",
    "simulation.tracer.misplaced_place=1",
    "simulation.tracer.misplaced_mm=40.0",
)
TARGETS = 8
PER_PLACE = 2 * 3 * TARGETS


@pytest.fixture
def cell(tmp_path, monkeypatch):
    """Return a function that makes a live cell with the tracer at three places."""
    yield from live_cells(tmp_path, monkeypatch, DEMO, SHORT)


@pytest.mark.slow
def test_the_planner_waits_for_the_tracer_at_every_place_and_sees_a_wrong_one(cell):
    live = cell()
    event, asked = live.calibrate_with_a_person()
    assert event["error_code"] == 0, event["error_msg"]
    assert [text.split(" (number")[0] for text in asked if text.startswith("fix")] == [
        f"fix the tracer at place {number + 1} of 3" for number in range(3)
    ]
    assert len(asked) == 4
    assert asked[2].startswith("not right yet: place 2: the tracer stands ")
    assert event["n_used"] == 3 * PER_PLACE

    recording, result = live.repeated()
    # The first angle of the second place was measured twice; what counts is the second time.
    accepted = [o for o in recording.recorded if o.station == 1 and o.accepted]
    assert len(accepted) == PER_PLACE + TARGETS

    assert result.components == COMPONENTS
    settings = parse_configuration(live.file.read_text()).simulation
    method = recording.calibration.method
    truth = method.gauge(result.angles, true_deviations(settings.table, result.angles))
    for name in COMPONENTS:
        error = result.deviations[name] - truth[name]
        assert np.abs(error / result.std[name]).max() < 5.0, name
        both = result.directions[name]
        play = settings.table.backlash_arcsec * ARCSEC if name == "ECC" else 0.0
        assert np.abs((both.reversal + play) / both.reversal_std).max() < 5.0, name
