import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rotcal_ros.geometry.rotations import (
    cross_matrix,
    rotation_about_z,
    rotation_from_vector,
    wrap_angle,
)

component = st.floats(-2, 2)
vectors = st.tuples(component, component, component)


@given(st.floats(-3.1, 3.1), st.integers(-5, 5))
def test_wrap_removes_whole_turns(angle, turns):
    assert wrap_angle(angle + 2 * np.pi * turns) == pytest.approx(angle, abs=1e-13)


@given(vectors)
def test_rotation_from_vector_is_scipys(vector):
    expected = Rotation.from_rotvec(vector).as_matrix()
    assert rotation_from_vector(vector) == pytest.approx(expected, abs=1e-14)


def test_no_turn_is_exact():
    assert (rotation_from_vector([0.0, 0.0, 0.0]) == np.eye(3)).all()
    assert (rotation_about_z(0.0) == np.eye(3)).all()


@given(st.floats(-7, 7))
def test_rotation_about_z_is_counter_clockwise(angle):
    turned = rotation_about_z(np.array([angle, 0.0]))[0] @ [1.0, 0.0, 0.5]
    assert turned == pytest.approx([np.cos(angle), np.sin(angle), 0.5], abs=1e-15)


@given(vectors, vectors)
def test_cross_matrix(v, w):
    assert cross_matrix(v) @ w == pytest.approx(np.cross(v, w), abs=1e-14)
