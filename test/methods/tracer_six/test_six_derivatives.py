"""Slopes and normal matrices against complex steps and differences."""

from dataclasses import replace

import numpy as np
import pytest
from six_scene import good_targets, scene

from rotcal_ros.methods.tracer_six.solver import SixProblem
from rotcal_ros.methods.tracer_six.solver.network import (
    curve_jacobian,
    log_slope,
    relax,
    rotation_vector,
    slopes,
    table_curves,
)
from rotcal_ros.methods.tracer_six.solver.problem import lay_out
from rotcal_ros.methods.tracer_six.solver.solution import adjust, find_start
from rotcal_ros.methods.tracer_six.solver.solve import slope_along


def turn(vectors):
    """Rotation matrices of small complex vectors, by the series of the exponential."""
    k = np.zeros((*vectors.shape, 3), dtype=vectors.dtype)
    k[..., 2, 1], k[..., 0, 2], k[..., 1, 0] = np.moveaxis(vectors, -1, 0)
    k = k - np.swapaxes(k, -1, -2)
    return np.eye(3) + k + k @ k / 2.0 + k @ k @ k / 6.0


def chi2(layout, grid, state, kept, poses, roots, tilt):
    """Minus twice the logarithm of the likelihood, written down once more, for complex steps."""
    n, p = len(state.targets), len(state.places)
    targets = state.targets + kept[: 3 * n].reshape(n, 3)
    places = state.places + kept[3 * n : 3 * (n + p)].reshape(p, 3)
    zeros = state.zeros + kept[3 * (n + p) : 3 * (n + p) + len(state.zeros)]
    rotation = turn(poses[:, :3]) @ state.rotation
    shift = state.translation + poses[:, 3:]
    stations = np.einsum("vab,vb->va", rotation[layout.position], places[layout.place])
    difference = (stations + shift[layout.position])[:, None] - targets
    error = np.sqrt((difference**2).sum(axis=2)) - zeros[layout.zero] - grid.length
    total = (((targets - grid.targets) / grid.target_std) ** 2).sum()
    direction = (difference / np.sqrt((difference**2).sum(axis=2))[..., None]).real
    for v in range(len(stations)):
        spread = direction[v] @ roots[v]
        covariance = np.diag(grid.length_std[v] ** 2) + spread @ spread.T
        total += error[v] @ np.linalg.solve(covariance, error[v])
    if tilt is not None:
        lean = state.lean + kept[-4:]
        cos, sin = np.cos(layout.angles), np.sin(layout.angles)
        back = np.zeros_like(rotation)
        back[:, 0, 0] = back[:, 1, 1] = cos
        back[:, 0, 1], back[:, 1, 0], back[:, 2, 2] = sin, -sin, 1.0
        odd = rotation @ back
        vector = 0.5 * np.stack(
            [
                odd[:, 2, 1] - odd[:, 1, 2],
                odd[:, 0, 2] - odd[:, 2, 0],
                odd[:, 1, 0] - odd[:, 0, 1],
            ],
            axis=1,
        )
        size = np.sqrt((vector**2).sum(axis=1))
        vector = vector * (np.arcsin(size) / size)[:, None]
        x = vector[:, 0] - lean[0] - cos * lean[2] + sin * lean[3]
        y = vector[:, 1] - lean[1] - sin * lean[2] - cos * lean[3]
        total += ((x**2 + y**2) / tilt**2).sum()
    return total


@pytest.mark.parametrize("tilt", [None, 1e-5])
def test_slopes_by_complex_steps(tilt):
    rng = np.random.default_rng(1)
    rows = scene(rng, good_targets()[:8], m=3, curves=(1e-4, 1e-3)).rows
    layout, _ = lay_out(SixProblem(**rows, tilt_std=tilt))
    state, grid = find_start(layout), layout.grid
    state = replace(state, targets=state.targets + 1e-5 * rng.normal(size=state.targets.shape))
    roots = 1e-7 * rng.normal(size=(len(layout.position), 3, 3))
    roots = np.zeros_like(roots)  # with scatter the weights depend on the place: see below
    here = slopes(grid, layout, None, state)
    expected_kept, expected_poses = np.zeros(layout.size), np.zeros((3, 6))
    for index in range(layout.size + 18):
        kept, poses = np.zeros(layout.size, complex), np.zeros((3, 6), complex)
        flat = kept if index < layout.size else poses.reshape(-1)
        at = index if index < layout.size else index - layout.size
        flat[at] = 1e-20j
        slope = 0.5e20 * chi2(layout, grid, state, kept, poses, roots, tilt).imag
        (expected_kept if index < layout.size else expected_poses.reshape(-1))[at] = slope
    assert here.chi2 == pytest.approx(
        chi2(layout, grid, state, np.zeros(layout.size), np.zeros((3, 6)), roots, tilt), rel=1e-9
    )
    assert here.kept == pytest.approx(expected_kept, abs=1e-6 * np.abs(expected_kept).max())
    assert here.poses == pytest.approx(expected_poses, abs=1e-6 * np.abs(expected_poses).max())


