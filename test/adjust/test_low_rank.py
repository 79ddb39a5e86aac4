"""Blocks and a low rank, against the whole matrices that they stand for."""

import numpy as np
import pytest

from rotcal_ros.adjust.low_rank import LowRank, Slopes
from rotcal_ros.adjust.sensitivity import Moment, Sensitivity, total

RNG = np.random.default_rng(20240611)


def positive(n):
    root = RNG.standard_normal((n, n))
    return root @ root.T + np.eye(n)


def covariance(k, s, r):
    blocks = np.array([positive(s) for _ in range(k)])
    return LowRank(blocks, RNG.standard_normal((k * s, r)), positive(r))


def forms(k=12, s=3, r=4):
    """One matrix, by its blocks and low rank, and whole."""
    some = covariance(k, s, r)
    return [some, LowRank.whole(some.dense(), s)]


def close(found, expected):
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("which", [0, 1])
def test_sums_multiples_and_products(which):
    one, other = forms()[which], covariance(12, 3, 2)
    close((one + other).dense(), one.dense() + other.dense())
    close((one + one).dense(), 2.0 * one.dense())
    close(one.scaled(3.0).dense(), 3.0 * one.dense())
    right = RNG.standard_normal((36, 5))
    close(one.times(right), one.dense() @ right)
    at = np.arange(12)
    close(one.diagonal_blocks(), one.dense().reshape(12, 3, 12, 3)[at, :, at])
    close(one.diagonal(), one.dense().diagonal())
    close(one.quick().dense(), one.dense())


@pytest.mark.parametrize("which", [0, 1])
def test_what_is_computed_of_the_points(which):
    one = forms()[which]
    slopes = Slopes(*(RNG.standard_normal(shape) for shape in ((12, 3), (12, 2), (2, 36))))
    whole = slopes.dense()
    right = RNG.standard_normal((36, 5))
    close(slopes.times(right), whole @ right)
    close(slopes.from_first.dense(), whole - whole[0])
    assert not slopes.from_first.times(right)[0].any()
    spread = slopes.spread(one)
    expected = whole @ one.dense() @ whole.T
    close(spread.dense(), expected)
    apart = whole - whole[0]
    close(spread.from_first(), apart @ one.dense() @ apart.T)
    assert not spread.from_first()[0].any()
    first, second = np.array([3, 0, 5]), np.array([7, 0, 11])
    steps = whole[second] - whole[first]
    close(spread.between(first, second), (steps @ one.dense() * steps).sum(axis=1))
    assert spread.between(first, second)[1] == 0.0


@pytest.mark.parametrize("which", [0, 1])
def test_inverse_and_determinant(which):
    one = forms(30, 1, 4)[which]
    right = RNG.standard_normal((30, 2))
    solved, determinant = one.solved(right)
    close(solved, np.linalg.solve(one.dense(), right))
    close(determinant, np.linalg.slogdet(one.dense())[1])
    close(one.lifted(2.0).dense(), one.dense() + 2.0 * np.eye(30))


@pytest.mark.parametrize("open_ones", [0, 1, 3])
@pytest.mark.parametrize("weak", [0, 2])
def test_squares_by_the_pseudo_inverse(open_ones, weak):
    """Residuals of points with unknowns of their own and four in common.

    ``weak`` points are hardly checked by others, ``open_ones`` of the four not at all.
    """
    k = 60
    checked = np.full(k, 0.6)
    checked[:weak] = 1e-5
    common = checked[:, None] * RNG.standard_normal((k, 4))
    prior = np.diag([1e-9] * open_ones + [3.0] * (4 - open_ones))
    known = common.T @ (common / checked[:, None]) + prior
    one = LowRank(checked[:, None, None], common, -np.linalg.inv(known))
    values, vectors = np.linalg.eigh(one.dense())
    seen = values > 1e-6
    assert seen.sum() == k - open_ones
    vector = one.dense() @ RNG.standard_normal(k)
    squares, rank = one.squares(vector, 1e-6)
    assert rank == seen.sum()
    assert squares == pytest.approx(((vectors[:, seen].T @ vector) ** 2 / values[seen]).sum())


def test_moments_of_the_outputs():
    common = RNG.standard_normal((8, 3))
    moments, whole = [], []
    for at in ([2], [5, 6], []):
        own = RNG.standard_normal((len(at), 4))
        sensitivity = Sensitivity(
            RNG.standard_normal((3, 4)), common, np.array(at, dtype=int), own
        )
        expected = common @ sensitivity.along
        expected[at] += own
        close(sensitivity.of(np.eye(4)), expected)
        close(sensitivity.dense(), expected)
        moments.append(Moment(sensitivity, RNG.standard_normal(4), positive(4)))
        whole.append(Moment(Sensitivity.whole(expected), moments[-1].first, moments[-1].square))
    mean, second = total(moments, 8)
    close(mean, sum(m.sensitivity.along @ m.first for m in whole))
    close(second, sum(m.sensitivity.along @ m.square @ m.sensitivity.along.T for m in whole))
    close(total(whole, 8)[1], second)
