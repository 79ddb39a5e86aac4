"""The budget of a result adds up to its uncertainty, whatever the method states."""

import numpy as np

from rotcal_ros.evaluation.budget import REST, WHOLE, contributions
from rotcal_ros.foundation.results import Result


def result(std, budget):
    n = len(std)
    return Result(
        method="m", angles=np.arange(n) * 1.0, deviations={"ECC": np.zeros(n)},
        std={"ECC": np.array(std)}, covariance={}, sigma0=1.0, dof=3, n_observations=9,
        budget={source: np.array(share) for source, share in budget.items()},
    )  # fmt: skip


def test_sources_add_in_squares_and_what_is_missing_is_named():
    """3-4-5 is whole; of 13 with 3 and 4, twelve are left."""
    told = {"lengths": [0.0, 3.0], "targets": [0.0, 4.0]}
    whole = contributions(result([0.0, 5.0], told), "ECC")
    assert [part.std[1] for part in whole] == [3.0, 4.0]
    *_, rest = contributions(result([0.0, 13.0], told), "ECC")
    assert (rest.source, rest.std[1]) == (REST, 12.0)


def test_a_method_that_does_not_split_has_one_source():
    (only,) = contributions(result([0.0, 5.0], {}), "ECC")
    assert only.source == WHOLE
    np.testing.assert_array_equal(only.std, [0.0, 5.0])


def test_a_budget_survives_its_file_and_only_one_share_per_angle_is_a_budget():
    """What a method calls budget without being one stays among its details."""
    written = result([0.0, 5.0], {"lengths": [0.0, 3.0]}).to_dict()
    again = Result.from_dict(written)
    np.testing.assert_array_equal(again.budget["lengths"], [0.0, 3.0])
    assert again.to_dict() == written
    assert "budget" not in again.details
    written["details"] = {"budget": {"lengths": [1.0]}}
    other = Result.from_dict(written)
    assert (other.budget, other.details) == ({}, {"budget": {"lengths": [1.0]}})
