"""Variance components: what is estimated, what is believed, what contradicts a statement."""

import numpy as np
import pytest
from scipy import stats

from rotcal_ros.adjust.noise import PRIOR, NoiseEvidence, bent_squares, estimate_factors


def evidence_of(squares, factors, dof):
    """Two unconnected components: sums of squares of noise that was stated, after ``factors``."""
    return NoiseEvidence(
        np.array([True, True]), squares / factors**2, dof.copy(), np.diag(dof)
    )  # fmt: skip


def test_of_many_residuals_the_factor_is_their_scatter():
    dof, true = np.array([4000.0, 3000.0]), np.array([3.0, 0.5])
    squares = true**2 * dof
    found, _ = estimate_factors(
        lambda f, fit: (evidence_of(squares, f, dof), fit), None, np.ones(2), np.eye(2) / PRIOR**2
    )
    assert found.factors == pytest.approx(true, rel=2e-3)
    assert found.log_std == pytest.approx(1.0 / np.sqrt(2.0 * dof), rel=1e-3)
    assert found.contradicted(0.01).tolist() == [True, True]


def test_of_few_residuals_the_statement_counts():
    dof = np.array([1.0, 1e-6])
    squares = np.array([25.0, 1e-4])
    found, _ = estimate_factors(
        lambda f, fit: (evidence_of(squares, f, dof), fit), None, np.ones(2), np.eye(2) / PRIOR**2
    )
    assert 1.5 < found.factors[0] < 5.0
    assert found.factors[1] == pytest.approx(1.0, abs=1e-3)
    assert found.log_std[1] == pytest.approx(PRIOR, rel=1e-3)


def test_probabilities_are_those_of_chi_squared_on_both_sides():
    dof = np.array([12.0, 0.4])
    here = evidence_of(np.array([30.0, 50.0]), np.ones(2), dof)
    chance = here.probabilities()
    assert chance[0] == pytest.approx(2.0 * stats.chi2.sf(30.0, 12.0))
    assert chance[1] == 1.0  # hardly checked: nothing contradicts it


def test_bent_squares_of_sound_residuals_keep_their_sum():
    rng = np.random.default_rng(2)
    redundancy = rng.uniform(0.1, 1.0, 200_000)
    squares = redundancy * rng.standard_normal(200_000) ** 2
    bent = bent_squares(squares, redundancy, 1e-6)
    assert bent.sum() == pytest.approx(redundancy.sum(), rel=5e-3)
    assert bent_squares(np.array([1e6]), np.array([0.5]), 1e-6)[0] < 4.0
