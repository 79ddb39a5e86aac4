"""Bayes factors and what is known after them, by densities and adjustment of everything."""

from itertools import combinations

import numpy as np
import pytest
from linear_worlds import Dense, in_residual_space, lines, outputs, places_on_a_ring, residuals
from scipy import stats
from scipy.special import comb, logsumexp

from rotcal_ros.adjust.explanations import (
    LARGE,
    OWN,
    SIZES,
    FreeExchange,
    _flipped,
    free_errors,
    output_change_without,
    rescale_to_variance,
    scatter_hypothesis,
    search_subsets,
    shift_hypotheses,
)
from rotcal_ros.adjust.sensitivity import sum_moments
from rotcal_ros.adjust.subsets import contiguous_runs, neighbourhoods

E = 8
SUBSET = np.isin(np.arange(E), [1, 2, 4])


def world(seed=0, own_zero=True, shift=0.0, subset=SUBSET):
    """A view, its group of the second point, and the columns (n, 8) of its rows."""
    rng = np.random.default_rng(seed)
    design = lines(own_zero=own_zero)
    errors = rng.standard_normal(len(design))
    errors[E : 2 * E] += shift * subset
    view = Dense(design, outputs(design, 4, own_zero), residuals(design, errors))
    near = neighbourhoods(places_on_a_ring(E) * [1.0, 1.01])
    group = view.group("station", "station 1", np.arange(E), np.arange(E, 2 * E), gathered=near)
    columns = np.zeros((len(design), E))
    columns[E : 2 * E] = np.eye(E)
    return view, group, columns


def by_density(view, columns, size):
    """ln of the density of the residuals with errors columns @ N(0, size^2), over that without."""
    space = in_residual_space(view.design)
    seen, more = space.T @ view.residual, space.T @ columns * size
    covariance = np.eye(len(seen)) + more @ more.T
    return stats.multivariate_normal.logpdf(
        seen, cov=covariance
    ) - stats.multivariate_normal.logpdf(seen, cov=np.eye(len(seen)))


def by_adjustment(view, columns, size, errors):
    """Expected error of the outputs and its covariance, from the posterior of unknowns and sizes.

    The sizes join the unknowns, each with an observation of zero.
    """
    k = columns.shape[1]
    design = np.block(
        [[view.design, columns * size], [np.zeros((k, view.design.shape[1])), np.eye(k)]]
    )
    cofactor = np.linalg.pinv(design.T @ design)
    there = cofactor @ design.T @ np.append(errors, np.zeros(k))
    p = view.design.shape[1]
    plain = np.linalg.lstsq(view.design, errors, rcond=None)[0]
    best = view.outputs @ cofactor[:p, :p] @ view.outputs.T
    before = view.outputs @ np.linalg.pinv(view.design.T @ view.design) @ view.outputs.T
    return view.outputs @ (plain - there[:p]), best - before


@pytest.mark.parametrize("own_zero", [True, False])
@pytest.mark.parametrize("form", ["shift", "free", "scatter"])
def test_bayes_factors_and_moments(own_zero, form):
    view, group, columns = world(3, own_zero, shift=2.0)
    together = np.linalg.cholesky(np.ones((3, 3)) + OWN**2 * np.eye(3))
    found, errors = {
        "shift": (shift_hypotheses(group, SUBSET[None]), columns @ SUBSET[:, None]),
        "free": (free_errors(group, SUBSET), columns[:, SUBSET] @ together),
        "scatter": (scatter_hypothesis(group), columns),
    }[form]
    for t, size in enumerate(SIZES):
        assert found.log_bayes()[0, t] == pytest.approx(by_density(view, errors, size), abs=1e-8)
        weights = np.zeros((1, len(SIZES)))
        weights[0, t] = 1.0
        mean, second = sum_moments([found.moment(weights)], group.sensitivity.outputs)
        expected, spread = by_adjustment(view, errors, size, view.residual)
        assert mean == pytest.approx(expected, abs=1e-9)
        assert second == pytest.approx(np.outer(expected, expected) + spread, rel=1e-8, abs=1e-8)


def test_shifts_of_all_axes_of_an_element():
    rng = np.random.default_rng(5)
    design = rng.standard_normal((18, 4))
    view = Dense(design, rng.standard_normal((2, 4)), residuals(design, rng.standard_normal(18)))
    unit = rng.uniform(1.0, 3.0, (6, 3))
    group = view.group("position", "position 0", np.arange(6), np.arange(18).reshape(6, 3), unit)
    subset = np.array([True, False, True, True, False, False])
    columns = np.zeros((18, 3))
    for e in np.flatnonzero(subset):
        columns[3 * e : 3 * e + 3] = np.diag(unit[e] / np.median(unit))
    found = shift_hypotheses(group, subset[None])
    for t, size in enumerate(SIZES):
        assert found.log_bayes()[0, t] == pytest.approx(by_density(view, columns, size), abs=1e-8)


