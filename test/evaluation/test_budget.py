"""The budget of a result adds up to its uncertainty, whatever the method tells."""

import numpy as np

from rotcal_ros.evaluation.budget import REST, WHOLE, contributions
from rotcal_ros.foundation.results import Result


def result(std, details):
    n = len(std)
    return Result(
        method="m", angles=np.arange(n) * 1.0, deviations={"ECC": np.zeros(n)},
        std={"ECC": np.array(std)}, covariance={}, sigma0=1.0, dof=3, n_observations=9,
        details=details,
    )  # fmt: skip


def test_sources_add_in_squares_and_what_is_missing_is_named():
    """3-4-5 is whole; of 13 with 3 and 4, twelve are left."""
    told = {"budget": {"lengths": [0.0, 3.0], "targets": [0.0, 4.0]}}
    whole = contributions(result([0.0, 5.0], told), "ECC")
    assert [part.std[1] for part in whole] == [3.0, 4.0]
    *_, rest = contributions(result([0.0, 13.0], told), "ECC")
    assert (rest.source, rest.std[1]) == (REST, 12.0)


def test_a_method_that_does_not_split_has_one_source():
    for details in ({}, {"budget": {"lengths": [1.0]}}, {"budget": {}}):
        (only,) = contributions(result([0.0, 5.0], details), "ECC")
        assert only.source == WHOLE
        np.testing.assert_array_equal(only.std, [0.0, 5.0])
