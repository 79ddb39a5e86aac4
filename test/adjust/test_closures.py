"""Closures are pairs of positions whole turns apart, and open by the normal quantile."""

import numpy as np
import pytest
from scipy.stats import norm

from rotcal_ros.adjust.closures import Closure, closures


def test_positions_whole_turns_apart_close():
    angles = 2 * np.pi * np.array([0.0, 0.3, 1.0, 1.3 + 1e-7, 2.0, -1.0, 2.3])
    cumulative = np.array([0.0, 1.0, 5.0, 2.0, 7.0, 4.0, 3.5])
    root = np.random.default_rng(1).normal(size=(7, 7))
    covariance = root @ root.T
    found = closures(angles, cumulative, covariance, np.array([2, 3, 5, 7, 11, 13, 17]))
    expected = [(0, 2), (0, 4), (0, 5), (1, 6)]
    ids = [2, 3, 5, 7, 11, 13, 17]
    assert [(c.first, c.last) for c in found] == [(ids[a], ids[b]) for a, b in expected]
    for closure, (a, b) in zip(found, expected, strict=True):
        assert closure.error == cumulative[b] - cumulative[a]
        variance = covariance[a, a] + covariance[b, b] - 2 * covariance[a, b]
        assert closure.std == pytest.approx(np.sqrt(variance))


def test_each_side_of_approach_closes_by_itself():
    angles = np.radians([0.0, 90.0, 0.0, 450.0, -270.0, 360.0])
    upward = np.array([True, True, False, False, True, True])
    found = closures(angles, np.arange(6.0), np.eye(6), np.arange(6), upward)
    assert [(c.first, c.last, c.error) for c in found] == [(1, 4, 3.0), (0, 5, 5.0)]


def test_steps_that_were_typed_with_six_decimals_close():
    """21 times 17.142857 deg misses the turn by 3e-6 deg, which is no other angle."""
    angles = np.radians(17.142857 * np.arange(22))
    (found,) = closures(angles, np.zeros(22), np.eye(22), np.arange(22))
    assert (found.first, found.last) == (0, 21)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_closure_is_open_beyond_the_quantile_of_both_sides(sign):
    limit = norm.isf(0.0005)
    assert not Closure(0, 1, sign * 0.999 * limit * 1e-6, 1e-6).open(1e-3)
    assert Closure(0, 1, sign * 1.001 * limit * 1e-6, 1e-6).open(1e-3)
