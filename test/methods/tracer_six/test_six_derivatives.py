"""Derivatives against complex steps and differences."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from six_scene import good_targets, on_circle, scene

from rotcal_ros.methods.tracer_six.solver import SixProblem
from rotcal_ros.methods.tracer_six.solver.poses import find_start, rotation_vector, table_curves
from rotcal_ros.methods.tracer_six.solver.problem import lay_out
from rotcal_ros.methods.tracer_six.solver.solve import lengths_of, model_of


def turn(vectors):
    """Rotation matrices of small complex vectors, by the series of the exponential."""
    k = np.zeros((*vectors.shape, 3), dtype=vectors.dtype)
    k[..., 2, 1], k[..., 0, 2], k[..., 1, 0] = np.moveaxis(vectors, -1, 0)
    k = k - np.swapaxes(k, -1, -2)
    return np.eye(3) + k + k @ k / 2.0 + k @ k @ k / 6.0


def computed(lengths, x):
    """Lengths once more, by the formula of the module's docstring, for complex steps."""
    m, p, n = len(lengths.angles), len(lengths.places), len(lengths.targets)
    sizes = list(lengths.blocks.values())
    shift, turned, place, zero, target, *rest = np.split(x, np.cumsum(sizes)[:-1])
    ways = np.eye(3 * n) if lengths.target_ways is None else lengths.target_ways
    places = lengths.places + (lengths.place_ways @ place).reshape(p, 3)
    targets = lengths.targets + (ways @ target).reshape(n, 3)
    cos, sin = np.cos(lengths.angles), np.sin(lengths.angles)
    x, y, z = places[lengths.place].T
    cos, sin = cos[lengths.position], sin[lengths.position]
    arm = np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=1)
    arm = np.einsum("kij,kj->ki", turn(turned.reshape(m, 3))[lengths.position], arm)
    stands = lengths.origin + (shift.reshape(m, 3)[lengths.position] + arm) @ lengths.axes.T
    stands = stands + rest[-1].reshape(-1, 3)[lengths.station]
    away = stands - targets[lengths.target]
    return np.sqrt((away**2).sum(axis=1)) - (lengths.zeros + zero)[lengths.zero]


@pytest.mark.parametrize("datum", ["prior", "free"])
@pytest.mark.parametrize("places", [2, 3])
def test_derivatives_by_complex_steps(datum, places):
    rng = np.random.default_rng(1)
    made = scene(rng, good_targets()[:8], on_circle(places), m=4, curves=(1e-4, 1e-4))
    problem = SixProblem(**made.rows, tilt_std=1e-5, datum=datum)
    layout, _ = lay_out(problem)
    lengths = lengths_of(problem, layout, find_start(problem, layout))
    x = lengths.start + 1e-5 * rng.normal(size=len(lengths.start))
    found, design = lengths.computed(x)
    assert found == pytest.approx(computed(lengths, x), abs=1e-15)
    for column in range(len(x)):
        step = x.astype(complex)
        step[column] += 1e-20j
        expected = 1e20 * computed(lengths, step).imag
        assert design[:, [column]].toarray()[:, 0] == pytest.approx(expected, abs=1e-8)


def test_outputs_are_the_derivatives_of_the_curves():
    rng = np.random.default_rng(4)
    angles = np.sort(rng.uniform(0.0, 6.0, 7))
    problem = SixProblem(**scene(rng, good_targets()[:8], m=7, angles=angles).rows)
    layout, _ = lay_out(problem)
    lengths = lengths_of(problem, layout, find_start(problem, layout))
    model = model_of(problem, layout, lengths)
    cos, sin = np.cos(angles), np.sin(angles)
    about = np.zeros((7, 3, 3))
    about[:, 0, 0] = about[:, 1, 1] = cos
    about[:, 1, 0], about[:, 0, 1], about[:, 2, 2] = sin, -sin, 1.0
    for column in range(42):
        step = np.zeros((2, 7, 3))
        step.reshape(-1)[column] = 1e-6
        ends = [table_curves(turn(s * step[1]) @ about, s * step[0], angles) for s in (1.0, -1.0)]
        moved = [np.concatenate([e.translation.T, e.rotation.T]).ravel() for e in ends]
        expected = (moved[0] - moved[1]) / 2e-6
        assert np.asarray(model.outputs)[:, column] == pytest.approx(expected, abs=1e-5)


def test_logarithm_of_a_rotation():
    rng = np.random.default_rng(5)
    vectors = rng.normal(size=(4, 3)) * np.array([[1e-9], [1e-5], [1e-2], [0.5]])
    matrices = Rotation.from_rotvec(vectors).as_matrix()
    assert rotation_vector(matrices) == pytest.approx(vectors, abs=1e-15)
