"""Trials of the ball plate: each equals the solver's own answer, and together its covariance."""

from dataclasses import replace

import numpy as np
import pytest
from plate_data import simulated

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.methods.ball_plate.solver import adjust, plate_trials, solve
from rotcal_ros.methods.ball_plate.solver.result import SolvedTrials

BALLS = [0, 3, 4, 9, 14, 20]


def stacked(values):
    return np.concatenate([values[name] for name in COMPONENTS])


def plates():
    complete, _ = simulated(24, BALLS, sigma=5e-8)
    n = len(complete.centres)
    uneven = replace(complete, sigma=None, std=np.linspace(4e-8, 7e-8, 3 * n).reshape(n, 3))
    return {
        "complete": complete,
        "noise from residuals": replace(complete, sigma=None),
        "gaps": complete.take(np.arange(n) % 11 != 0),
        "weighted": uneven,
    }


@pytest.mark.parametrize("name", plates())
def test_linear_map_gives_what_the_solver_finds_for_the_same_numbers(name):
    problem = plates()[name]
    trials = plate_trials(problem)
    noise = np.random.default_rng(4).standard_normal((1, problem.centres.size))
    used = adjust(problem)
    std = used.noise.scale * used.parts[0].fit.problem.noise_unit
    moved = problem.centres + std * noise.reshape(-1, 3)
    answer = stacked(solve(replace(problem, centres=moved)).deviations)
    found = trials(np.random.default_rng(4), 1)[0]
    # the map is the tangent of the exact model: products of noise and plate errors remain
    np.testing.assert_allclose(found, answer, rtol=0, atol=1e-10)


@pytest.mark.parametrize("name", plates())
def test_trials_scatter_as_the_solver_states(name):
    problem = plates()[name]
    values = plate_trials(problem)(np.random.default_rng(1), 4000)
    np.testing.assert_allclose(values.std(axis=0), stacked(solve(problem).std), rtol=0.06)


def test_separate_groups_are_solved_one_by_one():
    problem, _ = simulated(24, [0, 2, 4, 8, 14, 20], sigma=5e-8, separate_groups=True)
    trials = plate_trials(problem)
    assert isinstance(trials, SolvedTrials)
    values = trials(np.random.default_rng(3), 3)
    assert values.shape == (3, 6 * 24)
    noise = np.random.default_rng(3).standard_normal((3, *problem.centres.shape))
    for one, found in zip(noise, values, strict=True):
        answer = solve(replace(problem, centres=problem.centres + 5e-8 * one))
        np.testing.assert_array_equal(found, stacked(answer.deviations))


@pytest.mark.slow
def test_separate_groups_with_given_deviations():
    """Noise of its own for each coordinate, enlarged by what the residuals of its axis demand."""
    problem, _ = simulated(24, [0, 2, 4, 8, 14, 20], separate_groups=True)
    n = len(problem.centres)
    std = np.linspace(2e-8, 8e-8, 3 * n).reshape(n, 3)
    trials = plate_trials(replace(problem, std=std))
    assert isinstance(trials, SolvedTrials)
    scale = trials.std / std
    np.testing.assert_allclose(scale, np.tile(scale[0, [0, 0, 2]], (n, 1)), rtol=1e-12)
    result = solve(replace(problem, std=std))
    values = trials(np.random.default_rng(5), 30)
    np.testing.assert_allclose(values.std(axis=0), stacked(result.std), rtol=0.5)
