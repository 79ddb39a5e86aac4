import numpy as np
import pytest

from rotcal_ros.geometry.rotations import rotation_from_vector
from rotcal_ros.methods.plane_mirror.solver.normals import (
    angle_deviation,
    axis_of_two,
    azimuths,
    fit_cone,
    tangent_frame,
)
from rotcal_ros.methods.plane_mirror.solver.problem import Sets
from rotcal_ros.methods.plane_mirror.solver.readings import (
    cone_readings,
    cone_response,
    islands,
    joining_map,
)

POSE = rotation_from_vector([0.4, -0.9, 1.7])
AXIS = POSE[:, 2]


def on_cone(azimuth, lean):
    ca, sa = np.cos(azimuth) * np.cos(lean), np.sin(azimuth) * np.cos(lean)
    return np.stack([ca, sa, np.full_like(azimuth, np.sin(lean))], axis=-1) @ POSE.T


@pytest.mark.parametrize("lean", np.radians([0.0, 1.4, 5.0, -3.0]))
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_axis_and_angles_of_a_cone(lean, sense):
    """Commands that run backwards turn the axis' sense with them: it is counted by the command."""
    commanded = sense * np.radians([0.0, 22.5, 45.0, 67.5])
    true = commanded + np.array([0.0, 3e-5, -2e-5, 1e-5])
    normals = on_cone(true, lean)
    axis, height = fit_cone(normals, commanded)
    np.testing.assert_allclose(axis, AXIS, atol=1e-14)
    assert height == pytest.approx(np.sin(lean), abs=1e-15)
    found = angle_deviation(azimuths(normals, axis), commanded)
    np.testing.assert_allclose(found, true - commanded, atol=1e-14)


@pytest.mark.parametrize("step", np.radians([5.0, 22.5, -90.0]))
def test_two_normals_and_the_cone_give_the_axis(step):
    commanded = np.array([0.3, 0.3 + step])
    normals = on_cone(commanded, np.radians(5.0))
    axis = axis_of_two(normals, np.sin(np.radians(5.0)), commanded)
    np.testing.assert_allclose(axis, AXIS, atol=2e-14)


def moved(normals, axes, step):
    """Normals with each tau, then each eta, moved by ``step``: (2 G, G, 3)."""
    t, b = tangent_frame(normals, axes)
    n = len(normals)
    stack = np.tile(normals, (2 * n, 1, 1))
    for g in range(n):
        stack[g, g] += step * t[g]
        stack[n + g, g] += step * b[g]
    return stack / np.linalg.norm(stack, axis=-1, keepdims=True)


STITCHED = [0, 1, 2, 3, 3, 4, 5, 4, 5], [0, 0, 0, 0, 1, 1, 1, 2, 2]
"""Positions of normals and their stations, 22.5 degrees apart; the last has two of them only."""
REGISTERED = [0, 2, 4, 6, 8, 10, 12, 14, 0], [0] * 9


@pytest.mark.parametrize("lean", np.radians([0.0, 5.0]))
@pytest.mark.parametrize("positions_and_sets", [STITCHED, REGISTERED])
def test_the_response_of_cones_is_their_derivative(positions_and_sets, lean):
    position, number = map(np.array, positions_and_sets)
    sets = Sets(number, np.radians(22.5) * position)
    normals = on_cone(sets.commanded, lean)
    h = 1e-6
    difference = cone_readings(moved(normals, AXIS, h), sets)
    difference = (difference - cone_readings(moved(normals, AXIS, -h), sets)).T / (2.0 * h)
    response = cone_response(sets, np.sin(lean))
    # Readings count from the first of their set; the response leaves that zero open.
    first = np.searchsorted(number, number)
    np.testing.assert_allclose(response - response[first], difference, atol=2e-8)
    if lean and number.max():  # station 2 has two normals: it feels the tilts of all others
        assert np.abs(difference[8, 9:13]).max() > 1e-3


def test_chain_of_sets_is_the_papers_running_sum():
    """Equations 7 to 16: the error of a station's last position is added to the next one's."""
    position, zero = np.array([0, 1, 2, 2, 3, 4, 4, 5]), np.array([0, 0, 0, 1, 1, 1, 2, 2])
    readings = np.array([0.0, 3.0, 5.0, 0.0, -1.0, 2.0, 0.0, 7.0])
    found = joining_map(position, zero, np.ones(8), 6) @ readings
    np.testing.assert_allclose(found, [0.0, 3.0, 5.0, 4.0, 7.0, 14.0], atol=1e-12)


def test_islands_name_what_nothing_ties():
    positions, sets = islands(np.array([0, 1, 2, 3]), np.array([0, 0, 1, 1]), 4)
    assert sets[0] != sets[1]
    assert positions[0] == positions[1] == sets[0]
