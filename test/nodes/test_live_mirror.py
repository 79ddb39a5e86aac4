"""Plane-mirror calibrations over DDS: a person moves the tracker, the nests are checked."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from live_cell import SUITE, live_cells

from rotcal_ros.recordings.replay import read_recording

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = pytest.mark.ros

DEMO = Path(__file__).parents[2] / "config" / "plane_mirror_demo.yaml"
ROBOT = Path(__file__).parent / "carrying_robot.py"
SHORT = (
    "plan.table_positions=5",
    "plan.positions_per_station=3",
    "plan.reflectors=1",
    "planner.preflight_timeout_s=30.0",
    "simulation.tracker.station_azimuths_deg=[22.5, 67.5]",
)
CANCELED = 607


@pytest.fixture
def cell(tmp_path, monkeypatch):
    """Return a function that makes a live cell with two tracker stations."""
    cells = live_cells(tmp_path, monkeypatch, DEMO, SHORT)
    made = next(cells)

    def make(*changes, **client):
        live = made(*changes)
        live.start(*SUITE, "simulated_cell")
        return live, live.client(**client)

    yield make
    next(cells, None)


def paused(client):
    """Return the next instruction, or the result when there is none any more."""
    event = client.wait_for("paused", "result")
    return event.get("instruction") or f"error: {event['error_msg']}"


def resume(live):
    live.processes.tell("client", "resume")


@pytest.mark.long  # test_mirror_*.py solve such plans
def test_a_nest_that_stays_displaced_is_named_in_the_result(cell):
    """Asked as often as there are attempts; then the calibration continues and says so."""
    live, client = cell(
        "planner.max_attempts=2",
        "simulation.tracker.displaced_nest=2",
        "simulation.tracker.displaced_at_stations=[1]",
        "simulation.tracker.displaced_attempts=100",
    )
    for start in ("put the tracker at place 1", "put the tracker at place 2", "not as it"):
        assert paused(client).startswith(start)
        resume(live)
    outcome = client.result()
    assert outcome["error_code"] == 0, outcome["error_msg"]
    assert outcome["verdict"] == "suspect"
    result = json.loads((live.session / "result.json").read_text())
    assert any("nest 2" in w for w in result["warnings"])


@pytest.mark.long  # as is the displaced nest above
def test_a_station_at_which_the_tracker_drifts_is_measured_again(cell):
    """A drift without end: asked once, then the calibration continues and says what it saw."""
    live, client = cell(
        "planner.max_attempts=2",
        "plan.drift_limit_arcsec=4.0",
        "simulation.tracker.azimuth_drift_arcsec_per_h=6000.0",
    )
    for station in (0, 1):
        assert paused(client).startswith(f"put the tracker at place {station + 1}")
        resume(live)
        again = paused(client)
        assert again.startswith("not right yet: the tracker turned by ")
        assert f"between two rounds of nests at station {station}, allowed 4" in again
        assert "leave the tracker where it is; the station is measured again" in again
        resume(live)
    outcome = client.result()
    assert outcome["error_code"] == 0, outcome["error_msg"]
    assert outcome["verdict"] == "suspect"
    result = json.loads((live.session / "result.json").read_text())
    assert [d["station"] for d in result["details"]["drift"]] == ["0", "1"]
    assert any("tracker station 1 moved between rounds of nests" in w for w in result["warnings"])
    recording = read_recording(live.bag)
    assert len([o for o in recording.recorded if o.station == 0]) == 2 * (12 + 6)
    assert recording.same_as_recorded


def test_a_pause_can_be_canceled_and_nothing_else_can_be_resumed(cell):
    # Without a configuration in the goal: the planner's own parameters are enough.
    live, client = cell("simulation.time_scale=2.0", configuration=None)
    assert paused(client).startswith("put the tracker at place 1 of 2")
    resume(live)
    assert client.wait_for("resumed")["success"]
    resume(live)  # while the first station is measured
    answer = client.wait_for("resumed")
    assert not answer["success"]
    assert "nothing is waiting to be resumed: the planner is calibrating" in answer["reason"]
    assert paused(client).startswith("put the tracker at place 2")
    client.cancel()
    outcome = client.result()
    assert outcome["error_code"] == CANCELED, outcome["error_msg"]
    assert "continue with start_index 18" in outcome["error_msg"]  # where it paused
    assert [v.state for v in read_recording(live.bag).verdicts] == ["complete"]


@pytest.mark.slow
def test_a_robot_carries_the_tracker_by_what_the_pause_says(cell):
    live, client = cell()
    live.processes.start("robot", [sys.executable, str(ROBOT)], piped=True)
    outcome = client.result()
    assert outcome["error_code"] == 0, outcome["error_msg"]
    assert outcome["verdict"] == "ok"
    lines = live.processes.children["robot"].stdout
    first, second = (json.loads(next(lines)) for _ in range(2))
    # Facing the positions 0 to 45 and 45 to 90 deg from 2.0 m, as the settings say.
    for heard, station, azimuth_deg in ((first, 0, 22.5), (second, 1, 67.5)):
        azimuth = np.deg2rad(azimuth_deg)
        place = [2.0 * np.cos(azimuth), 2.0 * np.sin(azimuth), 0.35]
        assert (heard["what"], heard["station"], heard["frame"]) == ("tracker", station, "machine")
        assert np.allclose(heard["position"], place, atol=1e-9)
    assert (first["step"], second["step"]) == (0, 18)
    assert "/cell/pause" in read_recording(live.bag).verdicts[0].topics
