"""The joint solution against scipy on the same problem, every unknown explicit."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mirror_cell import measure, ring_cell

from rotcal_ros.adjust.fit import fit_model
from rotcal_ros.methods.plane_mirror.solver import TrackerNoise, solve
from rotcal_ros.methods.plane_mirror.solver.model import TrackerModel
from rotcal_ros.methods.plane_mirror.solver.set_up import lay_out_points

# One opponent for the test and for the benchmark.
sys.path.append(str(Path(__file__).parents[3] / "benchmarks"))
from scipy_plane_mirror import joint_least_squares


@pytest.fixture(scope="module")
def problem():
    angles = np.radians(np.arange(6) * 30.0)
    cell = ring_cell(angles, ((0, 1, 2), (2, 3, 4), (4, 5)), n_nests=4, reflectors=2, lean=0.06)
    deviations = np.zeros((6, 6))
    rng = np.random.default_rng(3)
    deviations[:, 3:] = rng.normal(0.0, 5e-6, (6, 3))
    return measure(cell, deviations, TrackerNoise(), rng, way="joint")


def test_deviations_and_covariance_agree_with_scipy(problem):
    """With the noise as stated, which the engine would estimate where it is contradicted."""
    tracker = TrackerModel.of(lay_out_points(problem)[0])
    model = tracker.model()
    every = np.ones(len(model.observed), dtype=bool)
    fit = fit_model(model, every, model.std, model.first)
    deviations, covariance, cost = joint_least_squares(problem)
    # second order in the noise (1e-5)^2: a direct point is reflected as it was read
    np.testing.assert_allclose(fit.value, deviations, atol=3e-10)
    own = covariance[1:, 1:]
    lean = np.tan(tracker.start.lean)
    crosstalk = (lean * problem.tilt_std) ** 2 * (np.eye(5) + 1.0)
    np.testing.assert_allclose(fit.covariance(slice(1, 6)), own + crosstalk, rtol=2e-4)
    assert fit.chi2 == pytest.approx(2.0 * cost, rel=1e-4)


def test_loose_cone_gives_the_tilts_back():
    """With a table that may tilt a lot, eps is what the simulation tilted out of the cone."""
    angles = np.radians(np.arange(12) * 30.0)
    visits = tuple(((3 * s), 3 * s + 1, 3 * s + 2, (3 * s + 3) % 12) for s in range(4))
    cell = ring_cell(angles, visits, n_nests=4)
    near = np.radians([30.0 + 15.0, 135.0, 225.0, 315.0])
    stations = tuple(
        replace(s, place=(2.0 * np.cos(a), 2.0 * np.sin(a), 0.35))
        for s, a in zip(cell.stations, near, strict=True)
    )
    deviations = np.zeros((12, 6))
    deviations[:, 3:5] = np.random.default_rng(4).normal(0.0, 2e-4, (12, 2))
    problem = measure(replace(cell, stations=stations), deviations, way="joint", tilt_std=1e-2)
    result = solve(problem)
    tilt = deviations[:, 3] * np.sin(angles) - deviations[:, 4] * np.cos(angles)
    # Mean and first harmonic of the tilts are the cone and the axis themselves.
    design = np.column_stack([np.ones(12), np.cos(angles), np.sin(angles)])
    rest = tilt - design @ np.linalg.lstsq(design, tilt, rcond=None)[0]
    np.testing.assert_allclose(result.details["tilts_rad"], rest, atol=2e-7)
