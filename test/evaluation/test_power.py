"""The search for the size that a verdict notices, against tests whose power is known."""

import numpy as np
import pytest
from scipy import stats

from rotcal_ros.evaluation.power import Trial, search_detectable_size

ALPHA = 0.001


def chi_square_trial(dof, direction, errors):
    """x ~ N(size * direction, 1): noticed by x'x; size 1 moves a result by ``errors`` std."""
    limit = stats.chi2.isf(ALPHA, dof)

    def attempt(size, number):
        noise = np.random.default_rng([7, number]).standard_normal(dof)
        return Trial(bool(np.sum((noise + size * direction) ** 2) > limit), size * errors)

    return attempt


@pytest.mark.parametrize("dof", [1, 40])
@pytest.mark.parametrize("start", [0.02, 300.0])
def test_the_size_found_is_that_of_the_noncentral_chi_square(dof, start):
    direction = np.full(dof, 1.0 / np.sqrt(dof))
    errors = np.array([0.1, -0.25, 0.0])
    found = search_detectable_size(chi_square_trial(dof, direction, errors), start, 1e4, runs=400)
    noise = np.linspace(1.0, 20.0, 100_000)
    power = stats.ncx2.sf(stats.chi2.isf(ALPHA, dof), dof, noise**2)
    size = float(np.interp(0.95, power, noise))
    assert found.reached
    assert found.size == pytest.approx(size, rel=0.05)
    assert found.error == pytest.approx(0.25 * found.size, rel=1e-9)


def test_what_nothing_notices_is_told_at_the_largest_size():
    found = search_detectable_size(
        lambda size, _: Trial(False, np.array([3.0 * size])), 1.0, 50.0, runs=30
    )
    assert (found.size, found.reached) == (50.0, False)
    assert found.error == pytest.approx(150.0)


def test_what_is_noticed_without_any_effect_does_no_harm():
    found = search_detectable_size(lambda _size, _number: Trial(True, None), 1.0, 50.0, runs=30)
    assert found.reached
    assert found.size < 1e-5
    assert found.error == 0.0


def test_the_error_is_that_of_the_trials_which_nobody_noticed():
    """Of two kinds of trials the harmful one is noticed ever more often, the other never."""

    def attempt(size, number):
        harmful = number % 2 == 0
        noticed = harmful or size > 8.0
        return Trial(noticed, np.array([100.0 * size if harmful else 0.1 * size]))

    found = search_detectable_size(attempt, 1.0, 64.0, runs=40)
    assert 7.9 < found.size < 8.1 * 2**0.25
    assert found.error == pytest.approx(0.1 * found.size)


def test_an_effect_that_leaves_no_result_unnoticed_has_no_known_error():
    """Half of the trials have no result at all, and those that have one are noticed."""
    found = search_detectable_size(
        lambda _size, number: Trial(number % 2 == 0, None), 1.0, 4.0, runs=20
    )
    assert not found.reached
    assert found.error == np.inf
