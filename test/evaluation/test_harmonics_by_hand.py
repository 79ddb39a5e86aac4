"""Harmonics with any covariance, against the normal equations and the propagation of errors."""

import numpy as np
import pytest
from scipy.stats import chi2

from rotcal_ros.evaluation.harmonics import harmonic_content
from rotcal_ros.foundation.curves.measured import MeasuredCurve

TAU = 2.0 * np.pi


def by_normal_equations(curve, top):
    """Coefficients cos, sin of the orders 1, 2, ..., their covariance, and what is left."""
    columns = [np.ones_like(curve.angles)]
    for k in range(1, top + 1):
        columns += [np.cos(k * curve.angles), np.sin(k * curve.angles)]
    design = np.array(columns).T
    inverse = np.linalg.inv(curve.covariance)
    covariance = np.linalg.inv(design.T @ inverse @ design)
    fit = covariance @ (design.T @ inverse @ curve.deviation)
    return fit[1:], covariance[1:, 1:], curve.deviation - design @ fit


def polar(pair):
    return np.array([np.sqrt(pair @ pair), np.angle(complex(*pair))])


@pytest.mark.parametrize("top", [1, 3, 5])
def test_every_figure_is_that_of_generalised_least_squares(top):
    """Curves of weak harmonics in strong correlated noise: some orders count, some do not."""
    rng = np.random.default_rng(top)
    outcomes = set()
    for _ in range(30):
        angles = np.sort(rng.uniform(0.0, TAU, 16))
        root = rng.normal(size=(16, 16)) * 0.2
        curve = MeasuredCurve(
            angles, np.cos(angles - 1.0) + rng.normal(size=16), root @ root.T + 0.1 * np.eye(16),
            TAU,
        )  # fmt: skip
        found = harmonic_content(curve, top)
        fit, covariance, left = by_normal_equations(curve, top)
        assert found.orders.tolist() == list(range(1, top + 1))
        assert found.residual_rms == pytest.approx(np.std(left), rel=1e-6)
        for order in range(top):
            pair = fit[2 * order : 2 * order + 2]
            own = covariance[2 * order : 2 * order + 2, 2 * order : 2 * order + 2]
            amplitude, phase = polar(pair)
            steps = np.eye(2) * 1e-6
            jacobian = np.array([polar(pair + h) - polar(pair - h) for h in steps]).T / 2e-6
            std = np.sqrt(np.diag(jacobian @ own @ jacobian.T))
            assert found.cosine[order] == pytest.approx(pair[0], rel=1e-6)
            assert found.sine[order] == pytest.approx(pair[1], rel=1e-6)
            assert found.amplitude[order] == pytest.approx(amplitude, rel=1e-6)
            assert found.phase[order] == pytest.approx(phase, rel=1e-6)
            assert found.amplitude_std[order] == pytest.approx(std[0], rel=1e-4)
            assert found.phase_std[order] == pytest.approx(min(std[1], np.pi / 3**0.5), rel=1e-4)
            significant = pair @ np.linalg.solve(own, pair) > chi2.isf(0.05, 2)
            assert found.significant[order] == significant
            outcomes.add(bool(significant))
    assert outcomes == {True, False}


@pytest.mark.parametrize(
    ("angles", "orders"), [(3, 1), (4, 1), (9, 4), (10, 4), (24, 11), (25, 12), (36, 12)]
)
def test_as_many_orders_as_the_angles_can_tell_apart_but_twelve(angles, orders):
    at = np.arange(angles) * TAU / angles
    found = harmonic_content(MeasuredCurve(at, np.cos(at), np.eye(angles), TAU))
    assert found.orders.tolist() == list(range(1, orders + 1))


def test_the_phase_of_nothing_is_anywhere_and_no_uncertainty_claims_nothing():
    """Anywhere on the circle: a uniform phase has the standard deviation pi / sqrt(3)."""
    at = np.arange(12) * TAU / 12
    noisy = harmonic_content(MeasuredCurve(at, np.zeros(12), np.eye(12), TAU), 2)
    np.testing.assert_allclose(noisy.phase_std, np.pi / np.sqrt(3.0))
    np.testing.assert_allclose(noisy.amplitude_std, np.sqrt(2.0 / 12.0))
    exact = harmonic_content(MeasuredCurve(at, np.zeros(12), np.zeros((12, 12)), TAU), 2)
    assert not exact.significant.any()
    np.testing.assert_array_equal(exact.phase_std, [0.0, 0.0])
    np.testing.assert_array_equal(exact.amplitude_std, [0.0, 0.0])


@pytest.mark.parametrize(("share", "significant"), [(0.999, False), (1.001, True)])
def test_an_order_counts_from_the_95_percent_point_on(share, significant):
    """Equal noise s: a / (s sqrt(2/n)) above the square root of 5.9915."""
    at = np.arange(16) * TAU / 16
    size = share * np.sqrt(5.991465 * 2.0 / 16.0)
    found = harmonic_content(MeasuredCurve(at, size * np.cos(at - 0.7), np.eye(16), TAU), 1)
    assert found.significant.tolist() == [significant]
