"""What may stay unseen."""

from dataclasses import replace

import numpy as np
import pytest
from linear_worlds import Dense, lines, outputs, places_on_a_ring, residuals

from rotcal_ros.adjust.judgement import judge
from rotcal_ros.adjust.reliability import largest_undetectable_shift
from rotcal_ros.adjust.subsets import contiguous_runs


def view_of(e):
    design = lines(4, e)
    view = Dense(design, outputs(design, 4), residuals(design, np.zeros(len(design))))
    angle = np.arctan2(*places_on_a_ring(e).T[::-1])
    group = view.group("station", "station 1", np.arange(e), e + np.arange(e),
                       gathered=contiguous_runs(angle, closed=True))  # fmt: skip
    return view, group


def test_a_shift_of_the_hidden_size_moves_an_output_by_the_hidden_error():
    view, group = view_of(12)
    found = largest_undetectable_shift(judge([group]), view.std, 0.01, 0.95, 1e3)
    gain = view.outputs @ np.linalg.pinv(view.design) / view.std[:, None]
    errors = [
        np.abs(gain[:, 12 + np.flatnonzero(one)].sum(axis=1)).max()
        for one in group.gathered
        if one.sum() == found.count
    ]
    assert found.seen
    assert found.error <= max(errors) * found.size * (1 + 1e-9)
    assert min(abs(found.error - found.size * np.array(errors))) == pytest.approx(0.0, abs=1e-9)


def test_more_observations_hide_less_and_none_hide_nothing():
    few = largest_undetectable_shift(judge([view_of(8)[1]]), view_of(8)[0].std, 0.01, 0.95, 1e3)
    assert (
        few.size
        > largest_undetectable_shift(
            judge([view_of(24)[1]]), view_of(24)[0].std, 0.01, 0.95, 1e3
        ).size
    )
    view, _ = view_of(8)
    bare = view.group("station", "x", np.arange(8), np.arange(8))
    assert largest_undetectable_shift(judge([bare]), view.std, 0.01, 0.95, 1.0) is None


def test_what_no_residual_shows_is_not_seen():
    design = np.eye(4)
    view = Dense(design, np.ones((1, 4)), np.zeros(4))
    group = view.group(
        "position", "p", np.arange(4), np.arange(4), gathered=contiguous_runs(np.arange(4.0))
    )
    assert not largest_undetectable_shift(judge([group]), view.std, 0.01, 0.95, 1e3).seen


def test_of_groups_that_hide_the_same_the_first_is_named():
    """Rounding does not choose: the second is worse by less than that."""
    view, group = view_of(12)
    twin = replace(
        group, name="station 2", influence=lambda: group.sensitivity.weighted(1.0 + 1e-12)
    )
    assert (
        largest_undetectable_shift(judge([group, twin]), view.std, 0.01, 0.95, 1e3).name
        == "station 1"
    )
    worse = replace(twin, influence=lambda: group.sensitivity.weighted(1.001))
    assert (
        largest_undetectable_shift(judge([group, worse]), view.std, 0.01, 0.95, 1e3).name
        == "station 2"
    )
