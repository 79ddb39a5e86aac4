"""Stations on a stated circle: covariance, coverage, and what contradicts the statement."""

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from chances import LONG
from tracer_scenes import counted_from_first

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.geometry.rotations import positions_on_table
from rotcal_ros.methods.tracer.policy.information import Information, Lengths, Scene
from rotcal_ros.methods.tracer.solver import TracerProblem, adjust, solve
from rotcal_ros.methods.tracer.solver.prediction import predicted

SCRIPT = Path(__file__).parents[3] / "research" / "circle_coverage.py"
SPEC = importlib.util.spec_from_file_location("circle_coverage", SCRIPT)
simulated = importlib.util.module_from_spec(SPEC)
sys.modules[SPEC.name] = simulated
SPEC.loader.exec_module(simulated)

ANGLES = np.radians(-145.0 + 30.0 * np.arange(11))
STATIONS = positions_on_table((0.0569, -0.0318, 0.1225), ANGLES, (1e-4, -2e-4))
ONE_ZERO, ALONG, PER_STATION, ROSETTE = simulated.CASES


def planned(one_zero, circle_std=7e-8, each=4):
    """A plan of ``each`` lengths per station, and its problem with exact lengths."""
    targets = np.random.default_rng(9).uniform([-0.6, -0.5, 0.17], [0.6, 0.5, 1.0], (18, 3))
    position = np.repeat(np.arange(11), each)
    target = (7 * np.arange(11 * each) + position) % 18
    segment = np.zeros_like(position) if one_zero else position
    scene = Scene(STATIONS, ANGLES, targets, 1e-6, 2e-7, 1e-7, circle_std, 3e-8)
    distance = np.linalg.norm(STATIONS[position] - targets[target], axis=1)
    problem = TracerProblem(
        position, target, distance, np.hypot(2e-7, 1e-7 * distance), targets, 1e-6, ANGLES,
        error_motion_std=3e-8, circle_std=circle_std, segment=segment if one_zero else None,
        slip=0.0,
    )  # fmt: skip
    return scene, Lengths.of(position, target, segment), problem


@pytest.mark.parametrize(("one_zero", "each"), [(True, 2), (True, 6), (False, 3), (False, 6)])
def test_what_is_planned_is_what_is_stated(one_zero, each):
    scene, lengths, problem = planned(one_zero, each=each)
    known = Information(scene, lengths, 1 if one_zero else 11)
    wanted = counted_from_first(known)
    exact = predicted(problem, STATIONS)
    assert np.abs(exact.covariance - wanted).max() < 1e-6 * np.abs(wanted).max()
    rng = np.random.default_rng(each + 20)
    noisy = replace(
        problem,
        length=problem.length - 0.3 + 2e-7 * rng.standard_normal(len(lengths)),
        targets=problem.targets + 1e-6 * rng.standard_normal((18, 3)),
    )
    result = solve(noisy)  # without start values
    assert result.verdict == "ok"
    size = np.abs(exact.covariance).max()
    assert np.abs(result.covariance["ECC"] - exact.covariance).max() < 1e-3 * size


@pytest.mark.parametrize("case", [ONE_ZERO, ALONG, PER_STATION], ids=lambda case: case.name)
def test_intervals_hold_the_truth(case):
    scores = []
    for seed in range(24 if LONG else 10):
        problem, truth = simulated.measured(case, 6, seed)
        result = solve(problem)
        scores.append((result.deviations["ECC"] - truth)[1:] / result.std["ECC"][1:])
    assert 0.7 < np.sqrt(np.mean(np.square(scores))) < 1.4
    if LONG:
        assert 0.91 < np.mean(np.abs(scores) <= 1.96) < 0.99


def test_what_is_left_out_along_the_circle_is_as_stated_across_it():
    result = solve(simulated.measured(ALONG, 8, 1)[0])
    assert result.error_motion.used == simulated.CIRCLE_STD
    assert result.budget["error_motion"].max() > 1.5e-6


@pytest.mark.parametrize("seed", range(4))
def test_a_rosette_is_no_circle(seed):
    problem, truth = simulated.measured(ROSETTE, 8, seed)
    result = solve(problem)
    assert result.verdict == "suspect"
    # of few lengths a drift of the machine's frame passes for it
    assert any("their circle by" in w or "frame drifts" in w for w in result.warnings)
    error = np.abs(result.deviations["ECC"] - truth)[1:] / result.std["ECC"][1:]
    assert error.max() < 4.0
    open_ = solve(replace(problem, circle_std=None, error_motion_std=None))
    assert open_.verdict == "ok"


def test_an_outlier_is_not_blamed_on_the_circle():
    problem, _ = simulated.measured(ONE_ZERO, 8, 2)
    length = problem.length.copy()
    length[20] += 2e-5
    result = solve(replace(problem, length=length))
    assert [r.index for r in result.rejected] == [20]
    assert result.verdict == "ok"


@pytest.mark.parametrize("datum", ["prior", "free"])
def test_trials_scatter_as_stated(datum):
    problem = replace(simulated.measured(ONE_ZERO, 20, 3)[0], datum=datum)
    result = solve(problem)
    trials = adjust(problem).trials(np.random.default_rng(0), 3000)
    assert trials.std(axis=0)[1:] == pytest.approx(result.std["ECC"][1:], rel=0.06)
    stated = replace(problem, circle_std=None, error_motion_std=simulated.CIRCLE_STD)
    assert solve(stated).std["ECC"].max() > result.std["ECC"].max()


def test_stations_that_are_solved_alone_know_no_circle():
    problem, _ = simulated.measured(PER_STATION, 8, 0)
    with pytest.raises(ConfigurationError, match="a stated circle ties all stations together"):
        replace(problem, variant="station")
    with pytest.raises(ConfigurationError, match="circle_std is 0"):
        replace(problem, circle_std=0.0)
