"""The paper's geometry: planes, cones, circles and sums, each against its definition."""

import numpy as np
import pytest

from rotcal_ros.geometry.rotations import rotation_from_vector, wrap_angle
from rotcal_ros.methods.plane_mirror.solver.printed import (
    axis_of_two,
    azimuths,
    connected_islands,
    fit_circle,
    fit_cone,
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
    found = wrap_angle(azimuths(normals, axis) - (commanded - commanded[0]))
    np.testing.assert_allclose(found, true - commanded, atol=1e-14)


@pytest.mark.parametrize("step", np.radians([5.0, 22.5, -90.0]))
def test_two_normals_and_the_cone_give_the_axis(step):
    commanded = np.array([0.3, 0.3 + step])
    normals = on_cone(commanded, np.radians(5.0))
    axis = axis_of_two(normals, np.sin(np.radians(5.0)), commanded)
    np.testing.assert_allclose(axis, AXIS, atol=2e-14)


def test_chain_of_sets_is_the_papers_running_sum():
    """Equations 7 to 16: the error of a station's last position is added to the next one's."""
    position, zero = np.array([0, 1, 2, 2, 3, 4, 4, 5]), np.array([0, 0, 0, 1, 1, 1, 2, 2])
    readings = np.array([0.0, 3.0, 5.0, 0.0, -1.0, 2.0, 0.0, 7.0])
    found = joining_map(position, zero, 6) @ readings
    np.testing.assert_allclose(found, [0.0, 3.0, 5.0, 4.0, 7.0, 14.0], atol=1e-12)


def test_islands_name_what_nothing_ties():
    positions, sets = connected_islands(np.array([0, 1, 2, 3]), np.array([0, 0, 1, 1]), 4)
    assert sets[0] != sets[1]
    assert positions[0] == positions[1] == sets[0]


def test_a_circle_in_space_is_found_with_axis_centre_and_radius():
    turn = rotation_from_vector([0.3, -1.1, 0.6])
    angle = np.radians([0.0, 50.0, 130.0, 200.0, 280.0])
    flat = 0.37 * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    sets = np.stack([flat @ turn.T + [5.0, -3.0, 2.0], 2.0 * flat @ turn.T - [7.0, 1.0, 0.0]])
    for commanded, sign in ((angle, 1.0), (-angle, -1.0)):
        axis, centre, radius = fit_circle(sets, commanded)
        np.testing.assert_allclose(axis, sign * np.tile(turn[:, 2], (2, 1)), atol=1e-12)
        np.testing.assert_allclose(centre, [[5.0, -3.0, 2.0], [-7.0, -1.0, 0.0]], atol=1e-12)
        np.testing.assert_allclose(radius, [0.37, 0.74], atol=1e-12)


def test_a_circle_is_the_algebraic_fit_in_the_plane():
    """Kasa: the linear equation of the circle, in the plane of smallest distances."""
    rng = np.random.default_rng(8)
    angle = np.radians([0.0, 40.0, 90.0, 170.0, 230.0, 300.0])
    points = np.column_stack([0.3 * np.cos(angle), 0.3 * np.sin(angle), 0.1 + 0 * angle])
    points += rng.normal(0.0, 1e-3, points.shape)
    middle = points.mean(axis=0)
    axes = np.linalg.svd(points - middle)[2]
    flat = (points - middle) @ axes[:2].T
    a = np.column_stack([2 * flat, np.ones(6)])
    x, y, c = np.linalg.lstsq(a, (flat**2).sum(axis=1), rcond=None)[0]
    axis, centre, radius = fit_circle(points, angle)
    np.testing.assert_allclose(centre, middle + np.array([x, y]) @ axes[:2], atol=1e-12)
    assert radius == pytest.approx(np.sqrt(c + x**2 + y**2), rel=1e-12)
    np.testing.assert_allclose(axis, axes[2] * np.sign(axes[2, 2]), atol=1e-12)
