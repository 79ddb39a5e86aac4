"""Subsets that lie together."""

import numpy as np
from linear_worlds import places_on_a_ring

from rotcal_ros.adjust.subsets import (
    contiguous_runs,
    distinct_of_each,
    distinct_subsets,
    largest_wrong_count,
    neighbourhoods,
    neighbourhoods_of_each,
)


def as_sets(subsets):
    return {frozenset(np.flatnonzero(one).tolist()) for one in subsets}


def test_runs_in_time_are_all_unbroken_stretches_up_to_half():
    found = as_sets(contiguous_runs(np.array([3.0, 1.0, 2.0, 0.0])))
    assert found == {frozenset(s) for s in ([3, 1], [1, 2], [2, 0])}


def test_runs_round_a_circle_close():
    found = as_sets(contiguous_runs(np.arange(6.0), closed=True))
    assert frozenset([5, 0]) in found
    assert len(found) == 12  # six pairs, six threes


def test_neighbourhoods_are_the_nearest():
    found = as_sets(neighbourhoods(places_on_a_ring(8) * [1.0, 1.001]))
    assert frozenset([7, 0, 1]) in found
    assert frozenset([0, 4]) not in found
    assert max(map(len, found)) == largest_wrong_count(8) == 4


def test_neighbourhoods_of_several_groups_are_those_of_each():
    places = np.random.default_rng(1).standard_normal((3, 70, 3))  # more than a word of bits
    for mine, found in zip(places, distinct_of_each(neighbourhoods_of_each(places)), strict=True):
        apart = np.linalg.norm(mine[:, None] - mine, axis=2)
        assert len(as_sets(found)) == len(found)
        for subset in found:
            nearest = (set(np.argsort(row)[: subset.sum()].tolist()) for row in apart)
            assert set(np.flatnonzero(subset).tolist()) in nearest


def test_distinct_keeps_each_once_in_order():
    a = np.array([[True, False, True], [False, True, True]])
    assert distinct_subsets(a, a[::-1]).tolist() == a.tolist()
    by_columns = np.asfortranarray(np.array([[True, False, True]] * 2 + [[False, True, True]]))
    assert distinct_subsets(by_columns).tolist() == a.tolist()
