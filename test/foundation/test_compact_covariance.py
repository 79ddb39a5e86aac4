"""Covariances by few numbers: the matrix itself, whatever is asked of them."""

import json

import numpy as np
import pytest
from scipy.sparse import csr_array

from rotcal_ros.foundation.compact import (
    CompactCovariance,
    Covariances,
    covariances_from,
    difference_variance,
    kept,
    mapped,
    plain_covariances,
    variances_of,
    written,
)
from rotcal_ros.foundation.curves.interpolation import harmonic_estimator


def example(n=40, seed=1):
    """Values of own noise that lasts, and of three errors in common, less what one prior says."""
    rng = np.random.default_rng(seed)
    near = np.tril(np.triu(rng.normal(size=(n, n)), -3)) + 3.0 * np.eye(n)
    common, core = rng.normal(size=(n, 4)), np.diag([2.0, 1.0, 0.5, -0.02])
    return CompactCovariance.of(csr_array(near), common, core), near @ near.T + (
        common @ core @ common.T
    )


def test_all_that_is_asked_of_it_is_that_of_the_matrix():
    compact, matrix = example()
    rng, first, last = np.random.default_rng(2), np.arange(39), np.arange(1, 40)
    np.testing.assert_allclose(compact.dense(), matrix, atol=1e-12)
    np.testing.assert_allclose(variances_of(compact), matrix.diagonal(), atol=1e-12)
    wanted = difference_variance(matrix, first, last)
    np.testing.assert_allclose(difference_variance(compact, first, last), wanted, atol=1e-12)
    to = csr_array(np.eye(40)[::2] - np.eye(40)[:1])
    np.testing.assert_allclose(written(mapped(compact, to)), to @ matrix @ to.T, atol=1e-12)
    assert mapped(compact, to).variances[0] == 0.0  # what is counted from itself, exactly
    other = rng.normal(size=(40, 2))
    wanted = matrix + other @ other.T + np.diag(other[:, 0] ** 2)
    found = compact.plus(CompactCovariance.shared(other)).plus(
        CompactCovariance.alone(np.abs(other[:, 0]))
    )
    np.testing.assert_allclose(found.dense(), wanted, atol=1e-12)
    some, by = np.arange(5, 9), other[:, 1]
    scaled = compact.scaled(by).part(some).dense()
    np.testing.assert_allclose(scaled, (matrix * np.outer(by, by))[5:9, 5:9], atol=1e-12)


def test_harmonics_have_the_uncertainty_of_the_matrix():
    compact, matrix = example()
    angles = np.arange(40) * 2.0 * np.pi / 40
    each = [harmonic_estimator(angles, 6, c) for c in (compact.dense(), matrix)]
    spread = [e @ c @ e.T for e, c in zip(each, (compact.dense(), matrix), strict=True)]
    np.testing.assert_allclose(*spread, rtol=1e-9, atol=1e-12)


def test_a_file_gives_the_same_bits():
    compact, _ = example()
    data = json.loads(json.dumps(plain_covariances({"ECC": compact})))
    found = kept(covariances_from(data, 40))["ECC"]
    assert isinstance(found, CompactCovariance)
    np.testing.assert_array_equal(found.dense(), compact.dense())
    np.testing.assert_array_equal(Covariances({"ECC": compact})["ECC"], compact.dense())


@pytest.mark.parametrize(
    ("field", "value", "reason"),
    [
        ("begin", "AAAAAA==", "no rows"),
        ("value", "no base64", "no numbers"),
        ("value", "AAAAAAAA8H8=", "no rows"),
        ("columns", 3, "no rows"),
        ("columns", 1 << 40, "columns of"),
        ("common", "", "a column for each"),
        ("signs", [2.0, 1.0, 1.0, 1.0], "signs"),
        ("signs", [-1.0, -1.0, -1.0, -1.0], "contradicts its variances"),
    ],
)
def test_a_damaged_one_is_refused(field, value, reason):
    data = {"covariance": {}, "compact_covariance": {"ECC": example()[0].to_dict()}}
    data["compact_covariance"]["ECC"][field] = value
    with pytest.raises(ValueError, match=reason):
        covariances_from(data, 40)


@pytest.mark.parametrize("columns", [12, 60])
def test_what_has_more_numbers_than_a_triangle_is_condensed_and_stays_what_it_is(columns):
    rng = np.random.default_rng(4)
    near = csr_array(rng.normal(size=(20, columns)))
    long = CompactCovariance(near, rng.normal(size=(20, 2)), np.array([1.0, -0.01]))
    short = long.condensed()
    assert short.near.nnz <= 20 * 21 // 2 < long.near.nnz
    np.testing.assert_allclose(short.dense(), long.dense(), atol=1e-12)
    assert short.condensed() is short
