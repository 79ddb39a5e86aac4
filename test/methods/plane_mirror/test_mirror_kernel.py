"""The joint kernel, which eliminates positions and nests, against the engine's dense reference.

The same equations are written down plainly: planes of the mirror in the frames of the stations,
nests in the common one, every unknown explicit, derivatives by differences.
"""

import numpy as np
import pytest
from mirror_scene import measured

from rotcal_ros.adjust.fit import fitted
from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.model import Model
from rotcal_ros.geometry.rotations import rotation_from_vector
from rotcal_ros.methods.plane_mirror.solver import joint
from rotcal_ros.methods.plane_mirror.solver.linear import linear
from rotcal_ros.methods.plane_mirror.solver.prepare import prepare

STEP = 1e-3


@pytest.fixture(scope="module")
def prepared():
    return prepare(measured("joint", rng=np.random.default_rng(4), reflectors=2)).prepared


@pytest.fixture(scope="module")
def dense(prepared):
    """Unknowns count from the kernel's solution; the iteration begins a millimetre beside it."""
    residual, blocks = equations_of(prepared)
    n, size = len(prepared.angles), sum(blocks.values())
    start = 1e-3 * np.random.default_rng(7).standard_normal(size)

    def equations(x):
        steps = STEP * np.eye(size)
        near, far = (
            np.array([residual(x + k * step) - residual(x - k * step) for step in steps])
            for k in (1, 2)
        )
        return -residual(x), -((8.0 * near - far) / (12.0 * STEP)).T

    outputs = np.eye(n, size)
    outputs[:, 0] -= 1.0
    rows = len(residual(start))
    words = Words("rows", "nothing", "anywhere", "in it")
    model = Model(blocks, np.zeros(rows), np.ones(rows), equations, outputs, words, start=start)
    return fitted(model, np.ones(rows, dtype=bool), model.std, start)


def equations_of(prepared):
    """Whitened observed - computed as a function of the unknowns, and the blocks of these."""
    problem, mirror, pairs, nests = (
        prepared.problem, prepared.mirror, prepared.pairs, prepared.nests
    )  # fmt: skip
    planes, n = prepared.normals(problem.xyz), len(prepared.angles)
    stations = len(mirror.poses.rotation)
    blocks = {"psi": n, "eps": n, "distance": n, "lean of the axis": 2, "beta": 1}
    blocks |= {"station": 6 * (stations - 1), "nest": 3 * nests.n_points}
    places = mirror.poses.placed(problem.xyz[nests.row], nests.station)[nests.start]

    def unpacked(x):
        psi, eps, d, lean, beta, pose, nest = np.split(x, np.cumsum([*blocks.values()])[:-1])
        pose = np.concatenate([np.zeros((1, 6)), pose.reshape(-1, 6)])
        frame = mirror.frame @ rotation_from_vector([-lean[1], lean[0], 0.0])
        psi, up = mirror.psi + psi, mirror.beta + beta + mirror.eps + eps
        own = [np.cos(up) * np.cos(psi), np.cos(up) * np.sin(psi), np.sin(up)]
        return (
            np.column_stack(own) @ frame.T,
            mirror.eps + eps,
            mirror.distance + d,
            rotation_from_vector(pose[:, :3]) @ mirror.poses.rotation,
            mirror.poses.translation + pose[:, 3:],
            places + nest.reshape(-1, 3),
        )

    # Directions across the normals, and weights, are those at the kernel's solution.
    normal, _, _, rotation, _, _ = unpacked(np.zeros(sum(blocks.values())))
    t = np.cross(mirror.frame[:, 2], normal)
    t /= np.linalg.norm(t, axis=1)[:, None]
    turn = rotation[pairs.station]
    across = np.stack([t, np.cross(normal, t)], axis=1)[pairs.position] @ turn  # (G, 2, 3)
    changes = np.zeros((pairs.n_groups, 4, 3))
    changes[:, :3, :2], changes[:, 3, 2] = np.swapaxes(across, 1, 2), 1.0
    information = np.swapaxes(changes, 1, 2) @ planes.information @ changes
    of_planes = np.linalg.cholesky(information).swapaxes(1, 2)
    turn = rotation[nests.station]
    weight = turn @ problem.noise.weight(problem.xyz[nests.row]) @ np.swapaxes(turn, 1, 2)
    of_nests = np.linalg.cholesky(weight).swapaxes(1, 2)

    def residual(x):
        normal, eps, distance, rotation, tracker, nest = unpacked(x)
        here, head = normal[pairs.position], tracker[pairs.station]
        seen = np.einsum("gji,gj->gi", rotation[pairs.station], here)
        turned = np.einsum("gki,gi->gk", across, planes.normal - seen)
        offset = planes.offset - distance[pairs.position] + (here * head).sum(axis=1)
        off = np.einsum("qij,qj->qi", rotation[nests.station], problem.xyz[nests.row])
        off = off + tracker[nests.station] - nest[nests.point]
        return np.concatenate([
            np.einsum("gij,gj->gi", of_planes, np.column_stack([turned, offset])).ravel(),
            np.einsum("qij,qj->qi", of_nests, off).ravel(),
            -eps / problem.tilt_std,
        ])  # fmt: skip

    return residual, blocks


def kernel(prepared):
    """The kernel's equations at its solution."""
    xyz = prepared.problem.xyz
    return joint.joint_equations(
        xyz, prepared.normals(xyz), prepared.adjusted_together, prepared.mirror
    )


def test_the_solution_is_the_dense_one(prepared, dense):
    assert np.abs(dense.value).max() < 1e-9 * np.ptp(prepared.deviations(prepared.problem.xyz))
    assert kernel(prepared).chi_square == pytest.approx(dense.chi2, rel=1e-9)


def test_the_covariance_is_the_dense_one(prepared, dense):
    contrast = np.eye(len(prepared.angles))
    contrast[:, 0] -= 1.0
    covariance = contrast @ joint.angle_covariance(kernel(prepared)) @ contrast.T
    expected = dense.response @ dense.response.T
    np.testing.assert_allclose(covariance, expected, atol=1e-9 * expected.max())


def test_the_redundancy_is_the_dense_one(prepared, dense):
    """Of each nest by the linear view, and of everything by the degrees of freedom."""
    view = linear(prepared, prepared.deviations(prepared.problem.xyz))
    nests = np.arange(view.elements.pairs, len(view.elements.row))
    rows = view.design[nests]
    share = 3.0 - np.einsum("qip,pr,qir->q", rows, view.view.covariance, rows)
    first = 3 * prepared.pairs.n_groups
    expected = dense.redundancy[first : first + 3 * len(nests)].reshape(-1, 3).sum(axis=1)
    np.testing.assert_allclose(share, expected, rtol=1e-9)
    within = 3 * (view.elements.pairs - prepared.pairs.n_groups)
    assert view.dof == dense.dof + within
