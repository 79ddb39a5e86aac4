"""Runs with another zero: found, tested, and paid for in the uncertainty."""

from dataclasses import replace

import numpy as np
import pytest
from chances import LONG
from coded import coded
from tracer_scene import arc, low_ring, simulate

from rotcal_ros.foundation.errors import DataError
from rotcal_ros.methods.tracer.solver import adjust, solve
from rotcal_ros.methods.tracer.solver.solve import JOINED

STD = 2e-7
OFFSET = 37e-6


def with_pairs(problem, run, row, length, later, **more):
    """The problem with further rows: ``row`` measured again in the runs ``later``."""
    rows = {
        name: np.append(getattr(problem, name), getattr(problem, name)[row])
        for name in ("position", "target", "length_std")
    }
    again = np.append(np.zeros(len(run), np.int64), later)
    order = np.lexsort((np.arange(len(again)), np.append(run, later))).argsort()
    return replace(
        problem, **rows, length=np.append(problem.length, length), run=np.append(run, later),
        again=again, order=order, **more,
    )  # fmt: skip


def interrupted(seed=0, again=8, moved=0.0, std=STD, **options):
    """A scene whose second half has another zero, and pairs that were measured in both runs."""
    scene = simulate(seed=seed, angles=arc(11), n=24, layout=low_ring, length_std=STD)
    options = {"variant": "joint", "target_std": 1e-7, **options}
    problem = scene.problem(length_std=STD, **options)
    rng = np.random.default_rng(1000 + seed)
    run = (problem.target >= 12).astype(np.int64)  # all stations at each target, half of them
    row = np.flatnonzero(run == 0)[:: max(1, 132 // again)][:again]
    noise = rng.normal(scale=std, size=len(row)) - rng.normal(scale=STD, size=len(row))
    length = problem.length[row] + OFFSET + noise
    length[: len(row) // 2] += moved
    changed = replace(problem, length=problem.length + OFFSET * run)
    pairs = with_pairs(changed, run, row, length, np.ones(len(row), np.int64))
    return scene, problem, changed, pairs


def test_another_zero_is_found_and_leaves_no_trace():
    _, whole, changed, pairs = interrupted()
    result, undisturbed = solve(pairs), solve(whole)
    (join,) = result.details["joins"]
    assert abs(join["offset"] - OFFSET) < 4 * join["std"]
    assert (join["run"], join["steps"]) == (1, 8)
    assert result.verdict == undisturbed.verdict == "ok"
    moved = np.abs(result.deviations["ECC"] - undisturbed.deviations["ECC"])
    assert (moved <= result.std["ECC"] + 1e-12).all()
    ((_, steps, *_),) = coded(*result.warnings)[JOINED]
    assert steps == 8
    # Without the join the other zero is seen.
    assert solve(changed).verdict != "ok"


@pytest.mark.slow
def test_the_stated_uncertainty_holds_over_many_interruptions():
    scores = []
    for seed in range(20 if LONG else 8):
        scene, _, _, pairs = interrupted(seed)
        result = solve(pairs)
        error = result.deviations["ECC"] - scene.deviation
        scores.append(error[1:] / result.std["ECC"][1:])
    # std also holds the targets' prior of 1e-7, which the simulation does not use: at most 1.
    assert 0.6 < np.sqrt(np.mean(np.square(scores))) < 1.1


def test_trials_of_joined_runs_scatter_as_the_solver_states():
    solution = adjust(interrupted(again=2)[3])
    values = solution.trials(np.random.default_rng(7), 3000)
    within = 4.5 / np.sqrt(2 * 3000)
    np.testing.assert_allclose(values.std(axis=0)[1:], solution.std[1:], rtol=within)


def test_something_that_moved_makes_the_result_suspect():
    assert solve(interrupted(moved=20 * STD)[3]).verdict == "suspect"


def test_a_probe_that_came_back_elsewhere_is_reduced_along_the_beam():
    scene, _, _, pairs = interrupted()
    again = np.flatnonzero(pairs.again)
    beam = scene.targets[pairs.target[again]] - scene.stations[pairs.position[again]]
    beam /= np.linalg.norm(beam, axis=1)[:, None]
    shift = np.zeros((len(pairs.run), 3))
    shift[again] = np.random.default_rng(5).normal(scale=1e-5, size=beam.shape)
    length = pairs.length + np.einsum("ka,ka->k", np.zeros_like(shift), shift)
    length[again] += np.einsum("ka,ka->k", beam, shift[again])
    plain, reduced = (
        solve(each).details["joins"][0]
        for each in (pairs, replace(pairs, length=length, moved=shift))
    )
    assert reduced["offset"] == pytest.approx(plain["offset"], abs=2e-9)


def test_without_anything_measured_again_there_is_no_result():
    _, _, changed, pairs = interrupted()
    run = pairs.run[: len(changed.length)]
    with pytest.raises(DataError, match="was measured again in run 1"):
        solve(replace(changed, run=run, again=np.zeros(len(run), np.int64)))


def test_a_run_that_only_repeats_steps_needs_no_zero_of_its_own():
    """It was interrupted before it came to a step that was missing, or none was."""
    _, whole, _, _ = interrupted()
    run, row = np.zeros(len(whole.length), np.int64), np.arange(0, 60, 5)
    length = whole.length[row] + OFFSET
    pairs = with_pairs(whole, run, row, length, np.ones(len(row), np.int64))
    found, plain = solve(pairs), solve(whole)
    assert found.verdict == "ok"
    assert (found.std["ECC"] <= plain.std["ECC"] * (1 + 1e-9)).all()


def test_positions_that_scatter_as_stated_are_no_movement():
    std = 1e-7
    _, _, _, pairs = interrupted(3, std=0.0)
    again = np.flatnonzero(pairs.again)
    length = pairs.length.copy()
    length[again] += np.random.default_rng(3).normal(scale=np.sqrt(2.0) * std, size=len(again))
    assert solve(replace(pairs, length=length, position_std=std)).verdict == "ok"
