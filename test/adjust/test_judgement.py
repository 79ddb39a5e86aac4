"""What is believed of disturbances, against truth and against all explanations enumerated."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from linear_worlds import Dense, lines, outputs, places_on_a_ring, residuals

from rotcal_ros.adjust.explanations import output_change_without, shift_hypotheses
from rotcal_ros.adjust.judgement import judge, most_probable_subset
from rotcal_ros.adjust.subsets import contiguous_runs, neighbourhoods

E, GROUPS = 20, 6
DESIGN = {zero: lines(GROUPS, E, zero) for zero in (True, False)}
GAIN = {zero: np.linalg.pinv(DESIGN[zero]) for zero in (True, False)}
NEAR = neighbourhoods(places_on_a_ring(E) * [1.0, 1.01])


def groups(errors, own_zero=True):
    return stations(DESIGN[own_zero], GROUPS, E, NEAR, errors, own_zero)


def stations(design, count, e, gathered, errors, own_zero=True):
    view = Dense(design, outputs(design, count, own_zero), residuals(design, errors))
    return view, [
        view.group(
            "station", f"station {g}", np.arange(e), e * g + np.arange(e), gathered=gathered
        )
        for g in range(count)
    ]


def disturbed(seed, which, size, own_zero=True, at=2):
    rng = np.random.default_rng(seed)
    errors = rng.standard_normal(E * GROUPS)
    errors[E * at + np.asarray(which, dtype=int)] += size
    return groups(errors, own_zero)


@pytest.mark.slow
def test_sound_data_are_called_disturbed_less_often_than_allowed():
    alarms = sum(judge(disturbed(seed, [], 0.0)[1]).proved(0.02) for seed in range(300))
    assert alarms <= 12  # 0.02 of 300 are 6; twice as many have a chance below 0.02


def test_sound_data_cost_little():
    grown = []
    for seed in range(100):
        view, found = disturbed(seed, [], 0.0)
        more = judge(found).covariance().diagonal()
        grown.append(np.sqrt(1.0 + more / view.std**2).mean())
    assert np.mean(grown) < 1.05


@pytest.mark.parametrize("own_zero", [True, False])
@pytest.mark.parametrize("which", [range(8), [0, 3, 4, 7, 9, 12, 13, 18]])
def test_eight_of_twenty_are_found_and_named(own_zero, which):
    for seed in range(5):
        _view, found = disturbed(seed, list(which), 8.0, own_zero)
        seen = judge(found)
        assert seen.proved(1e-3)
        assert seen.worst == 2
        to_blame = most_probable_subset(seen.groups[2])
        assert np.flatnonzero(to_blame.subset).tolist() == sorted(which)
        assert to_blame.size == pytest.approx([8.0], abs=3.0)


def test_the_size_is_the_shift_whatever_the_noise_was_taken_for():
    """The residuals are whitened by twice the noise that there is, which the others show."""
    for seed in range(5):
        _view, found = disturbed(seed, list(range(8)), 16.0)
        squares = sum(group.together[0] for group in found) / 4.0
        rank = sum(group.together[1] for group in found)
        wide = [replace(g, residual=g.residual / 2.0, unit=g.unit / 2.0) for g in found]
        to_blame = most_probable_subset(judge(wide, rest=(squares, rank)).groups[2])
        assert to_blame.subset.sum() == 8
        assert to_blame.size == pytest.approx([16.0], abs=3.0)


def test_uneven_errors_are_found_and_named():
    sizes = np.linspace(5.0, 15.0, 8)
    _, found = disturbed(3, np.arange(8), sizes)
    assert np.flatnonzero(most_probable_subset(judge(found).groups[2]).subset).tolist() == list(
        range(8)
    )


def test_a_half_against_the_other_is_ambiguous():
    which = np.arange(0, E, 2)
    _view, found = disturbed(1, which, 8.0)
    to_blame = most_probable_subset(judge(found).groups[2])
    assert to_blame.ambiguous
    halves = {tuple(which), tuple(which + 1)}
    assert tuple(np.flatnonzero(to_blame.subset)) in halves
    assert tuple(np.flatnonzero(to_blame.rivals[0])) in halves
    assert to_blame.ratios[0] >= 1.0


def test_which_half_is_off_by_the_same_stays_open_whatever_noise_prefers():
    """Residuals of a shift of one half are those of the other's: only noise tells them apart."""
    design = lines(GROUPS, 8)
    for seed in range(80):
        errors = np.random.default_rng([seed, 8]).standard_normal(8 * GROUPS)
        truth = np.arange(8) % 2 == seed % 2
        errors[16:24] += 30.0 * truth
        view = Dense(design, outputs(design, GROUPS), residuals(design, errors))
        group = view.group("station", "station 2", np.arange(8), 16 + np.arange(8))
        to_blame = most_probable_subset(group)
        left = output_change_without(group, truth) - to_blame.change
        std = np.sqrt(view.std**2 + (to_blame.root**2).sum(axis=1))
        assert (np.abs(left) / std).max() < 4.5, seed
        assert to_blame.ambiguous, seed


