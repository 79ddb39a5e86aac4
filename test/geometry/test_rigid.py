import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rotcal_ros.foundation.errors import GeometryError
from rotcal_ros.geometry.rotations import fit_rigid_transform, require_spread, rotation_from_vector


@given(seed=st.integers(0, 10**6), n=st.integers(3, 12))
@settings(max_examples=50, deadline=None)
def test_any_transform_is_found_exactly(seed, n):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(n, 3))
    if np.linalg.svd(points - points.mean(0), compute_uv=False)[1] < 0.1:
        return
    rotation, shift = Rotation.random(random_state=seed).as_matrix(), 10.0 * rng.normal(size=3)
    found, moved = fit_rigid_transform(points, points @ rotation.T + shift)
    np.testing.assert_allclose(found, rotation, atol=1e-12)
    np.testing.assert_allclose(moved, shift, atol=1e-11)


def test_closed_form_agrees_with_scipy():
    rng = np.random.default_rng(1)
    source, target = rng.normal(size=(8, 3)), rng.normal(size=(8, 3))
    rotation, shift = fit_rigid_transform(source, target)
    mean = source.mean(axis=0), target.mean(axis=0)
    expected, _ = Rotation.align_vectors(target - mean[1], source - mean[0])
    np.testing.assert_allclose(rotation, expected.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(shift, mean[1] - expected.as_matrix() @ mean[0], atol=1e-12)


def test_a_mirrored_set_still_gives_a_rotation():
    points = np.random.default_rng(2).normal(size=(6, 3))
    rotation, _ = fit_rigid_transform(points, points * np.array([1.0, 1.0, -1.0]))
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_stacks_of_point_sets_give_stacks_of_transforms():
    rng = np.random.default_rng(3)
    source, target = rng.normal(size=(4, 5, 3)), rng.normal(size=(4, 5, 3))
    rotation, shift = fit_rigid_transform(source, target)
    for k in range(4):
        one, moved = fit_rigid_transform(source[k], target[k])
        np.testing.assert_allclose(rotation[k], one, atol=1e-13)
        np.testing.assert_allclose(shift[k], moved, atol=1e-13)


def test_points_in_a_line_are_refused_with_figures():
    line = np.outer(np.arange(3.0), [1.0, 2.0, 0.5]) + 1e-3 * np.eye(3)
    with pytest.raises(GeometryError, match=r"nests 1, 2, 3 lie in a line \(within .* mm over"):
        require_spread(line, "nests 1, 2, 3")


def test_rotation_vectors_come_in_stacks():
    vectors = np.random.default_rng(5).normal(size=(2, 7, 3)) * np.logspace(-12, 0, 7)[:, None]
    expected = Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix().reshape(2, 7, 3, 3)
    np.testing.assert_allclose(rotation_from_vector(vectors), expected, atol=1e-15)
