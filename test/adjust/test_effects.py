"""Effects of known form: tests and detectable sizes against closed forms and drawn noise."""

import numpy as np
import pytest
from scipy import stats
from scipy.linalg import null_space
from scipy.optimize import brentq

from rotcal_ros.adjust.distributions import noncentrality
from rotcal_ros.adjust.effects import (
    ObservableEffect,
    ObservableFamily,
    effect_test,
    family_exceedance,
    family_limit,
    family_test,
    largest_undetected,
    largest_undetected_of_family,
)


def seen(design, columns, outputs, residual):
    """Return what a solution makes of columns, by plain projections."""
    projector = np.eye(len(design)) - design @ np.linalg.pinv(design)
    moved = (outputs @ np.linalg.pinv(design) @ columns).T
    left = projector @ columns
    return ObservableEffect(moved, left.T @ left, left.T @ residual, (columns**2).sum(axis=0))


def family(design, columns, outputs, residual, width=1):
    """Return the same of members of so many columns each."""
    here = seen(design, columns, outputs, residual)
    k = columns.shape[1] // width
    each = here.information.reshape(k, width, k, width)
    at = np.arange(k)
    return ObservableFamily(
        here.moved, each[at, :, at], each[at[:-1], :, at[1:]],
        here.score.reshape(k, width), here.whole.reshape(k, width),
    )  # fmt: skip


def world(n=40, p=4, k=2, seed=1):
    rng = np.random.default_rng(seed)
    design, columns = rng.standard_normal((n, p)), rng.standard_normal((n, k))
    return design, columns, np.eye(p), rng


def test_an_effect_is_what_one_more_unknown_says():
    design, columns, outputs, rng = world()
    observed = columns @ [3.0, -2.0] + rng.standard_normal(40)
    residual = observed - design @ np.linalg.lstsq(design, observed, rcond=None)[0]
    found = effect_test(seen(design, columns, outputs, residual))
    both = np.hstack([design, columns])
    whole, (after,), *_ = np.linalg.lstsq(both, observed, rcond=None)
    assert found.size == pytest.approx(whole[4:])
    assert found.squares == pytest.approx(residual @ residual - after)
    assert found.covariance == pytest.approx(np.linalg.inv(both.T @ both)[4:, 4:])
    assert found.probability == pytest.approx(stats.chi2.sf(found.squares, 2))
    studentised = effect_test(
        seen(design, columns, outputs, residual), (float(residual @ residual), 36.0)
    )
    value = found.squares / 2 / ((residual @ residual - found.squares) / 34)
    assert studentised.probability == pytest.approx(stats.f.sf(value, 2, 34))


def test_what_the_unknowns_take_up_is_not_seen_and_not_judged():
    design, columns, outputs, rng = world()
    columns[:, 1] = design @ [1.0, 2.0, 0.0, 0.0]
    residual = rng.standard_normal(40)
    residual -= design @ np.linalg.lstsq(design, residual, rcond=None)[0]
    here = seen(design, columns, outputs, residual)
    assert effect_test(here).rank == 1
    hides = largest_undetected(here, np.ones(4), 5.0, significance=0.01, power=0.95)
    assert not hides.found
    assert hides.error >= 10.0  # five units of what moves the second output by two


def test_the_detectable_size_of_one_column_is_baardas():
    design, columns, outputs, _ = world(k=1)
    here = seen(design, columns, outputs, np.zeros(40))
    size = np.sqrt(noncentrality(0.01, 0.95) / here.information[0, 0])
    std = np.array([0.5, 1.0, 2.0, 0.0])
    wanted = (size * np.abs(here.moved[0, :3]) / std[:3]).max()
    assert largest_undetected(here, std, 1e9, significance=0.01, power=0.95)[:2] == (
        pytest.approx(wanted), True,
    )  # fmt: skip
    largest = 0.5 * size
    bounded = largest_undetected(here, std, largest, significance=0.01, power=0.95)
    assert bounded == (pytest.approx(0.5 * wanted), False, False)


