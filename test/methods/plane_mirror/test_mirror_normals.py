from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from rotcal_ros.geometry.rotations import rotation_from_vector
from rotcal_ros.methods.plane_mirror.solver import TrackerNoise
from rotcal_ros.methods.plane_mirror.solver.normals import (
    fit_normals,
    image_response,
    incidence,
    pair_weights,
    tangent_frame,
)
from rotcal_ros.methods.plane_mirror.solver.problem import MirrorPairs

NORMAL = np.array([-0.9, 0.35, 0.1]) / np.linalg.norm([-0.9, 0.35, 0.1])
OFFSET = -1.7
PLACES = np.array([[0.8, -0.6, 0.2], [1.0, 0.5, -0.3], [0.4, 0.2, 0.6]])


def image(points, normal=NORMAL, offset=OFFSET):
    return points - 2.0 * (points @ normal - offset)[..., None] * normal


def one_group(n):
    index = np.arange(n)
    zero = np.zeros(1, dtype=int)
    return MirrorPairs(index, index + n, np.zeros(n, dtype=int), zero, zero, zero)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_plane_is_found_exactly(n):
    points = np.concatenate([PLACES[:n], image(PLACES[:n])])
    pairs = one_group(n)
    fit = fit_normals(points, pairs, pair_weights(points, pairs, TrackerNoise()))
    np.testing.assert_allclose(fit.normal[0], NORMAL, atol=2e-15)
    assert fit.offset[0] == pytest.approx(OFFSET, abs=4e-15)
    np.testing.assert_allclose(fit.misclosure, 0.0, atol=4e-15)


def test_incidence_is_the_angle_between_beam_and_normal():
    points = np.concatenate([PLACES, image(PLACES)])
    # The spot halves the way in proportion to the heights: found here as a point of the plane.
    beam = image(PLACES)
    spot = beam * (OFFSET / (beam @ NORMAL))[:, None]
    cosine = -(spot @ NORMAL) / np.linalg.norm(spot, axis=1)
    found = incidence(points, one_group(3), NORMAL[None])
    np.testing.assert_allclose(found, np.arccos(cosine), atol=1e-14)


def test_several_reflectors_agree_with_least_squares_over_all_points():
    """Full problem with the places of the reflectors as unknowns, solved by scipy."""
    rng = np.random.default_rng(1)
    noise = TrackerNoise(2e-5, 1e-5, 8e-5, 4e-5)
    exact = np.concatenate([PLACES, image(PLACES)])
    factor = np.linalg.cholesky(noise.covariance(exact))
    points = exact + np.einsum("nij,nj->ni", factor, rng.normal(size=exact.shape))
    pairs = one_group(3)
    fit = fit_normals(points, pairs, pair_weights(points, pairs, noise))
    whitener = np.linalg.inv(np.linalg.cholesky(noise.covariance(points)))

    def residual(x):
        normal = rotation_from_vector([0.0, x[0], x[1]]) @ NORMAL
        places = x[3:].reshape(3, 3)
        computed = np.concatenate([places, image(places, normal, x[2])])
        return np.einsum("nij,nj->ni", whitener, points - computed).ravel()

    start = np.concatenate([[0.0, 0.0, OFFSET], PLACES.ravel()])
    best = least_squares(residual, start, method="lm", xtol=1e-15, ftol=1e-15)
    normal = rotation_from_vector([0.0, best.x[0], best.x[1]]) @ NORMAL
    # The weights are those of the measured points: second order in the noise, (1e-4)^2.
    np.testing.assert_allclose(fit.normal[0], normal, atol=2e-8)
    assert np.linalg.norm(fit.normal[0] - NORMAL) > 1e-5
    assert fit.offset[0] == pytest.approx(best.x[2], abs=2e-8)


@pytest.mark.parametrize("slope", [0.0, 2e-5])
def test_information_is_the_inverse_scatter(slope):
    rng = np.random.default_rng(2)
    noise = TrackerNoise(2e-6, 1e-6, 8e-6, 4e-6, mirror_slope_std=slope)
    exact = np.concatenate([PLACES, image(PLACES)])
    pairs = one_group(3)
    trials = 4000
    factor = np.linalg.cholesky(replace(noise, mirror_slope_std=0.0).covariance(exact))
    points = exact + (factor @ rng.normal(size=(trials, 6, 3, 1)))[..., 0]
    across = np.stack(tangent_frame(NORMAL, np.array([0.0, 0.0, 1.0])))
    tilt = slope * rng.normal(size=(trials, 3, 2)) @ across
    for trial in range(trials):  # every reflector sees its own spot, with its own slope
        for k, place in enumerate(PLACES):
            beam = image(place)
            spot = beam * OFFSET / (beam @ NORMAL)
            normal = NORMAL + tilt[trial, k]
            normal /= np.linalg.norm(normal)
            points[trial, 3 + k] += image(place, normal, normal @ spot) - image(place)
    fit = fit_normals(points, pairs, pair_weights(exact, pairs, noise))
    change = np.concatenate([(fit.normal[:, 0] - NORMAL) @ across.T, fit.offset - OFFSET], axis=1)
    basis = np.zeros((4, 3))
    basis[:3, :2], basis[3, 2] = across.T, 1.0
    information = basis.T @ fit.information[0, 0] @ basis
    whitened = np.linalg.cholesky(information).T @ change.T
    np.testing.assert_allclose(np.cov(whitened), np.eye(3), atol=0.09)


def test_image_moves_as_the_response_says():
    across = np.stack(tangent_frame(NORMAL, np.array([0.0, 0.0, 1.0])))
    normals = np.tile(NORMAL, (3, 1))
    response = image_response(PLACES, image(PLACES), normals, np.full(3, OFFSET))
    for change in across:
        for k, place in enumerate(PLACES):
            spot = image(place) * OFFSET / (image(place) @ NORMAL)
            ahead, behind = (NORMAL + s * 1e-6 * change for s in (1.0, -1.0))
            moved = image(place, ahead, ahead @ spot) - image(place, behind, behind @ spot)
            np.testing.assert_allclose(response[k] @ change, moved / 2e-6, atol=1e-8)


def test_noise_ellipsoid_grows_along_and_across_the_beam():
    noise = TrackerNoise(1e-6, 2e-6, 3e-6, 4e-6)
    covariance = noise.covariance(np.array([0.0, 3.0, 4.0]))
    beam = np.array([0.0, 0.6, 0.8])
    assert beam @ covariance @ beam == pytest.approx((1e-6 + 5 * 2e-6) ** 2)
    for side in (np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.8, -0.6])):
        assert side @ covariance @ side == pytest.approx((3e-6 + 5 * 4e-6) ** 2)
        assert side @ covariance @ beam == pytest.approx(0.0, abs=1e-25)
