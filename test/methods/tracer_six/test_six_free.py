"""Targets without a prior: frames and flex stay open, the curves do not feel them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from six_scene import good_targets, on_circle, scene

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.methods.tracer_six.solver import SixProblem, adjust, solve

KNOWN = {"scatter_translation_std": 0.0, "scatter_rotation_std": 0.0}


def free(rng, places, **options):
    options = {"mounted": 0.0, "curves": (0.0, 0.0), **options}
    rows = scene(rng, good_targets()[:16], places, m=5, **options).rows
    return SixProblem(**rows, **KNOWN, datum="free")


@pytest.mark.parametrize(("heights", "open_"), [(0.0, 13), ([0.0, 0.03, 0.07], 12)])
def test_open_directions_are_those_of_the_dense_jacobian(heights, open_):
    problem = free(np.random.default_rng(1), on_circle(heights=heights), noise=0.0)
    n, p, m = len(problem.targets), 3, 5
    position, place = (axis.ravel() for axis in np.indices((m, p)))
    turned = Rotation.from_euler("z", problem.table_angles[position][:, None])
    arms = turned.apply(problem.places[place])
    unit = arms[:, None] - problem.targets
    unit /= np.linalg.norm(unit, axis=2)[:, :, None]
    jacobian = np.zeros((len(arms), n, 3 * n + 3 * p + 3 + 6 * m))
    for v, (i, k, arm) in enumerate(zip(position, place, arms, strict=True)):
        for t in range(n):
            u = unit[v, t]
            row = jacobian[v, t]
            row[3 * t : 3 * t + 3] = -u
            row[3 * n + 3 * k : 3 * n + 3 * k + 3] = turned[v].inv().apply(u)
            row[3 * n + 3 * p + k] = -1.0
            row[3 * n + 3 * p + 3 + 6 * i :][:6] = np.concatenate([np.cross(arm, u), u])
    jacobian = jacobian.reshape(-1, jacobian.shape[2])
    values = np.linalg.svd(jacobian, compute_uv=False)
    assert (values < 1e-9 * values[0]).sum() == open_
    assert adjust(problem).found.fit.kernel.rank == jacobian.shape[1] - open_


def test_flex_does_not_touch_the_curves():
    rng = np.random.default_rng(2)
    problem = free(rng, on_circle(), curves=(2e-6, 1e-5))
    first = solve(problem).deviations
    # the same lengths with targets bent and places shrunk to match: another place of the valley
    x, y, z = problem.targets.T
    bend = 1e-5 * np.column_stack([x, y, -(x**2 + y**2 - 0.15**2) / z])
    second = solve(replace(problem, targets=problem.targets + bend)).deviations
    for name in COMPONENTS:
        # what is left is the product of bend and curve
        assert second[name] == pytest.approx(first[name], abs=2e-9)


def test_moving_the_whole_machine_moves_no_curve():
    rng = np.random.default_rng(3)
    problem = free(rng, on_circle(heights=[0.0, 0.03, 0.07]), curves=(2e-6, 1e-5))
    first = solve(problem).deviations
    moved = problem.targets + np.array([2e-4, -1e-4, 0.0])
    second = solve(replace(problem, targets=moved)).deviations
    for name in COMPONENTS:
        assert second[name] == pytest.approx(first[name], abs=1e-10)
