"""A table position with too few balls is named and left out; the others are solved."""

from dataclasses import replace

import numpy as np
import pytest
from chances import LONG, share
from exact_plate import ExactPlate
from plate_data import PAPER_PLATE

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.foundation.results import Result
from rotcal_ros.methods.ball_plate.solver import plate_trials, solve

SIX = [0, 3, 4, 9, 14, 20]
SIGMA = 5e-8
REAL = {"table": 3e-6, "machine": 2e-6, "made": 2e-5}


def two_balls_at(problem, positions, left=2):
    """Only ``left`` balls are there at these table positions."""
    rank = np.zeros(len(problem.centres), dtype=int)
    for i in range(problem.grid):
        there = np.flatnonzero(problem.position == i)
        rank[there] = np.arange(len(there))
    return problem.take(~np.isin(problem.position, positions) | (rank < left))


@pytest.mark.parametrize("left", [2, 1, 0])
def test_the_position_is_named_and_the_others_have_the_truth(left):
    present = np.setdiff1d(np.arange(24), [5])  # the gauge is that of the angles that are left
    plate = ExactPlate(24, SIX, tilt=(1e-3, 2e-3), eccentric=(1e-3, 0.0), **REAL, present=present)
    problem = plate.problem(sigma=SIGMA)
    whole = ExactPlate(24, SIX, tilt=(1e-3, 2e-3), eccentric=(1e-3, 0.0), **REAL).problem()
    extra = two_balls_at(whole, [5], left)
    there = extra.position == 5
    joined = replace(
        problem,
        position=np.r_[problem.position, extra.position[there]],
        ball_step=np.r_[problem.ball_step, extra.ball_step[there]],
        centres=np.r_[problem.centres, extra.centres[there]],
        row=None,
    )
    result = solve(joined)
    np.testing.assert_allclose(result.angles, 2 * np.pi * present / 24)
    for name in COMPONENTS:
        error = np.abs(result.deviations[name] - plate.true(name)) / result.std[name]
        assert error.max() < 1e-3, name
        assert result.covariance[name].shape == (23, 23)
    assert len(result.rejected) == left
    assert all("table position 5" in r.why and "left out" in r.why for r in result.rejected)
    assert any("1 of 24 table positions" in w and w.endswith(": 5") for w in result.warnings)
    again = Result.from_dict(result.to_dict())
    assert again.to_json() == result.to_json()


@pytest.mark.slow
def test_stated_uncertainties_hold_with_positions_left_out():
    present = np.setdiff1d(np.arange(24), [5, 6, 17])
    plate = ExactPlate(24, SIX, **REAL, present=present, seed=3)
    inside = []
    for seed in range(40 if LONG else 12):
        plate.seed = seed
        result = solve(plate.problem(noise=SIGMA))
        inside += [
            np.abs(result.deviations[n] - plate.true(n)) < 1.96 * result.std[n] for n in COMPONENTS
        ]
    low, high = (0.93, 0.97) if LONG else share(0.95, 12 * 24 // 3)
    assert low < np.mean(inside) < high


def test_dirt_may_leave_too_few_balls():
    """Four balls at a position, two of them dirty: flagged, and the position goes with them."""
    plate = ExactPlate(24, SIX, **REAL, seed=3)
    problem = two_balls_at(plate.problem(noise=SIGMA, sigma=SIGMA), [7], 4)
    centres = problem.centres.copy()
    dirty = np.flatnonzero(problem.position == 7)[[0, 2]]
    centres[dirty] += [[3e-3, 0.0, 0.0], [0.0, 8e-3, 8e-3]]
    result = solve(replace(problem, centres=centres))
    assert len(result.angles) == 23
    assert {r.index for r in result.rejected} == set(problem.rows[problem.position == 7].tolist())


def test_too_many_poor_positions_are_refused_by_name():
    problem = ExactPlate(24, SIX, seed=3).problem(noise=SIGMA)
    with pytest.raises(ObservabilityError, match=r"at 7 table positions fewer than 3 .* 2 \(2\)"):
        solve(two_balls_at(problem, range(2, 9)))


def test_groups_leave_out_positions_too():
    even = [0, 2, 4, 8, 14, 20]
    problem = ExactPlate(24, even, seed=6).problem(noise=SIGMA, sigma=SIGMA, separate_groups=True)
    result = solve(two_balls_at(problem, [3, 10]))
    np.testing.assert_allclose(result.angles, np.delete(2 * np.pi * np.arange(24) / 24, [3, 10]))
    for name in COMPONENTS:
        np.testing.assert_allclose(np.sqrt(np.diag(result.covariance[name])), result.std[name])
        assert np.sqrt(np.mean((result.deviations[name] / result.std[name]) ** 2)) < 1.5


@pytest.mark.slow
def test_trials_know_the_angles_that_are_left():
    plate = ExactPlate(72, PAPER_PLATE, **REAL, seed=2)
    problem = two_balls_at(plate.problem(noise=SIGMA, sigma=SIGMA), [40])
    result = solve(problem)
    values = plate_trials(problem)(np.random.default_rng(2), 2000)
    assert values.shape == (2000, 6 * 71)
    stated = np.concatenate([result.std[name] for name in COMPONENTS])
    np.testing.assert_allclose(values.std(axis=0), stated, rtol=0.08)
