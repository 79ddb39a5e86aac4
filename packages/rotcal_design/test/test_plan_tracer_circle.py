"""A plan with one zero and a stated circle, from the goal to the result of what it measures."""

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from few_runs import few_runs

from rotcal_design.verbs.tracer import tracer as command
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods import read_configuration
from rotcal_ros.methods.calibration import prepare_to_measure

GOAL = Path(__file__).parents[3] / "config" / "tracer_goal.yaml"


def planned(folder, *changes):
    """What the command prints, and the calibration of the plan that it writes."""
    options = [
        "starts=1",
        "exchanges=40",
        "spacing_m=0.2",
        "zero=one",
        "circle_std_m=7.0e-8",
        "confidence=0.7",
        *changes,
    ]
    arguments = [part for option in options for part in ("--set", option)]
    result = CliRunner().invoke(command, [str(GOAL), *arguments, "-o", str(folder), "--json"])
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    return found, prepare_to_measure(read_configuration(folder / "plan.yaml"))


def expanded_rms(result):
    """U (k = 2) of the deviations less their mean, arcsec, root mean square."""
    n = len(result.angles)
    turn = np.eye(n) - 1.0 / n
    return 2.0 * np.sqrt(np.trace(turn @ result.covariance["ECC"] @ turn) / n) / ARCSEC


@pytest.mark.slow
@pytest.mark.parametrize("changes", [[], ["repeats=3"]], ids=["each once", "repeated"])
def test_what_is_planned_is_measured_and_stated(tmp_path, changes, monkeypatch):
    few_runs(monkeypatch, 20)
    found, calibration = planned(tmp_path, *changes)
    steps = calibration.plan.steps
    pairs = [(step.table_position, step.target) for step in steps]
    assert len(steps) == found["lengths"]
    assert (len(set(pairs)) < len(pairs)) == bool(changes)
    assert all(a != b for a, b in pairwise(pairs))
    measured = calibration.measured({}, seed=1)
    result = calibration.solve(measured.observations)
    assert result.verdict == "ok"
    assert expanded_rms(result) == pytest.approx(found["expanded_rms_arcsec"], rel=2e-2)
    assert expanded_rms(result) <= 1.202
    error = np.abs(result.deviations["ECC"])[1:]  # the simulated table has none
    assert (error <= 3.0 * result.std["ECC"][1:]).all()
    assert result.details["scattering"]["the stated circle"]["contrasts"] > 0