def test_one_outlier_is_left_to_screening():
    _, found = disturbed(4, [5], 12.0)
    assert not judge(found).proved(0.01)


def test_probable_but_unproved_errors_are_covered():
    """Between nothing and what is found the covariance grows by what is hidden."""
    held = []
    for seed in range(60):
        view, found = disturbed(seed, range(8), 4.0)
        truth = view.outputs @ GAIN[True] @ np.eye(E * GROUPS)[:, 2 * E : 2 * E + 8].sum(axis=1)
        seen = judge(found)
        if not seen.proved(0.02):
            std = np.sqrt(view.std**2 + seen.covariance().diagonal())
            held.append((np.abs(4.0 * truth) / std).max() < 2.5)
    assert not held or np.mean(held) > 0.8


@pytest.mark.slow
@pytest.mark.parametrize(("e", "count"), [(8, 6), (6, 3)])
def test_sound_data_whose_noise_was_estimated_are_suspected_no_more_often(e, count):
    design = lines(count, e)
    freedom = len(design) - float(np.linalg.matrix_rank(design))
    near = neighbourhoods(places_on_a_ring(e) * [1.0, 1.01])
    alarms = 0
    for seed in range(300):
        errors = 3.0 * np.random.default_rng(seed).standard_normal(len(design))
        squares = float((residuals(design, errors) ** 2).sum())
        found = judge(stations(design, count, e, near, errors)[1], rest=(squares, freedom))
        alarms += found.false_alarm_probability < 0.02
    assert alarms <= 12  # as above


def test_a_shift_that_leaves_no_residual_is_not_believed_where_noise_was_scaled_since():
    """The beams to one face of a cube from its centre: position and zero take up their shift."""
    corners = np.array(list(product((-1.0, 1.0), repeat=3))) / np.sqrt(3.0)
    design = np.column_stack([corners, np.ones(8)])
    faces = (corners @ np.vstack([np.eye(3), -np.eye(3)]).T > 0.0).T
    left = residuals(design, np.random.default_rng(1).standard_normal(8))
    view = Dense(design, np.ones((1, 4)), left)
    sound = view.group("station", "0", np.arange(8), np.arange(8), gathered=faces)
    leverage = np.eye(8).reshape(8, 1, 8, 1) - sound.cofactor
    nudged = sound.residual + 0.1 * corners[:, :1]  # what the last step of scaling has left
    spoiled = replace(sound, cofactor=sound.cofactor - 0.06 * leverage, residual=nudged)
    assert np.abs(shift_hypotheses(spoiled, faces).log_bayes()).max() < 1e-9


def test_whom_to_blame_in_a_large_group_costs_few_decompositions(monkeypatch):
    """Half of 60 x 60 free subsets on the way: only those that are compared at the end."""
    rng, e, decomposed = np.random.default_rng(1), 60, []
    errors = rng.standard_normal(2 * e)
    errors[[3, 4, 5, 31, 32, 33]] += np.repeat([20.0, -20.0], 3)
    design = lines(2, e)
    view = Dense(design, outputs(design, 2), residuals(design, errors))
    group = view.group(
        "run", "run 0", np.arange(e), np.arange(e), gathered=contiguous_runs(np.arange(e))
    )
    plain = np.linalg.eigh
    monkeypatch.setattr(
        np.linalg, "eigh", lambda matrix: decomposed.append(matrix.shape) or plain(matrix)
    )
    found = most_probable_subset(group)
    assert np.flatnonzero(found.subset).tolist() == [3, 4, 5, 31, 32, 33]
    assert len(decomposed) < 2 * e