@pytest.mark.parametrize("k", [1, 2])
def test_over_estimated_noise_the_detectable_size_is_that_of_f(k):
    """By scipy's noncentral F and chi-squared; with nothing left, all stays unseen."""
    design, columns, outputs, _ = world(k=k)
    here, std = seen(design, columns, outputs, np.zeros(40)), np.ones(4)
    sizes = {"significance": 0.01, "power": 0.95}
    known, few = (
        largest_undetected(here, std, 1e9, dof=dof, **sizes).error for dof in (np.inf, 9.0)
    )
    below = 9.0 - k
    limit = stats.f.isf(0.01, k, below)
    needed = brentq(lambda shift: stats.ncf.sf(limit, k, below, shift) - 0.95, 1.0, 999.0)
    assert few / known == pytest.approx(np.sqrt(needed / noncentrality(0.01, 0.95, k)), rel=1e-4)
    assert not largest_undetected(here, std, 1.0, dof=float(k), **sizes).found


def test_an_effect_of_the_detectable_size_is_found_as_often_as_stated():
    """In the direction that is worst for the outputs."""
    design, columns, outputs, rng = world(k=2, seed=3)
    here = seen(design, columns, outputs, np.zeros(40))
    std = np.sqrt(np.linalg.inv(design.T @ design).diagonal())
    hides = largest_undetected(here, std, 1e9, significance=0.01, power=0.95)
    inverse = np.linalg.inv(here.information)
    size_of = [inverse @ here.moved[:, o] for o in range(4)]
    sizes = [
        a * np.sqrt(noncentrality(0.01, 0.95, 2) / (a @ here.information @ a)) for a in size_of
    ]
    errors = [abs(s @ here.moved[:, o]) / std[o] for o, s in enumerate(sizes)]
    assert hides.error == pytest.approx(max(errors))
    worst = sizes[int(np.argmax(errors))]
    hat = design @ np.linalg.pinv(design)
    hits = 0
    for _ in range(1000):
        observed = columns @ worst + rng.standard_normal(40)
        hits += effect_test(
            seen(design, columns, outputs, observed - hat @ observed)
        ).probability < 0.01  # fmt: skip
    assert 925 < hits < 972  # binomial about 950, four standard deviations


def steps(n=60):
    """Shifts from each moment on, beside a mean and a slope."""
    when = np.arange(n)
    design = np.column_stack([np.ones(n), when / n])
    return design, (when[:, None] >= np.arange(4, n - 4)).astype(float)


@pytest.mark.parametrize("width", [1, 3])
def test_the_limit_of_a_family_is_exceeded_as_rarely_as_stated(width):
    """Of shifts in one way, or in three ways that other readings feel."""
    design, columns = steps()
    ways = np.random.default_rng(8).standard_normal((60, 3)) if width > 1 else np.ones((60, 1))
    columns = (columns[:, :, None] * ways[:, None]).reshape(60, -1)
    here = family(design, columns, np.eye(2), np.zeros(60), width)
    limit = family_limit(0.05, here.alike, here.rank)
    rng, k = np.random.default_rng(5), len(here.rank)
    noise = rng.standard_normal((4000, 60))
    left = noise - noise @ (design @ np.linalg.pinv(design)).T
    score = (left @ columns).reshape(4000, k, width)
    inverse = np.linalg.inv(here.information)
    largest = np.einsum("nkv,kvw,nkw->nk", score, inverse, score).max(axis=1)
    share = (stats.chi2.sf(largest, width) < 2.0 * stats.norm.sf(limit)).mean()
    assert (
        (0.035 if width == 1 else 0.025) < share < 0.055
    )  # never much more than stated, and not far below
    assert family_exceedance(limit, here.alike, here.rank) == pytest.approx(0.05)
    assert limit < stats.norm.isf(0.025 / 52)  # than of as many independent ones


