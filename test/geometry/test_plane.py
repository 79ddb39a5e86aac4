import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rotcal_ros.foundation.errors import GeometryError
from rotcal_ros.geometry.plane import fit_plane
from rotcal_ros.geometry.rotations import rotation_from_vector

SQUARE = np.array([[1.0, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
small = st.floats(-0.7, 0.7)


@given(small, small, small, st.floats(-3, 3))
def test_recovers_a_moved_plane(a, b, c, height):
    rotation = rotation_from_vector([a, b, c])
    plane = fit_plane((SQUARE + np.array([0.3, -0.2, height])) @ rotation.T)
    normal = rotation[:, 2] * np.sign(rotation[2, 2])
    assert plane.normal == pytest.approx(normal, abs=1e-12)
    assert plane.offset == pytest.approx(-height * np.sign(rotation[2, 2]), abs=1e-12)


def test_distances_lead_to_the_foot_of_the_perpendicular():
    rng = np.random.default_rng(1)
    points = rng.normal(size=(20, 3)) * [1, 1, 0.1]
    plane = fit_plane(points)
    feet = points - plane.distances(points)[:, None] * plane.normal
    assert feet @ plane.normal + plane.offset == pytest.approx(np.zeros(20), abs=1e-14)
    assert np.cross(points - feet, plane.normal) == pytest.approx(np.zeros((20, 3)), abs=1e-14)
    assert plane.distances(points).sum() == pytest.approx(0.0, abs=1e-13)


def test_basis_is_right_handed():
    for normal in ([0.1, 0.2, 1.0], [1.0, 0.01, 0.02]):
        rotation = np.linalg.qr(np.column_stack([normal, [0, 1, 0], [0, 0, 1]]))[0]
        plane = fit_plane(SQUARE @ rotation[:, [1, 2, 0]].T, up=normal)
        first, second = plane.basis()
        assert np.cross(first, second) == pytest.approx(plane.normal, abs=1e-14)
        assert plane.normal @ normal > 0


@pytest.mark.parametrize(
    ("points", "text"),
    [
        (SQUARE[:2], "at least 3"),
        (np.outer([0.0, 1, 2, 3], [1, 2, 3]), "one line"),
        (np.ones((4, 3)), "one line"),
        ([[0.0, 0, 0], [1, 0, np.nan], [0, 1, 0]], "row 1"),
    ],
)
def test_refuses_points_without_a_plane(points, text):
    with pytest.raises(GeometryError, match=text):
        fit_plane(points)