def test_scatter_weights_lengths_like_the_dense_covariance():
    rng = np.random.default_rng(2)
    rows = scene(rng, good_targets()[:8], m=3).rows
    layout, _ = lay_out(SixProblem(**rows))
    state, grid = find_start(layout), layout.grid
    roots = 3e-7 * rng.normal(size=(len(layout.position), 3, 3))
    zero = np.zeros(layout.size), np.zeros((3, 6))
    expected = chi2(layout, grid, state, *zero, roots, None)
    assert slopes(grid, layout, roots, state).chi2 == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("tilt", [None, 1e-5])
@pytest.mark.parametrize("scattered", [False, True])
def test_normal_matrix_is_the_slope_of_the_slopes(tilt, scattered):
    rng = np.random.default_rng(3)
    rows = scene(rng, good_targets()[:8], m=4, noise=0.0, curves=(0.0, 0.0)).rows
    layout, _ = lay_out(SixProblem(**rows, tilt_std=tilt))
    state, grid = find_start(layout), layout.grid
    roots = 1e-7 * rng.normal(size=(len(layout.position), 3, 3)) if scattered else None
    network = relax(grid, layout, roots, state)
    state = network.state
    kept, poses = 1e-8 * rng.normal(size=layout.size), 1e-8 * rng.normal(size=(4, 6))
    ahead = slopes(grid, layout, roots, state.moved(kept, poses))
    behind = slopes(grid, layout, roots, state.moved(-kept, -poses))
    by_kept, by_poses = 0.5 * (ahead.kept - behind.kept), 0.5 * (ahead.poses - behind.poses)
    # N x, and back: equal to x but for what no length feels
    x, y = network.reduced.solve(by_kept, by_poses.ravel())
    assert x @ by_kept + y @ by_poses.ravel() == pytest.approx(
        kept @ by_kept + (poses * by_poses).sum(), rel=1e-5
    )
    again = slopes(grid, layout, roots, state.moved(x - kept, y.reshape(4, 6) - poses))
    assert again.chi2 - network.slopes.chi2 < 1e-6 * (ahead.chi2 - network.slopes.chi2)


def test_jacobian_of_the_curves_by_differences():
    rng = np.random.default_rng(4)
    angles = np.sort(rng.uniform(0.0, 6.0, 7))
    cos, sin = np.cos(angles), np.sin(angles)
    about = np.zeros((7, 3, 3))
    about[:, 0, 0] = about[:, 1, 1] = cos
    about[:, 1, 0], about[:, 0, 1], about[:, 2, 2] = sin, -sin, 1.0
    rotation = turn(1e-5 * rng.normal(size=(7, 3))) @ about
    shift = 1e-5 * rng.normal(size=(7, 3))
    curves = table_curves(rotation, shift, angles)
    expected = np.empty((42, 42))
    for column in range(42):
        step = np.zeros((7, 6))
        step.reshape(-1)[column] = 1e-6
        ends = [
            table_curves(turn(s * step[:, :3]) @ rotation, shift + s * step[:, 3:], angles)
            for s in (1.0, -1.0)
        ]
        moved = [np.concatenate([e.translation.ravel(), e.rotation.ravel()]) for e in ends]
        expected[:, column] = (moved[0] - moved[1]) / 2e-6
    found = curve_jacobian(curves, rotation, angles)
    assert np.abs(found - expected).max() < 1e-4  # curves of 1e-5: what is of their second order


def test_logarithm_of_a_rotation():
    rng = np.random.default_rng(5)
    vectors = rng.normal(size=(4, 3)) * np.array([[1e-9], [1e-5], [1e-2], [0.5]])
    from scipy.spatial.transform import Rotation

    matrices = Rotation.from_rotvec(vectors).as_matrix()
    assert rotation_vector(matrices) == pytest.approx(vectors, abs=1e-15)
    small = np.array([0.0, 0.0, 1e-7])
    moved = Rotation.from_rotvec(small) * Rotation.from_rotvec(vectors[2])
    change = (moved.as_rotvec() - vectors[2]) / 1e-7
    assert log_slope(vectors[2])[:, 2] == pytest.approx(change, abs=1e-6)


@pytest.mark.parametrize("scatter", [(0.0, 0.0), (2e-7, 1e-6)])
def test_the_slope_along_a_column_of_errors_is_that_of_chi_squared(scatter):
    """Of a table that scatters, too: by differences of the whole solver."""
    rows = scene(np.random.default_rng(2), good_targets()[:14], m=5).rows
    stated = {"scatter_translation_std": scatter[0], "scatter_rotation_std": scatter[1]}
    problem = SixProblem(**rows, **stated)
    along = 1e-6 * np.random.default_rng(3).standard_normal(len(rows["length"]))
    size = 1e-2

    def fall(by):
        return adjust(replace(problem, length=problem.length - by * along)).fit.chi2

    found = slope_along(adjust(problem), along)
    assert found.score == pytest.approx((fall(-size) - fall(size)) / (4.0 * size), rel=1e-4)
    curved = fall(size) + fall(-size) - 2.0 * fall(0.0)
    assert found.information == pytest.approx(curved / (2.0 * size**2), rel=1e-4)