def test_a_move_in_three_ways_of_the_size_that_is_found_is_found_as_often():
    """In its worst direction for the outputs; beside one of them that no residual shows."""
    design, columns = steps()
    ways = np.random.default_rng(8).standard_normal((60, 3))
    wide = (columns[:, :, None] * ways[:, None]).reshape(60, -1)
    std = np.sqrt(np.linalg.inv(design.T @ design).diagonal())
    here = family(design, wide, np.eye(2), np.zeros(60), 3)
    hides = largest_undetected_of_family(here, std, 1e9, significance=0.01, power=0.95)
    assert hides.found
    chance = 2.0 * stats.norm.sf(family_limit(0.01, here.alike, here.rank))
    needed, moved = noncentrality(chance, 0.95, 3), here.moved.reshape(-1, 3, 2) / std
    inverse = np.linalg.inv(here.information)
    each = np.einsum("kvo,kvw,kwo->ko", moved, inverse, moved)
    assert hides.error == pytest.approx(np.sqrt(needed * each.max()))
    k, o = np.unravel_index(each.argmax(), each.shape)
    size = inverse[k] @ moved[k, :, o] * np.sqrt(needed / each[k, o])
    rng, hat, hits = np.random.default_rng(7), design @ np.linalg.pinv(design), 0
    for _ in range(300):
        observed = wide[:, 3 * k : 3 * k + 3] @ size + rng.standard_normal(60)
        left = observed - hat @ observed
        hits += family_test(family(design, wide, np.eye(2), left, 3)).probability < 0.01
    assert hits / 300 > 0.92
    wide[:, 3 * k + 1] = design @ [1.0, 2.0]
    silent = largest_undetected_of_family(
        family(design, wide, np.eye(2), np.zeros(60), 3), std, 1e3, significance=0.01, power=0.95
    )
    assert silent.hidden
    assert silent.error >= 1e3 * np.abs([1.0, 2.0] / std).max()


def test_what_nothing_shows_of_a_move_does_all_that_it_does_to_the_outputs():
    """Residuals show one mixture of three ways; the others are as large as any may be."""
    design, columns = steps()
    std, shown = np.sqrt(np.linalg.inv(design.T @ design).diagonal()), np.array([1.0, 2.0, 3.0])
    ways = np.array([[500.0, 100.0], [2.0, 7.0], [4.0, 1.0]])
    member = design @ ways.T + np.outer(columns[:, 0], shown)
    hides = largest_undetected_of_family(
        family(design, member, np.eye(2), np.zeros(60), 3), std, 1e6, significance=0.01, power=0.95
    )
    moved = np.linalg.pinv(design) @ member / std[:, None]
    assert hides.hidden
    assert hides.error == pytest.approx(
        1e6 * np.linalg.norm(moved @ null_space(shown[None]), axis=1).max(), rel=1e-5
    )


def test_the_member_of_a_family_is_named_and_its_hidden_size_found():
    design, columns = steps()
    here = family(design, columns, np.eye(2), np.zeros(60))
    std = np.sqrt(np.linalg.inv(design.T @ design).diagonal())
    hides = largest_undetected_of_family(here, std, 1e9, significance=0.01, power=0.95)
    assert hides.found
    rng = np.random.default_rng(6)
    limit = family_limit(0.01, here.alike)
    size = (limit + stats.norm.isf(0.05)) / np.sqrt(here.information[:, 0, 0])
    worst = int(np.argmax(size * np.abs(here.moved / std).max(axis=1)))
    hat, hits, near = design @ np.linalg.pinv(design), 0, 0
    for _ in range(500):
        observed = size[worst] * columns[:, worst] + rng.standard_normal(60)
        found = family_test(family(design, columns, np.eye(2), observed - hat @ observed))
        hits += found.probability < 0.01
        near += abs(found.member - worst) <= 3
    assert hits / 500 > 0.92
    assert near > 300


def test_which_way_an_output_is_moved_is_no_matter_to_what_stays_unseen():
    """What one shift makes of the outputs at the size that is found, the largest in their std."""
    design, columns = steps()
    std = np.sqrt(np.linalg.inv(design.T @ design).diagonal())
    here = family(design, columns, np.eye(2), np.zeros(60))
    limit = family_limit(0.01, here.alike) + stats.norm.isf(0.05)
    size = limit / np.sqrt(here.information[:, 0, 0])
    truth = (size * np.abs(here.moved / std).max(axis=1)).max()
    for outputs in (np.eye(2), -np.eye(2)):
        turned = family(design, columns, outputs, np.zeros(60))
        hides = largest_undetected_of_family(turned, std, 1e9, significance=0.01, power=0.95)
        assert hides.error == pytest.approx(truth, rel=1e-3)
        bare = largest_undetected_of_family(
            turned, std, 2.0, significance=0.01, power=0.95, dof=1.0
        )
        assert bare.error == pytest.approx(2.0 * np.abs(here.moved / std).max())
