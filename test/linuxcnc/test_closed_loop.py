"""The whole loop on a real controller: measure, solve, export, load, measure again.

LinuxCNC moves a plant with a known error. Driver, planner, capture, solver and recorder are the
real nodes; only the tracer and its reflector are simulated, and they follow the plant.
"""

import json
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
import pytest
from real_linuxcnc import HERE, Axis, Running, plant_hal

from rotcal_ros.compensation.export import prepare_export
from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.evaluation.iso230 import BidirectionalRuns, iso230
from rotcal_ros.results import Result
from rotcal_ros.sessions import commands
from rotcal_ros.sessions.following import calibrate
from rotcal_ros.sessions.session import prepare_session
from rotcal_ros.units import ARCSEC, DEGREE

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = [pytest.mark.linuxcnc, pytest.mark.ros]

CONFIGURATION = HERE.parents[1] / "config" / "verify_demo.yaml"
CHANGES = (
    "plan.box_points=[2, 3, 2]",
    "plan.table_step_deg=20.0",
    "plan.table_positions=18",
    "plan.order=targets_per_station",
    "capture.settle_time_s=0.05",
    "capture.step_timeout_s=10.0",
    "simulation.time_scale=1.0",
    "simulation.table.external=true",
    "simulation.table.ecc.amplitudes_arcsec=[0.0]",
    "simulation.tracer.rate_hz=500.0",
    "simulation.probe.following_um=0.0",
    "simulation.probe.systematic_um=0.3",
    "simulation.probe.repeatability_um=0.05",
    "solver.target_std_m=4.0e-7",
    "solver.length_std_m=8.0e-8",
    "simulation.probe.speed_m_s=20.0",
    "simulation.probe.acceleration_m_s2=1000.0",
    "simulation.faults.spike_probability=0.0",
)
TARGETS_DEG = np.array([7.5, 52.5, 93.0, 142.5, 187.5, 232.0, 277.5, 322.5, 352.5])
RUNS = 2


def error_deg(motor_deg):
    """The error of the plant, known to nobody but it."""
    m = np.deg2rad(motor_deg)
    return (35 * np.sin(m + 0.4) + 12 * np.sin(2 * m + 1.0) + 4 * np.cos(3 * m)) / 3600


@pytest.fixture
def axis(tmp_path):
    return Axis(tmp_path / "axis", plant_hal(-30.0, 420.0, 5.0, error_deg))


@pytest.fixture
def with_driver(axis, monkeypatch):
    """Let every session start the driver too, which starts LinuxCNC."""
    start = commands._start

    def command(described, name):
        found = start(described, name)
        if name == "linuxcnc_driver":
            found += ["-p", f"agent_command:={json.dumps(axis.command())}"]
        return found

    monkeypatch.setattr(commands, "_start", command)
    monkeypatch.setattr(commands, "NODES", (*commands.NODES, "linuxcnc_driver"))


def measured(folder: Path) -> Result:
    """Calibrate through all nodes."""
    session = prepare_session(CONFIGURATION, folder, CHANGES)
    outcome = calibrate(session)
    assert outcome["verdict"] == "ok", outcome
    return Result.from_dict(json.loads((folder / "result.json").read_text()))


def true_figures(axis):
    """ISO 230-2 from the plant's own angle, mostly between the measured angles, both ways."""
    up, down = [], []
    with Running(axis) as running:
        running.go(-10.0, -1)
        for _ in range(RUNS):
            for angles, side, runs in ((TARGETS_DEG, 1, up), (TARGETS_DEG[::-1], -1, down)):
                if side == -1:
                    running.go(370.0, 1)
                found = [running.go(a, side)["actual_deg"] - a for a in angles]
                runs.append(found[::side])
            running.go(-10.0, -1)
        assert running.errors == []
    forward, reverse = (np.array(runs).T * DEGREE for runs in (up, down))
    return iso230(BidirectionalRuns(TARGETS_DEG * DEGREE, forward, reverse))


@pytest.mark.usefixtures("with_driver")
def test_the_error_of_a_real_axis_is_measured_and_removed(axis, tmp_path, record_property):
    before = measured(tmp_path / "before")
    truth = error_deg(np.rad2deg(before.angles)) * DEGREE
    missed = before.deviations["ECC"] - (truth - truth[0])
    assert np.all(np.abs(missed) < 5 * before.std["ECC"] + 1e-9)
    true_before = true_figures(axis)

    table = table_from_result(before, axis="A")
    made = prepare_export(
        table,
        "linuxcnc",
        now=datetime.now(timezone.utc),
        spacing=5 * DEGREE,
        settings={"first_turn": -1, "turns": 3},
    )
    axis.load(made.files)
    after = measured(tmp_path / "after")
    true_after = true_figures(axis)

    ranges = [np.ptp(result.deviations["ECC"]) / ARCSEC for result in (before, after)]
    figures = {
        "measured E before / arcsec": ranges[0],
        "measured E after / arcsec": ranges[1],
        "std after / arcsec": float(np.max(after.std["ECC"])) / ARCSEC,
        "true A before / arcsec": true_before.accuracy / ARCSEC,
        "true A after / arcsec": true_after.accuracy / ARCSEC,
        "true E before / arcsec": true_before.systematic / ARCSEC,
        "true E after / arcsec": true_after.systematic / ARCSEC,
    }
    for name, value in figures.items():
        record_property(name, value)
    (tmp_path / "figures.json").write_text(json.dumps(figures, indent=1))
    assert ranges[0] > 50.0
    assert ranges[1] < ranges[0] / 50
    assert true_after.systematic < true_before.systematic / 50
    assert true_after.accuracy < true_before.accuracy / 50
