"""Sphere fits against scipy, simulated truth and degenerate points."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from rotcal_ros.foundation.errors import GeometryError
from rotcal_ros.geometry.sphere import fit_spheres

BALL, TIP = 0.0125, 0.0015


def upper_half(n=15):
    """Directions spread over the upper half of a ball."""
    height = (np.arange(n) + 0.5) / n
    around = 2.399963 * np.arange(n)
    flat = np.sqrt(1 - height**2)
    return np.column_stack([flat * np.cos(around), flat * np.sin(around), height])


def balls(count, noise=1e-7, seed=0, n=15):
    rng = np.random.default_rng(seed)
    centres = rng.normal(size=(count, 3)) * 0.2
    points = centres[:, None] + upper_half(n) * (BALL + TIP)
    return centres, points + noise * rng.normal(size=points.shape)


@pytest.mark.parametrize("radius", [BALL, None])
def test_equals_scipy_ball_by_ball(radius):
    _, points = balls(8, noise=1e-6, seed=3)
    found = fit_spheres(points, radius=radius, tip_radius=TIP, reject=False)
    for ball, cloud in enumerate(points):
        start = np.r_[cloud.mean(axis=0) - [0, 0, BALL / 2], [] if radius else [BALL]]

        def distance(x, cloud=cloud):
            size = BALL + TIP if radius else x[3]
            return np.linalg.norm(cloud - x[:3], axis=1) - size

        best = least_squares(distance, start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
        np.testing.assert_allclose(found.centres[ball], best.x[:3], atol=1e-12)
        if radius is None:
            assert found.radii[ball] + TIP == pytest.approx(best.x[3], abs=1e-12)
        covariance = np.linalg.inv(best.jac.T @ best.jac)[:3, :3]
        np.testing.assert_allclose(found.unit_covariance[ball], covariance, atol=1e-6)
        np.testing.assert_allclose(found.residuals[ball], best.fun, atol=1e-12)
        assert found.form_deviation[ball] == pytest.approx(np.ptp(best.fun), abs=1e-12)


@pytest.mark.parametrize("radius", [BALL, None])
def test_covariance_is_that_of_the_scatter(radius):
    centres, points = balls(4000)
    found = fit_spheres(points, radius=radius, tip_radius=TIP, reject=False)
    error = (found.centres - centres) / 1e-7
    np.testing.assert_allclose(np.cov(error.T), found.unit_covariance[0], atol=0.06)
    assert np.mean(found.std**2) == pytest.approx(1e-14, rel=0.02)
    assert set(found.dof) == {12 if radius else 11}


def test_a_touch_on_dirt_is_left_out_and_the_centre_stays():
    centres, points = balls(50, seed=2)
    points[7, 4] += 2e-5 * upper_half()[4]
    found = fit_spheres(points, radius=BALL, tip_radius=TIP)
    assert not found.used[7, 4]
    assert found.used.sum() >= 50 * 15 - 4
    assert found.residuals[7, 4] == pytest.approx(2e-5, rel=0.05)
    assert np.abs(found.centres[7] - centres[7]).max() < 4e-7


def test_false_alarms_are_rare():
    _, points = balls(2000, seed=5)
    found = fit_spheres(points, radius=BALL, tip_radius=TIP)
    assert np.mean((~found.used).any(axis=1)) < 0.02


def test_balls_may_have_different_counts_and_missing_points():
    centres, points = balls(3, noise=0.0)
    points[1, 10:] = np.nan
    used = np.ones((3, 15), dtype=bool)
    used[2, :5] = False
    found = fit_spheres(points, radius=None, tip_radius=TIP, used=used)
    np.testing.assert_allclose(found.centres, centres, atol=1e-14)
    np.testing.assert_allclose(found.radii, BALL, atol=1e-14)
    assert found.used.sum(axis=1).tolist() == [15, 10, 10]


@pytest.mark.parametrize(("count", "radius", "needed"), [(3, BALL, 4), (4, None, 5)])
def test_too_few_points_are_refused(count, radius, needed):
    _, points = balls(2)
    used = np.ones((2, 15), dtype=bool)
    used[0, count:] = False
    found = fit_spheres(points, radius=radius, tip_radius=TIP, used=used)
    assert found.reason[0] == (
        f"{count} usable touch points, at least {needed} are needed (one to check)"
    )
    assert np.isnan(found.centres[0]).all()
    assert found.reason[1] is None


@pytest.mark.parametrize("radius", [BALL, None])
def test_badly_spread_points_are_refused(radius):
    around = np.linspace(0, 2 * np.pi, 15, endpoint=False)
    equator = (BALL + TIP) * np.column_stack([np.cos(around), np.sin(around), 0 * around])
    found = fit_spheres(equator[None], radius=radius, tip_radius=TIP)
    assert "badly spread" in found.reason[0]
    polar = np.radians(0.5) * np.sqrt(np.arange(15) / 15)
    flat = np.sin(polar)
    patch = np.column_stack([flat * np.cos(around), flat * np.sin(around), np.cos(polar)])
    found = fit_spheres((BALL + TIP) * patch[None], radius=radius, tip_radius=TIP)
    assert "badly spread" in found.reason[0]


def test_wrong_shapes_are_refused():
    with pytest.raises(GeometryError, match=r"shape \(balls, n, 3\)"):
        fit_spheres(np.zeros((4, 3)), radius=None)
    with pytest.raises(GeometryError, match="mask"):
        fit_spheres(np.zeros((2, 6, 3)), radius=None, used=np.ones((2, 5), dtype=bool))


@settings(max_examples=30, deadline=None)
@given(st.tuples(*[st.floats(-2, 2)] * 3), st.floats(0.002, 0.05), st.integers(0, 1000))
def test_exact_spheres_are_found_anywhere(centre, radius, seed):
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(12, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    points = np.array(centre) + radius * direction
    found = fit_spheres(points[None], radius=None)
    np.testing.assert_allclose(found.centres[0], centre, atol=1e-12)
    assert found.radii[0] == pytest.approx(radius, abs=1e-12)
