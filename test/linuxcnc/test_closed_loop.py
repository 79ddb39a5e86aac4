"""The whole loop on a real controller: measure, solve, export, load, measure again.

LinuxCNC moves a plant with a known error. Driver, planner, capture, solver and recorder are the
real nodes; only the tracer and its reflector are simulated, and they follow the plant.
"""

import json
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
import pytest
from plants import REFERENCE_DEG, SMALLER, Plant, machine_with, true_deviations
from real_linuxcnc import HERE

from rotcal_ros.compensation.export import prepare_export
from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.sessions import running
from rotcal_ros.sessions.attaching import Viewers
from rotcal_ros.sessions.running import calibrate
from rotcal_ros.sessions.session import prepare_session

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")
pytestmark = [pytest.mark.linuxcnc, pytest.mark.ros, pytest.mark.long]  # make test-kilted runs it

CONFIGURATION = HERE.parents[1] / "config" / "verify_demo.yaml"
CHANGES = (
    "plan.box_points=[2, 2, 2]",
    "plan.bidirectional=true",
    "plan.table_step_deg=20.0",
    "plan.table_positions=18",
    "plan.order=targets_per_station",
    "capture.settle_time_s=0.02",
    "capture.step_timeout_s=20.0",
    "simulation.time_scale=1.0",
    "simulation.table.external=true",
    "simulation.table.ecc.amplitudes_arcsec=[0.0]",
    "simulation.tracer.rate_hz=250.0",
    "simulation.tracer.mount_m=[0.5, -0.03, 0.1225]",
    "simulation.probe.following_um=0.0",
    "simulation.probe.report_delay_s=0.005",
    "simulation.probe.systematic_um=0.3",
    "simulation.probe.repeatability_um=0.05",
    "solver.target_std_m=4.0e-7",
    "solver.length_std_m=8.0e-8",
    "solver.rejection_significance=1e-5",  # chance makes no loop suspect
    "solver.noise_significance=1e-5",
    "solver.test_significance=1e-5",
    "simulation.probe.speed_m_s=20.0",
    "simulation.probe.acceleration_m_s2=1000.0",
    "cell.axis=A",
    "simulation.faults.spike_probability=0.0",
)
HALF = ("plan.table_step_deg=60.0", "plan.table_positions=6")
"""Every third angle tells what is left; between them looks ``true_deviations``."""
SEED = 20261122


@pytest.fixture
def plant():
    return Plant(SEED)


@pytest.fixture
def axis(tmp_path, plant):
    return machine_with(plant, tmp_path / "axis")


@pytest.fixture
def with_driver(axis, monkeypatch):
    """Let every session start the driver too, which starts LinuxCNC."""
    start = running._start

    def command(described, module):
        found = start(described, module)
        if module == "rotcal_ros.nodes.adapters.linuxcnc_driver":
            found += ["-p", f"agent_command:={json.dumps(axis.command())}"]
        return found

    monkeypatch.setattr(running, "_start", command)
    monkeypatch.setattr(running, "NODES", (*running.NODES, "linuxcnc_driver"))


def measured(folder: Path, *changes: str) -> Result:
    """Calibrate through all nodes."""
    session = prepare_session(CONFIGURATION, folder, (*CHANGES, *changes))
    with Viewers(session) as viewers:
        outcome = calibrate(session, viewers)
    assert outcome["verdict"] == "ok", outcome
    return Result.from_dict(json.loads((folder / "result.json").read_text()))


def from_the_forward_zero(directions):
    """Both curves, one after the other, and their standard uncertainties; rad."""
    both = np.concatenate([directions.forward, directions.reverse])
    shift = np.eye(len(both))
    shift[:, 0] -= 1.0
    return shift @ both, np.sqrt(np.diag(shift @ directions.covariance @ shift.T))


@pytest.mark.usefixtures("with_driver")
def test_the_error_and_the_play_of_a_real_axis_are_measured_and_removed(
    axis, plant, tmp_path, record_property
):
    before = measured(tmp_path / "before")
    zero = plant.deviation(0.0, 1)
    truth = [plant.deviation(before.directions["ECC"].angles, side) - zero for side in (1, -1)]
    missed, std = from_the_forward_zero(before.directions["ECC"])
    assert np.all(np.abs(missed - np.concatenate(truth)) < 5 * std + 1e-9)

    made = prepare_export(
        table_from_result(before, axis="A", reference_angle=REFERENCE_DEG * DEGREE),
        "linuxcnc",
        now=datetime.now(timezone.utc),
        spacing=5 * DEGREE,
        settings={"first_turn": -1, "turns": 3, "machine_ini": str(axis.ini)},
    )
    axis.take(made)
    after = measured(tmp_path / "after", *HALF)
    left = true_deviations(axis)

    there_was = plant.deviations()
    ranges = [
        np.ptp(from_the_forward_zero(r.directions["ECC"])[0]) / ARCSEC for r in (before, after)
    ]
    figures = {
        "play / arcsec": plant.play_deg * 3600,
        "measured range before / arcsec": ranges[0],
        "measured range after / arcsec": ranges[1],
        "true range before / arcsec": np.ptp(there_was) / ARCSEC,
        "true range after / arcsec": np.ptp(left) / ARCSEC,
        "true largest left / arcsec": np.max(np.abs(left)) / ARCSEC,
        "stated / arcsec": made.residual.stated / ARCSEC,
        "std of the table / arcsec": made.residual.std / ARCSEC,
    }
    for name, value in figures.items():
        record_property(name, float(value))  # workers of the tests send plain numbers only
    (tmp_path / "figures.json").write_text(json.dumps(figures, indent=1))
    assert np.max(np.abs(left)) < made.residual.stated + 4 * made.residual.std
    assert np.ptp(left) < np.ptp(there_was) / SMALLER
    assert ranges[1] < ranges[0] / SMALLER
    assert made.residual.following == 0.0  # the play is above the dead band of this machine
