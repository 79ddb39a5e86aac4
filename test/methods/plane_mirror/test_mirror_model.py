"""The equations of the model: their derivatives, and what noise is made of."""

import numpy as np
import pytest
from drifting_tracker import campaign
from mirror_scene import measured, only

from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.methods.plane_mirror.solver import TrackerNoise
from rotcal_ros.methods.plane_mirror.solver import model as models
from rotcal_ros.methods.plane_mirror.solver.model import TrackerModel
from rotcal_ros.methods.plane_mirror.solver.set_up import lay_out_points


def tracker_of(problem):
    return TrackerModel.of(lay_out_points(problem)[0])


def drifting(way="joint", **settings):
    found = campaign()
    return found.problem(found.noisy(np.random.default_rng(1), 1)[0], way=way, **settings)


def without_nests(problem):
    """Five of six nests are gone at every station: nothing joins these but positions."""
    kept = (problem.kind != PointKind.NEST) | (problem.nest == problem.nest[0])
    return only(problem, kept)


@pytest.mark.parametrize(
    "problem",
    [
        measured("joint", reflectors=2),
        measured("direct"),
        drifting(),
        without_nests(drifting("stitching")),
    ],
    ids=["mirror", "reflectors", "drift", "without nests"],
)
@pytest.mark.parametrize("sparse", [0, 10_000])
def test_derivatives_are_those_of_the_conditions(problem, sparse, monkeypatch):
    monkeypatch.setattr(models, "SPARSE", sparse)
    tracker = tracker_of(problem)
    size = sum(tracker.blocks.values())
    x = 1e-5 * np.random.default_rng(2).standard_normal(size)
    design = tracker.equations(x)[1]
    design = design if isinstance(design, np.ndarray) else design.toarray()
    step = 1e-6 * np.eye(size)
    found = [(tracker.equations(x + h)[0] - tracker.equations(x - h)[0]) / 2e-6 for h in step]
    np.testing.assert_allclose(design, np.transpose(found), atol=3e-4)


def test_exact_points_leave_nothing_at_the_start():
    tracker = tracker_of(measured("joint", reflectors=2))
    truth = np.random.default_rng(5).normal(0.0, np.radians(5.0 / 3600.0), 17)
    x = np.zeros(sum(tracker.blocks.values()))
    x[:17] = truth - np.angle(np.exp(1j * truth).mean())
    assert np.abs(tracker.equations(x)[0]).max() < 1e-9


def test_images_move_as_a_glass_that_turns_about_the_spot_moves_them():
    problem = measured("joint")
    tracker = tracker_of(problem)
    pairs = tracker.layout.pairs
    for k in (0, 9, 20):
        near, far = problem.xyz[pairs.direct[k]], problem.xyz[pairs.mirrored[k]]
        normal = (near - far) / np.linalg.norm(near - far)
        spot = far * (0.5 * (near + far) @ normal) / (far @ normal)
        for change in np.linalg.svd(normal[None])[2][1:]:
            ahead, behind = (
                near - 2.0 * ((near - spot) @ n) * n
                for n in (normal + 1e-6 * change, normal - 1e-6 * change)
            )
            moved = (ahead - behind) / 2e-6
            np.testing.assert_allclose(tracker.by_slope[k] @ change, moved, atol=1e-8)


def test_rows_have_the_covariance_of_their_points():
    """A mirrored point as it is, a direct one reflected; three rows of each element are white."""
    problem = measured("joint", reflectors=2)
    tracker, rng = tracker_of(problem), np.random.default_rng(4)
    factor = np.linalg.cholesky(problem.noise.covariance(problem.xyz))
    drawn = np.einsum("nij,tnj->nit", factor, rng.standard_normal((4000, *problem.xyz.shape)))
    rows = tracker.root @ tracker.carried(drawn) / tracker.std[:, :, None]
    spread = np.einsum("mit,mjt->ij", rows, rows) / (rows.shape[0] * rows.shape[2])
    np.testing.assert_allclose(spread, np.eye(3), atol=0.01)


def test_noise_ellipsoid_grows_along_and_across_the_beam():
    noise = TrackerNoise(1e-6, 2e-6, 3e-6, 4e-6)
    covariance = noise.covariance(np.array([0.0, 3.0, 4.0]))
    beam = np.array([0.0, 0.6, 0.8])
    assert beam @ covariance @ beam == pytest.approx((1e-6 + 5 * 2e-6) ** 2)
    for side in (np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.8, -0.6])):
        assert side @ covariance @ side == pytest.approx((3e-6 + 5 * 4e-6) ** 2)
        assert side @ covariance @ beam == pytest.approx(0.0, abs=1e-25)
