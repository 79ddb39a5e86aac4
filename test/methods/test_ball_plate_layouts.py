"""A layout that is known already: the same bits, and nobody can spoil what is remembered."""

import numpy as np
import pytest
from plate_data import solved

from rotcal_ros.methods.ball_plate.solver import spectral
from rotcal_ros.methods.ball_plate.solver.model import FIELDS
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, grid_angles

GRID, RADIUS = 72, 0.185
BALLS = (0, 8, 12, 18, 21, 28)


def forget():
    spectral._factor.cache_clear()
    spectral._unit_std.cache_clear()


def measured(balls, seed=0, radius=RADIUS):
    ball, table = np.repeat(balls, GRID), np.tile(np.arange(GRID), len(balls))
    angle = grid_angles(GRID)[(ball + table) % GRID]
    places = radius * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    noise = 1e-6 * np.random.default_rng(seed).normal(size=places.shape)
    return BallPlateProblem(GRID, radius, table, ball, places + noise)


def numbers(solution):
    parts = (solution.estimate, solution.unit_std)
    fields = [getattr(part, name).ravel() for part in parts for name in FIELDS]
    return np.concatenate([*fields, solution.cofactor().ravel(), solution.residuals.ravel()])


def test_a_known_layout_gives_the_same_bits():
    problems = [
        measured(BALLS),
        measured(BALLS, seed=1),
        measured(BALLS, radius=0.1),
        measured(BALLS[:-1]),
    ]
    fresh = []
    for problem in problems:
        forget()
        fresh.append(numbers(solved(spectral.SpectralFit, problem)))
    known = [numbers(solved(spectral.SpectralFit, problem)) for problem in (*problems, *problems)]
    assert all(np.array_equal(a, b) for a, b in zip(known, fresh * 2, strict=True))


def test_a_layout_is_factored_once():
    forget()
    for seed in range(3):
        solved(spectral.SpectralFit, measured(BALLS, seed))
    assert spectral._factor.cache_info().misses == 1
    assert spectral._unit_std.cache_info().misses == 1


def test_what_is_remembered_cannot_be_changed():
    solution = solved(spectral.SpectralFit, measured(BALLS))
    system = spectral.factor(GRID, np.array(BALLS))
    for array in (solution.unit_std.rotation, system.inverse, system.balls):
        with pytest.raises(ValueError, match="read-only"):
            array += 1
