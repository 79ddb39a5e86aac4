"""Trials of the ball plate: each equals the solver's own answer, and together its covariance."""

from dataclasses import replace

import numpy as np
import pytest
from plate_data import simulated

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.methods.ball_plate.solver import plate_trials, solve

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
def test_trials_scatter_as_the_solver_states(name):
    problem = plates()[name]
    values = plate_trials(problem)(np.random.default_rng(1), 4000)
    np.testing.assert_allclose(values.std(axis=0), stacked(solve(problem).std), rtol=0.06)


@pytest.mark.slow
def test_separate_groups_with_given_deviations():
    """Noise of its own for each coordinate, enlarged by what the residuals of its axis demand."""
    problem, _ = simulated(24, [0, 2, 4, 8, 14, 20], separate_groups=True)
    n = len(problem.centres)
    std = np.linspace(2e-8, 8e-8, 3 * n).reshape(n, 3)
    trials = plate_trials(replace(problem, std=std))
    result = solve(replace(problem, std=std))
    values = trials(np.random.default_rng(5), 30)
    np.testing.assert_allclose(values.std(axis=0), stacked(result.std), rtol=0.5)
