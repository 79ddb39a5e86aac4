"""What a curve may do between its angles, against sums of harmonics written out."""

import numpy as np
import pytest
from compensation_examples import TAU, even
from scipy.interpolate import CubicSpline

from rotcal_ros.compensation.interpolation_uncertainty import (
    HarmonicKernels,
    damped_cosine_sum,
    fit_harmonic_kernels,
)

NODES = np.array([0.0, 0.4, 1.1, 1.9, 2.2, 3.3, 4.0, 4.9, 5.5])


def test_the_kernel_is_the_sum_of_all_harmonics():
    apart, orders = np.linspace(-4.0, 9.0, 41), np.arange(1, 400)
    for decay in (0.1, 0.5, 0.9):
        expected = (decay**orders * np.cos(np.outer(apart, orders))).sum(axis=1)
        np.testing.assert_allclose(damped_cosine_sum(np.cos(apart), decay), expected, atol=1e-12)


def test_what_a_spline_misses_is_the_sum_over_its_errors():
    """Each harmonic alone through scipy's spline, cosine and sine; their squares add up."""
    content, at = (
        HarmonicKernels(np.array([0.5, 0.2]), np.array([4.0, 9.0])),
        np.linspace(0.1, 6.2, 37),
    )

    def spline(values):
        knots = np.append(NODES, NODES[0] + TAU)
        return CubicSpline(knots, np.append(values, values[:1], axis=0), bc_type="periodic")(at)

    expected = np.zeros(len(at))
    for k in range(1, 60):
        for wave in (np.cos, np.sin):
            missed = wave(k * at) - spline(wave(k * NODES))
            expected += (4.0 * 0.5**k + 9.0 * 0.2**k) * missed**2
    found = content.interpolation_variance(spline(np.eye(len(NODES))), NODES, at)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


@pytest.mark.parametrize("decay", [0.3, 0.7])
def test_size_and_decay_are_found_again(decay):
    """Of 60 random curves; the variance of the whole curve and its share above order 4.

    A few waves show the size badly: the mean over all that explain them lies above, by up to two.
    """
    rng, orders, angles = np.random.default_rng(2), np.arange(1, 30), even(72)
    waves = np.exp(1j * np.outer(angles, orders))
    total, high = [], []
    for _ in range(60):
        size = 3.0 * decay ** (orders / 2.0)
        values = (waves @ (size * (rng.normal(size=29) + 1j * rng.normal(size=29)))).real
        noise = 0.01 * rng.normal(size=72)
        found = fit_harmonic_kernels(angles, values + noise, 1e-4 * np.eye(72))
        powers = found.decay[:, None] ** orders
        total.append(found.variance @ powers.sum(axis=1))
        high.append(found.variance @ powers[:, 4:].sum(axis=1))
    truth = 9.0 * decay**orders
    assert 0.7 < np.median(total) / truth.sum() < 2.5
    assert 0.6 < np.median(high) / truth[4:].sum() < 2.5


@pytest.mark.parametrize("scale", [0.0, 1e-267, 1e-12, 1.0, 1e9])
def test_any_size_of_values_and_noise_is_taken(scale):
    angles = even(9)
    for std in (0.0, 1e-200, 1e-7, 1.0):
        found = fit_harmonic_kernels(angles, scale * np.cos(angles), std**2 * np.eye(9))
        assert np.all(np.isfinite(found.variance))
        assert np.all(found.variance >= 0.0)
