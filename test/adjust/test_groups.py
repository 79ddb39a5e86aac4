"""Groups by closed forms and by adjusting anew without them."""

import numpy as np
import pytest
from linear_worlds import Dense, lines, outputs, residuals
from scipy import stats

from rotcal_ros.adjust.groups import group_tests

RNG = np.random.default_rng(20240511)


def view(design, errors, groups=4):
    return Dense(design, outputs(design, groups), residuals(design, errors))


def test_the_mean_of_ten_in_closed_form():
    design = np.ones((10, 1))
    found = Dense(design, np.ones((1, 1)), residuals(design, np.arange(10.0)))
    group = found.group("all", "all", np.arange(4), np.arange(4))
    assert group.cofactor[:, 0, :, 0] == pytest.approx(np.eye(4) - 0.1)
    assert group.response[0, :, 0] == pytest.approx(np.full(4, 0.1))
    assert group.residual[:, 0] == pytest.approx(np.arange(4) - 4.5)
    assert found.std == pytest.approx([np.sqrt(0.1)])


def test_squares_are_what_chi_squared_falls_by_without_the_group():
    design = lines()
    errors = RNG.standard_normal(len(design))
    rows = np.arange(8, 16)
    [test] = group_tests([view(design, errors).group("station", "one", np.arange(8), rows)])
    left = np.delete(np.arange(len(design)), rows)
    whole = (residuals(design, errors) ** 2).sum()
    without = (residuals(design[left], errors[left]) ** 2).sum()
    assert test.squares == pytest.approx(whole - without)
    assert test.rank == 5  # eight lengths, three unknowns to themselves
    assert test.redundancy == pytest.approx(5 / 8)
    assert test.probability == pytest.approx(stats.chi2.sf(whole - without, 5))


def test_estimated_noise_is_that_of_the_others():
    design = lines()
    errors = 7.0 * RNG.standard_normal(len(design))
    rows = np.arange(8, 16)
    whole = float((residuals(design, errors) ** 2).sum())
    group = view(design, errors).group("station", "one", np.arange(8), rows)
    [test] = group_tests([group], rest=(whole, 20.0))
    ratio = (test.squares / 5) / ((whole - test.squares) / 15)
    assert test.probability == pytest.approx(stats.f.sf(ratio, 5, 15))