def test_long_runs_and_other_subsets_are_summed_up_row_by_row():
    """Runs in order, round the end and scattered; each as its column by the whole projection."""
    rng, e = np.random.default_rng(6), LARGE + 20
    design, unit = rng.standard_normal((e + 5, 4)), rng.uniform(1.0, 3.0, e)
    view = Dense(
        design, rng.standard_normal((3, 4)), residuals(design, rng.standard_normal(e + 5))
    )
    group = view.group("run", "run 0", np.arange(e), np.arange(e), unit)
    subsets = np.concatenate([
        np.eye(e, dtype=bool),
        contiguous_runs(np.arange(float(e))),
        contiguous_runs(rng.permutation(np.arange(float(e))))[:20],
        contiguous_runs(np.arange(float(e)), closed=True)[-20:],
    ])  # fmt: skip
    found = shift_hypotheses(group, subsets)
    columns = np.zeros((e + 5, len(subsets)))
    columns[:e] = (unit / np.median(unit))[:, None] * subsets.T
    left = residuals(design, columns)
    assert found.values[:, 0] == pytest.approx((left**2).sum(axis=0), rel=1e-9)
    assert found.along[:, 0] == pytest.approx(columns.T @ view.residual, abs=1e-9)
    moved = view.outputs @ np.linalg.pinv(design) @ columns
    std = np.array([0.5, 2.0, np.inf])  # the third does not count
    assert found.reach(std)[:, 0] == pytest.approx(
        np.abs(moved[:2] / std[:2, None]).max(axis=0), rel=1e-9
    )
    half = found.take(slice(30, 60))
    assert half.reach(std) == pytest.approx(found.reach(std)[30:60])


def test_leaving_a_subset_out_is_adjusting_without_it():
    view, group, _ = world(7, shift=5.0)
    rows = np.delete(np.arange(len(view.design)), E + np.flatnonzero(SUBSET))
    there = np.linalg.lstsq(view.design[rows], view.residual[rows], rcond=None)[0]
    assert output_change_without(group, SUBSET) == pytest.approx(view.outputs @ there, abs=1e-9)


def test_studentised_is_the_same_with_other_noise():
    _view, group, _ = world(2)
    other = rescale_to_variance(group, 4.0)
    assert other.residual == pytest.approx(group.residual / 2.0)
    assert output_change_without(other, SUBSET) == pytest.approx(
        output_change_without(group, SUBSET)
    )


def enumerated(group):
    """All subsets of two to four of eight, and ln of prior times Bayes factor of each."""
    found = np.array(
        [np.isin(np.arange(E), one) for k in (2, 3, 4) for one in combinations(range(E), k)]
    )
    prior = -np.log(3 * comb(E, found.sum(axis=1)))
    return found, prior + logsumexp(shift_hypotheses(group, found).log_bayes(), axis=1)


@pytest.mark.parametrize("own_zero", [True, False])
def test_the_search_finds_what_enumeration_finds(own_zero):
    hits = 0
    for seed in range(40):
        _, group, _ = world(seed, own_zero, shift=(0.0, 2.0, 4.0)[seed % 3])
        subsets, merit = enumerated(group)
        best = search_subsets(group)[0]
        same = (subsets == best).all(axis=1)
        hits += merit[same][0] >= merit.max() - 1e-9
    assert hits >= 38


@pytest.mark.parametrize("axes", [1, 3])
def test_one_element_more_or_less_is_worth_what_that_subset_is(axes):
    rng = np.random.default_rng(6)
    design = rng.standard_normal((E * axes, 4))
    view = Dense(
        design, rng.standard_normal((2, 4)), residuals(design, rng.standard_normal(E * axes))
    )
    group = view.group("run", "run 0", np.arange(E), np.arange(E * axes).reshape(E, axes))
    found = _flipped(group, np.array([SUBSET, ~SUBSET]))
    for subset, row in zip((SUBSET, ~SUBSET), found, strict=True):
        for element in range(E):
            other = subset ^ (np.arange(E) == element)
            count = int(other.sum())
            inside = 2 <= count <= E // 2
            merit = logsumexp(shift_hypotheses(group, other[None]).log_bayes()) - np.log(
                3 * comb(E, count)
            )
            assert row[element] == (pytest.approx(merit, abs=1e-9) if inside else -np.inf)


def test_no_subset_of_three_elements():
    view, _, _ = world()
    group = view.group("station", "small", np.arange(3), np.arange(3))
    assert search_subsets(group).shape == (0, 3)


@pytest.mark.parametrize("axes", [1, 3])
def test_free_subsets_that_differ_by_one_element_are_known_without_each_by_itself(axes):
    rng = np.random.default_rng(axes)
    rows = 9 * axes
    view = Dense(rng.standard_normal((2 * rows, 7)), np.eye(7), rng.standard_normal(2 * rows) * 2)
    unit = rng.uniform(0.5, 2.0, (9, axes))
    at = np.arange(rows).reshape(9, axes)
    group = view.group("station", "station 1", np.arange(9), at, unit)
    start = rng.random(9) < 0.3
    here = FreeExchange(group, start)
    for k in [*rng.integers(0, 9, 12).tolist(), None]:
        for element, found in enumerate(here.flipped()):
            other = here.subset ^ (np.arange(9) == element)
            if other.any():
                expected = free_errors(group, other).log_bayes()[0]
                np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
        if k is not None:
            here.flip(k)
