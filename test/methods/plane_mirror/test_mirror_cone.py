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
from rotcal_ros.methods.plane_mirror.solver.problem import MirrorPairs
from rotcal_ros.methods.plane_mirror.solver.readings import (
    islands,
    joining_map,
    registered_readings,
    registered_response,
    stitch,
    stitch_response,
)

POSE = rotation_from_vector([0.4, -0.9, 1.7])
AXIS = POSE[:, 2]


def on_cone(azimuth, lean):
    ca, sa = np.cos(azimuth) * np.cos(lean), np.sin(azimuth) * np.cos(lean)
    return np.stack([ca, sa, np.full_like(azimuth, np.sin(lean))], axis=-1) @ POSE.T


def pairs_of(position, station):
    index = np.arange(len(position))
    return MirrorPairs(index, index, index, index, np.array(position), np.array(station))


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


@pytest.mark.parametrize("lean", np.radians([0.0, 5.0]))
def test_response_of_stitching_is_its_derivative(lean):
    angles = np.radians(np.arange(6) * 22.5)
    pairs = pairs_of([0, 1, 2, 3, 3, 4, 5, 4, 5], [0, 0, 0, 0, 1, 1, 1, 2, 2])
    normals = on_cone(angles[pairs.position], lean)
    h = 1e-6
    difference = stitch(moved(normals, AXIS, h), pairs, angles)
    difference = (difference - stitch(moved(normals, AXIS, -h), pairs, angles)).T / (2.0 * h)
    response = stitch_response(normals, pairs, angles)
    # Readings count from the first of their station; the response leaves that zero open.
    first = np.array([0, 0, 0, 0, 4, 4, 4, 7, 7])
    np.testing.assert_allclose(response - response[first], difference, atol=2e-8)
    if lean:  # station 2 has two normals: it feels the tilts of all others
        assert np.abs(difference[8, 9:13]).max() > 1e-3


def test_response_of_registration_is_its_derivative():
    angles = np.radians(np.arange(8) * 45.0)
    pairs = pairs_of([*range(8), 0], [0] * 9)
    lean = np.radians(5.0)
    normals = on_cone(angles[pairs.position], lean)

    h = 1e-6
    change = registered_readings(moved(normals, AXIS, h), pairs, angles)
    change = change - registered_readings(moved(normals, AXIS, -h), pairs, angles)
    response = registered_response(pairs, angles, np.sin(lean))
    np.testing.assert_allclose(response - response[0], change.T / (2.0 * h), atol=1e-8)


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
