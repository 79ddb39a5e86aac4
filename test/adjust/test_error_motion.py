"""Spectra of error motions, against closed forms and drawn motions."""

import numpy as np
import pytest

from rotcal_ros.adjust.error_motion import WHITE, Spectrum

TURN = np.radians(np.arange(0.0, 360.0, 30.0))


@pytest.mark.parametrize(
    "spectrum",
    [WHITE, Spectrum((2,), (1.0,)), Spectrum((2, 3, 7), (0.5, 0.2, 0.1), 0.2)],
)
def test_covariance_is_that_of_drawn_harmonics(spectrum):
    random, count = np.random.default_rng(4), 40_000
    drawn = np.sqrt(spectrum.white) * random.standard_normal((count, len(TURN)))
    for order, share in zip(spectrum.orders, spectrum.shares, strict=True):
        a, b = np.sqrt(share) * random.standard_normal((2, count, 1))
        drawn = drawn + a * np.cos(order * TURN) + b * np.sin(order * TURN)
    root = spectrum.root(TURN)
    assert root @ root.T == pytest.approx(np.cov(drawn.T), abs=0.03)
    assert (root**2).sum(axis=1) == pytest.approx(1.0)


def test_sizes_that_fall_with_the_order():
    found = Spectrum.falling(2, 4)
    assert found.orders == (2, 3, 4)
    assert np.array(found.shares) == pytest.approx(
        np.array([1 / 4, 1 / 9, 1 / 16]) / (1 / 4 + 1 / 9 + 1 / 16)
    )


def test_single_orders_hold_every_mixture():
    row = np.random.default_rng(1).standard_normal(len(TURN))
    worst = max(np.linalg.norm(row @ each.root(TURN)) for each in Spectrum.one_each())
    for spectrum in (Spectrum.falling(1), Spectrum.falling(2), Spectrum.of_sizes([0, 1, 1, 1])):
        assert np.linalg.norm(row @ spectrum.root(TURN)) <= worst


@pytest.mark.parametrize(
    ("orders", "shares", "white"),
    [((2,), (0.5,), 0.0), ((2, 3), (1.0,), 0.0), ((0,), (1.0,), 0.0), ((2,), (1.5,), -0.5)],
)
def test_shares_that_are_no_whole(orders, shares, white):
    with pytest.raises(ValueError, match="share"):
        Spectrum(orders, shares, white)


def test_no_size_at_all():
    with pytest.raises(ValueError, match="above 0"):
        Spectrum.of_sizes([0.0, 0.0])
