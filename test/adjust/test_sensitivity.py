"""What many rows do to the outputs, in parts: against whole matrices."""

import numpy as np
import pytest

from rotcal_ros.adjust.sensitivity import ErrorMoments, Sensitivity, sum_moments


@pytest.mark.parametrize("shared", [True, False])
def test_sums_over_groups_are_those_of_the_whole_matrices(shared):
    """Two groups move some outputs alike, and one of them each a few of its own and the same."""
    rng = np.random.default_rng(1)
    common, mean, second = rng.standard_normal((6, 2)), np.zeros(6), np.zeros((6, 6))
    moments = []
    for n in (3, 4):
        root = rng.standard_normal((n, n))
        along = rng.standard_normal((2 if shared else 6, n))
        own, at = rng.standard_normal((3, n)), np.array([1, 2, 4])
        whole = Sensitivity.whole(along)
        moment = ErrorMoments(
            Sensitivity(along, common, at, own) if shared else whole,
            rng.standard_normal(n),
            root @ root.T,
        )
        moments.append(moment)
        dense = common @ along if shared else along
        dense[at] += own if shared else 0.0
        assert moment.sensitivity.dense() == pytest.approx(dense)
        errors = rng.standard_normal((n, 2))
        assert moment.sensitivity.of(errors) == pytest.approx(dense @ errors)
        twice = moment.sensitivity.weighted(np.full(n, 2.0))
        assert twice.dense() == pytest.approx(2.0 * dense)
        mean += dense @ moment.first
        second += dense @ moment.square @ dense.T
    found = sum_moments(moments, 6)
    assert found[0] == pytest.approx(mean)
    assert found[1] == pytest.approx(second)
