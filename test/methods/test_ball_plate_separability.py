"""Separability against the rank of the whole matrix, and the words."""

from itertools import combinations

import numpy as np
import pytest
from dense_ball_plate import design_of
from plate_data import simulated

from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.methods.ball_plate.solver import select
from rotcal_ros.methods.ball_plate.solver.separability import (
    require_separable,
    separability,
    separability_of,
)


def rank_deficit(problem):
    design = design_of(problem)
    return design.shape[1] - 19 - np.linalg.matrix_rank(design, tol=1e-9)


@pytest.mark.parametrize("count", [3, 4, 5])
def test_deficit_is_that_of_the_whole_matrix(count):
    rng = np.random.default_rng(count)
    layouts = list(combinations(range(1, 12), count - 1))
    for pick in rng.choice(len(layouts), 12, replace=False):
        balls = [0, *layouts[pick]]
        problem, _ = simulated(12, balls)
        assert separability(12, np.array(balls)).deficit == rank_deficit(problem), balls


def test_four_balls_fail_in_some_layouts_although_the_divisor_is_one():
    found = separability(12, np.array([0, 1, 6, 7]))
    assert (found.common_divisor, found.separable) == (1, False)
    assert found.lost == {"EAC, EBC": (2, 4, 6)}
    assert separability(12, np.array([0, 1, 3, 7])).separable
    with pytest.raises(ObservabilityError, match="harmonics 2, 4, 6 of EAC, EBC"):
        require_separable(simulated(12, [0, 1, 6, 7])[0])


@pytest.mark.parametrize(
    ("balls", "divisor"), [([1, 6, 11, 16, 21], 1), ([1, 7, 13, 19], 6), ([2, 5, 11, 20], 3)]
)
def test_a_factor_counts_only_where_the_grid_shares_it(balls, divisor):
    """Eq. 22 on a grid of 24: a distance of five steps between all balls goes around in 24."""
    assert separability(24, np.array(balls)).common_divisor == divisor


def test_divisor_one_is_enough_for_five_balls():
    for balls in combinations(range(1, 12), 4):
        found = separability(12, np.array([0, *balls]))
        assert found.separable == (found.common_divisor == 1)


def test_divisor_two_loses_the_offset_between_the_groups():
    found = separability(24, np.arange(0, 24, 2))
    assert found.common_divisor == 2
    assert found.lost["ECC"] == found.lost["EZC"] == (12,)
    text = " ".join(found.sentences())
    assert "share the factor 2" in text
    assert "harmonic 12 of ECC" in text


def test_good_plate_has_nothing_to_say():
    assert separability(72, np.array([0, 8, 12, 18, 21, 28, 32])).sentences() == ()


def test_reduced_positions_are_judged_by_the_whole_model():
    problem, _ = simulated(12, range(12))
    part = select(problem, cmm_positions=[0, 2, 4, 6, 8, 10])
    found = separability_of(part)
    assert found.deficit == rank_deficit(part) == 6
    assert 6 in found.lost["ECC"]
    assert separability_of(select(problem, cmm_positions=[0, 1, 3, 7, 8])).separable
