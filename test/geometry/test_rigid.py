import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rotcal_ros.errors import GeometryError
from rotcal_ros.geometry.rigid import align, fit_rigid, require_spread
from rotcal_ros.geometry.rotations import rotation_from_vector


@given(seed=st.integers(0, 10**6), n=st.integers(3, 12))
@settings(max_examples=50, deadline=None)
def test_any_transform_is_found_exactly(seed, n):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(n, 3))
    if np.linalg.svd(points - points.mean(0), compute_uv=False)[1] < 0.1:
        return
    rotation, shift = Rotation.random(random_state=seed).as_matrix(), 10.0 * rng.normal(size=3)
    fit = fit_rigid(points, points @ rotation.T + shift)
    np.testing.assert_allclose(fit.rotation, rotation, atol=1e-12)
    np.testing.assert_allclose(fit.translation, shift, atol=1e-11)
    np.testing.assert_allclose(fit.apply(points), points @ rotation.T + shift, atol=1e-11)


def test_weighted_closed_form_agrees_with_scipy():
    rng = np.random.default_rng(1)
    source, target, weights = rng.normal(size=(8, 3)), rng.normal(size=(8, 3)), rng.uniform(size=8)
    rotation, shift = align(source, target, weights)
    mean = np.average(source, axis=0, weights=weights), np.average(target, axis=0, weights=weights)
    expected, _ = Rotation.align_vectors(target - mean[1], source - mean[0], weights=weights)
    np.testing.assert_allclose(rotation, expected.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(shift, mean[1] - expected.as_matrix() @ mean[0], atol=1e-12)


def test_a_mirrored_set_still_gives_a_rotation():
    points = np.random.default_rng(2).normal(size=(6, 3))
    rotation, _ = align(points, points * np.array([1.0, 1.0, -1.0]))
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_stacks_of_point_sets_give_stacks_of_transforms():
    rng = np.random.default_rng(3)
    source, target = rng.normal(size=(4, 5, 3)), rng.normal(size=(4, 5, 3))
    rotation, shift = align(source, target)
    for k in range(4):
        one, moved = align(source[k], target[k])
        np.testing.assert_allclose(rotation[k], one, atol=1e-13)
        np.testing.assert_allclose(shift[k], moved, atol=1e-13)


def test_stated_covariance_is_the_scatter_of_many_fits():
    rng = np.random.default_rng(4)
    points = rng.uniform(-2.0, 2.0, size=(5, 3))
    rotation, shift = rotation_from_vector([0.3, -1.1, 0.7]), np.array([1.0, 2.0, 3.0])
    factor = np.tril(rng.normal(size=(2, 5, 3, 3))) * 1e-5 + 2e-5 * np.eye(3)
    covariance = factor @ np.swapaxes(factor, -1, -2)
    changes, squares = [], []
    for _ in range(1500):
        noise = (factor @ rng.normal(size=(2, 5, 3, 1)))[..., 0]
        fit = fit_rigid(
            points + noise[0], points @ rotation.T + shift + noise[1], covariance[0], covariance[1]
        )
        turn = Rotation.from_matrix(fit.rotation @ rotation.T).as_rotvec()
        changes.append(np.concatenate([turn, fit.translation - shift]))
        squares.append(fit.chi_square)
    whitened = np.linalg.solve(np.linalg.cholesky(fit.covariance), np.array(changes).T)
    np.testing.assert_allclose(np.cov(whitened), np.eye(6), atol=0.13)
    assert np.mean(squares) == pytest.approx(fit.dof, rel=0.05)


def test_points_in_a_line_are_refused_with_figures():
    line = np.outer(np.arange(3.0), [1.0, 2.0, 0.5]) + 1e-3 * np.eye(3)
    with pytest.raises(GeometryError, match=r"nests 1, 2, 3 lie in a line \(within .* mm over"):
        require_spread(line, "nests 1, 2, 3")
    with pytest.raises(GeometryError, match="needs at least 3"):
        fit_rigid(line[:2], line[:2])


def test_rotation_vectors_come_in_stacks():
    vectors = np.random.default_rng(5).normal(size=(2, 7, 3)) * np.logspace(-12, 0, 7)[:, None]
    expected = Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix().reshape(2, 7, 3, 3)
    np.testing.assert_allclose(rotation_from_vector(vectors), expected, atol=1e-15)
