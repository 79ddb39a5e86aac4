"""``rotcal verify --again``: what is left is added to the table, and the sum is measured.

The simulated axis is asked for its true angle; lengths and their noise are made here.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rotcal_ros.catalogue import changed, prepare, read_configuration
from rotcal_ros.observations import Approach
from rotcal_ros.recordings.sources import Source
from rotcal_ros.session_folder import SessionFolder
from rotcal_ros.sessions import verification
from rotcal_ros.sessions.session import Session
from rotcal_ros.simulation.positioning import true_runs
from rotcal_ros.units import ARCSEC

DEMO = Path(__file__).parents[2] / "config" / "verify_demo.yaml"
QUIET = (
    "simulation.table.repeatability_arcsec=0.0",
    "plan.order=targets_per_station",
    "plan.box_points=[3, 2, 2]",
)
PLAY = ("plan.bidirectional=true", "simulation.table.backlash_arcsec=6.0")
LENGTH_STD = 3e-8


def lengths(calibration, seed):
    """What the tracer reads on the simulated axis with the table that it has now."""
    settings, plan = calibration.configuration.simulation, calibration.plan
    angles, rng = np.array(plan.distinct_angles), np.random.default_rng(seed)
    off = dict(zip((Approach.POSITIVE, Approach.NEGATIVE), true_runs(settings, angles, 1),
                   strict=True))  # fmt: skip
    mount = np.array(settings.tracer.mount_m)
    for step, seen in zip(plan.steps, calibration.nominal_observations(), strict=True):
        turn = step.table_angle + off[step.approach][angles == step.table_angle, 0][0]
        c, s = np.cos(turn), np.sin(turn)
        station = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ mount
        length = np.linalg.norm(step.position - station) - settings.tracer.dead_distance_m
        yield replace(seen, mean=(float(length + LENGTH_STD * rng.standard_normal()),))


@pytest.fixture
def rounds(monkeypatch):
    """Measure without ROS; the configurations of all rounds by their names."""
    found = {}

    def measure(configuration, folder, changes, _whole):
        made = prepare(changed(read_configuration(configuration), changes))
        folder.mkdir(parents=True, exist_ok=True)
        found[folder.name] = made.configuration
        empty = not made.configuration.simulation.table.compensation.angles_deg
        result = made.solve(lengths(made, len(found)), ["none" if empty else "unknown"])
        assert result.verdict == "ok", result.warnings
        return verification.Measured(Session(made, SessionFolder(folder)), Source(result, {}))

    monkeypatch.setattr(verification, "_measure", measure)
    monkeypatch.setattr(verification, "require_ros", lambda: None)
    return found


@pytest.mark.parametrize("more", [(), PLAY])
def test_the_second_round_is_not_worse_than_the_first(tmp_path, rounds, more):
    folder = tmp_path / "out"
    changes = (*QUIET, *more)
    verification.begin(DEMO, folder, changes, verification.Request(again=True))
    found, _ = verification.verify(folder)
    assert list(rounds) == ["out", "after", "again"]
    assert found.verdict == "ok"
    std = max(np.max(found.after.std), np.max(found.again.std))
    assert found.after.systematic < found.before.systematic / 30
    assert found.again.systematic <= found.after.systematic + 4 * std
    # the axis itself, between the measured angles too
    first, second, third = (found.iso[name].systematic for name in ("before", "after", "again"))
    assert second < first / 30
    assert third <= second + 4 * std
    if more:
        assert np.all(np.abs(found.iso["again"].mean_reversal) < 0.5 * ARCSEC)
    # measured on the table in force, added to this very one
    (added,) = (folder / "compensation_added").glob("*.provenance.json")
    side = json.loads(added.read_text())
    in_force = rounds["after"].cell.table_in_force
    assert len(in_force) == 64
    assert side["in_force"].startswith(f"adds to the table {in_force}")
    assert rounds["again"].cell.table_in_force == side["contents_sha256"]
    data = json.loads((folder / "verification.json").read_text())
    assert data["again"]["systematic_E_arcsec"] == pytest.approx(
        found.again.systematic / ARCSEC, rel=1e-12
    )
