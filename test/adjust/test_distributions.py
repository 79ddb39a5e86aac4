"""The tails equal those of scipy.stats to the last bit."""

import numpy as np
import pytest
from scipy import stats

from rotcal_ros.adjust.distributions import (
    binomial_quantile,
    chi2_isf,
    chi2_sf,
    detectable_size,
    f_isf,
    f_sf,
    normal_isf,
    normal_sf,
    sidak,
    t_sf,
)

PROBABILITIES = (1e-12, 1e-4, 0.01, 0.3, 0.5, 0.99)


@pytest.mark.parametrize("dof", [1, 3, 40.5, 2000])
def test_chi_squared(dof):
    for value in (0.0, 0.1, 1.0, dof, 3.0 * dof + 10.0):
        assert chi2_sf(value, dof) == stats.chi2.sf(value, dof)
    for p in PROBABILITIES:
        assert chi2_isf(p, dof) == stats.chi2.isf(p, dof)


@pytest.mark.parametrize("p", PROBABILITIES)
def test_normal_and_f(p):
    assert normal_isf(p) == stats.norm.isf(p)
    dof, below = np.array([1, 3, 3]), np.array([7, 50, 5000])
    assert np.array_equal(f_isf(p, dof, below), stats.f.isf(p, dof, below))


@pytest.mark.parametrize("value", [0.0, 0.3, 1.0, 2.5, 9.0])
def test_tails_of_normal_and_f(value):
    assert normal_sf(value) == stats.norm.sf(value)
    assert t_sf(value, 5) == pytest.approx(stats.t.sf(value, 5), rel=1e-14)
    assert f_sf(value, 24.5, 79.0) == stats.f.sf(value, 24.5, 79.0)


@pytest.mark.parametrize("p", PROBABILITIES)
@pytest.mark.parametrize("chance", [0.01, 0.0455, 0.5, 0.9])
def test_quantiles_of_hits(p, chance):
    for trials in (1, 2, 12, 360, 5000):
        assert binomial_quantile(p, trials, chance) == stats.binom.ppf(p, trials, chance)


def test_arrays_keep_their_shape():
    dof = np.array([[1, 2], [3, 4]])
    assert np.array_equal(chi2_isf(0.05, dof), stats.chi2.isf(0.05, dof))


def test_the_size_that_a_test_finds():
    """By the noncentral distributions of scipy.stats; many degrees of freedom are like all."""
    limit, power = 3.1, 0.95
    assert stats.norm.sf(limit - detectable_size(limit, power)) == pytest.approx(power)
    rare = stats.t.isf(stats.norm.sf(limit), 9.0)
    size = detectable_size(limit, power, 9.0)
    both = stats.nct.sf(rare, 9.0, size) + stats.nct.cdf(-rare, 9.0, size)
    assert both == pytest.approx(power, abs=1e-5)
    assert detectable_size(limit, power, 1e7) == pytest.approx(
        detectable_size(limit, power), rel=1e-5
    )


@pytest.mark.parametrize("tests", [1, 7, 5000])
@pytest.mark.parametrize("together", [1e-6, 0.01, 0.3])
def test_several_tests_alarm_together_as_often_as_one(tests, together):
    one = sidak(together, tests)
    assert stats.binom.sf(0, tests, one) == pytest.approx(together, rel=1e-12)
    assert sidak(together, 0) == pytest.approx(together)  # of none: nothing is divided
