import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rotcal_ros.foundation.errors import GeometryError
from rotcal_ros.geometry.rotations import rotation_from_vector
from rotcal_ros.methods.tracer.solver.circle import (
    algorithm_error,
    bearing_slopes,
    from_first,
    table_motion,
)

COMMANDED = np.radians([0.0, 40, 75, 130, 190, 250, 300, 345])
DEVIATION = 1e-5 * np.array([0.0, 1.0, -2.0, 3.0, 0.5, -1.5, 2.5, -0.5])


def stations(deviation=DEVIATION, radius=0.065):
    angle = COMMANDED + deviation + 0.4
    return np.column_stack(
        [radius * np.cos(angle) + 0.01, radius * np.sin(angle) - 0.02, 0.12 + 0 * angle]
    )


def noisy():
    return stations() + np.random.default_rng(5).normal(scale=2e-4, size=(8, 3))


@given(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(-3, 3))
def test_deviations_do_not_depend_on_where_the_table_stands(a, b, turn):
    rotation = rotation_from_vector([0, 0, turn]) @ rotation_from_vector([a, b, 0])
    motion = table_motion(stations() @ rotation.T + [0.3, -0.7, 1.1], COMMANDED)
    assert motion.cumulative == pytest.approx(DEVIATION, abs=1e-13)
    assert motion.adjacent == pytest.approx(np.diff(DEVIATION), abs=1e-13)


def test_order_reversed_gives_the_reversed_steps():
    forward = table_motion(noisy(), COMMANDED)
    backward = table_motion(noisy()[::-1], COMMANDED[::-1])
    assert backward.adjacent == pytest.approx(-forward.adjacent[::-1], abs=1e-13)


def test_full_circle_counts_on_beyond_360():
    angles = np.append(COMMANDED, COMMANDED[0] + 2 * np.pi)
    closed = np.vstack([stations(), stations()[:1]])
    assert table_motion(closed, angles).cumulative[-1] == pytest.approx(0.0, abs=1e-13)


def test_bearing_slopes_against_central_differences():
    points, step = noisy(), 1e-7
    motion = table_motion(points, COMMANDED)
    numeric = np.empty((8, 24))
    for column in range(24):
        shift = np.zeros(24)
        shift[column] = step
        forward = table_motion(points + shift.reshape(8, 3), COMMANDED).cumulative
        backward = table_motion(points - shift.reshape(8, 3), COMMANDED).cumulative
        numeric[:, column] = (forward - backward) / (2 * step)
    slopes = bearing_slopes(points, motion)
    jacobian = slopes[:]
    assert jacobian - jacobian[0] == pytest.approx(numeric, abs=2e-7)
    assert from_first(slopes).times(np.eye(24)) == pytest.approx(numeric, abs=2e-7)
    # the plane's share is small but has to be there: out-of-plane columns are not zero
    assert np.abs(numeric[:, 2::3]).max() > 1e-3


def test_algorithm_error_beyond_a_right_angle():
    angle = np.radians([30.0, 120, 210, -60, 170])
    shadow = np.column_stack([np.cos(angle), np.sin(angle) * np.cos(0.1)])
    expected = np.angle((shadow[:, 0] + 1j * shadow[:, 1]) * np.exp(-1j * angle))
    assert algorithm_error(angle, 0.1) == pytest.approx(expected, abs=1e-15)


def test_refuses_a_horizontal_axis():
    with pytest.raises(GeometryError, match="away from"):
        table_motion(stations()[:, [2, 0, 1]], COMMANDED)
