"""Whole CMM positions without a centre: the others are determined, and solved."""

import numpy as np
import pytest
from plate_data import PAPER_PLATE, RADIUS, in_cmm_order, simulated
from plate_disturbed import by_pseudo_inverse

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.methods.ball_plate.solver import solve

SIGMA = 5e-8
EIGHT = [0, 3, 7, 12, 18, 22, 27, 31]


CASES = [(36, EIGHT, [5]), (36, EIGHT, [5, 22]), (72, PAPER_PLATE, [40])] + [
    (n, [0, 1, 3, 7, 9], [4]) for n in (13, 16, 19)
]


@pytest.mark.slow
@pytest.mark.parametrize(("grid", "balls", "missing"), CASES)
def test_result_is_that_of_dense_least_squares(grid, balls, missing):
    whole, _ = simulated(grid, balls, seed=100 + grid + len(missing), noise=SIGMA, sigma=SIGMA)
    problem = in_cmm_order(whole.take(~np.isin(whole.cmm_index, missing)))
    result = solve(problem)
    assert (result.verdict, result.rejected) == ("ok", ())
    curves, std = by_pseudo_inverse(problem)
    for row, name in enumerate(COMPONENTS):
        scale = 1.0 if row < 3 else RADIUS
        # products of small angles, which the exact model takes along, are the difference
        away = np.abs(scale * result.deviations[name] - curves[row]) / (SIGMA * std[row])
        assert away.max() < 0.03, name
        np.testing.assert_allclose(scale * result.std[name], SIGMA * std[row], rtol=2e-6)
