"""Registration, poses and circles: the numerical parts, each against its definition."""

import numpy as np
import pytest
from mirror_scene import measured
from scipy.optimize import least_squares

from rotcal_ros.geometry.rotations import rotation_from_vector
from rotcal_ros.methods.plane_mirror.solver.problem import Sets, find_nests
from rotcal_ros.methods.plane_mirror.solver.readings import (
    direct_readings,
    direct_response,
    fit_circle,
)
from rotcal_ros.methods.plane_mirror.solver.registration import (
    Poses,
    adjust_stations,
    nest_fit,
    place_stations,
)


def registered(seed=3):
    problem = measured("registration", rng=np.random.default_rng(seed))
    nests = find_nests(problem)
    weight = problem.noise.weight(problem.xyz[nests.row])
    poses = adjust_stations(problem.xyz, nests, weight, place_stations(problem, nests))
    return problem, nests, weight, poses


def test_registration_is_scipys_minimum_with_its_residuals():
    problem, nests, weight, poses = registered()
    points = problem.xyz[nests.row]
    root = np.linalg.cholesky(weight).swapaxes(1, 2)

    def misfit(unknown):
        turn, shift = unknown[:30].reshape(5, 6)[:, :3], unknown[:30].reshape(5, 6)[:, 3:]
        rotation = np.concatenate(
            [np.eye(3)[None], rotation_from_vector(turn) @ poses.rotation[1:]]
        )
        translation = np.concatenate([np.zeros((1, 3)), poses.translation[1:] + shift])
        places = np.einsum("qij,qj->qi", rotation[nests.station], points)
        places += translation[nests.station]
        off = places - unknown[30:].reshape(6, 3)[nests.point]
        own = np.einsum("qji,qj->qi", rotation[nests.station], off)
        return np.einsum("qij,qj->qi", root, own).ravel()

    first = nests.station == 0
    start = np.concatenate([np.zeros(30), points[first][np.argsort(nests.point[first])].ravel()])
    best = least_squares(misfit, start, method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert np.abs(best.x[:30]).max() < 1e-8  # nothing left to move
    fit = nest_fit(problem.xyz, nests, weight, poses)
    assert fit.chi_square == pytest.approx(2.0 * best.cost, rel=1e-6)
    assert fit.dof == 3 * 36 - 30 - 18
    whitened = misfit(best.x).reshape(-1, 3)
    np.testing.assert_allclose((whitened**2).sum(), fit.chi_square, rtol=1e-6)
    hat = best.jac @ np.linalg.solve(best.jac.T @ best.jac, best.jac.T)
    share = 1.0 - np.diag(hat).reshape(-1, 3).mean(axis=1)
    np.testing.assert_allclose(fit.redundancy, share, atol=1e-5)
    value = np.sqrt((whitened**2).sum(axis=1) / (3.0 * share))
    np.testing.assert_allclose(fit.test_value, value, rtol=1e-4)
    places = poses.placed(points, nests.station)
    np.testing.assert_allclose(
        fit.residual, places - best.x[30:].reshape(6, 3)[nests.point], atol=2e-9
    )


def test_poses_move_about_the_tracker():
    """A small turn about the tracker and a shift, along the axes of the first station."""
    poses = Poses(rotation_from_vector(np.array([[0.0, 0, 0], [0.1, 0.2, 0.3]])), np.ones((2, 3)))
    change = np.array([0.0, 0.0, 1e-3, 0.1, 0.2, 0.3])
    moved = poses.moved(change)
    np.testing.assert_array_equal(moved.rotation[0], np.eye(3))
    np.testing.assert_array_equal(moved.translation, [[1, 1, 1], [1.1, 1.2, 1.3]])
    turn = rotation_from_vector(np.array([0.0, 0.0, 1e-3]))
    np.testing.assert_allclose(moved.rotation[1], turn @ poses.rotation[1], atol=1e-15)
    point = np.array([[0.5, -0.2, 0.9]])
    for s in (0, 1):
        placed = moved.placed(point, np.array([s]))
        expected = moved.rotation[s] @ point[0] + moved.translation[s]
        np.testing.assert_allclose(placed[0], expected, atol=1e-15)


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


def test_the_response_of_circles_is_their_derivative():
    angles = np.radians([0.0, 37.0, 110.0, 190.0, 260.0, 330.0])
    sets = Sets(np.repeat([0, 1], [6, 5]), angles[[0, 1, 2, 3, 4, 5, 0, 1, 3, 4, 5]])
    azimuth = sets.commanded
    radii = np.where(sets.number == 0, 0.3, 0.2)
    out = np.column_stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth])
    along = np.column_stack([-np.sin(azimuth), np.cos(azimuth), 0 * azimuth])
    places = radii[:, None] * out
    columns = []
    for direction in (along, out):
        for k in range(11):
            step = np.zeros((11, 3))
            step[k] = 1e-6 * direction[k]
            ahead = direct_readings(places + step, sets)
            behind = direct_readings(places - step, sets)
            columns.append((ahead - behind) / 2e-6)
    found = direct_response(sets, radii)
    first = [0] * 6 + [6] * 5  # readings count from the first row of each reflector
    np.testing.assert_allclose(found - found[first], np.transpose(columns), atol=1e-6)
