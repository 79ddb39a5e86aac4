"""Six deviations from 864 lengths against scipy's sparse least squares, side by side.

``rows()`` yields one measurement each. Both sides run alternately; the best time of each counts.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

from collections.abc import Iterator

import numpy as np
from racing import Row, race
from scipy_tracer_six import SparseSix
from six_scene import LENGTH_STD, TARGET_STD, scene

from rotcal_ros.adjust.fit import fit_model
from rotcal_ros.methods.tracer_six.solver import SixProblem
from rotcal_ros.methods.tracer_six.solver.poses import find_start, rotation_vector
from rotcal_ros.methods.tracer_six.solver.problem import lay_out
from rotcal_ros.methods.tracer_six.solver.solve import lengths_of, model_of

FORCING = {"tr_options": {"atol": 1e-14, "btol": 1e-14, "maxiter": 2000}}
"""With its own tolerance lsmr stops early, and least_squares takes four times as long."""


def joint() -> Row:
    """24 targets, 12 angles, 3 places; both from the same start. The answers are stations."""
    known = {"scatter_translation_std": 0.0, "scatter_rotation_std": 0.0}
    problem = SixProblem(**scene(np.random.default_rng(1)).rows, **known)
    layout, _ = lay_out(problem)
    start = find_start(problem, layout)
    scipy = SparseSix(
        problem.position, problem.place, problem.target, problem.place, problem.length,
        LENGTH_STD, problem.targets, TARGET_STD, problem.table_angles, 3,
    )  # fmt: skip
    unmoved = np.zeros(scipy.sizes[-1])
    unmoved = scipy._turned(unmoved[: 3 * len(layout.angles)].reshape(-1, 3))
    turns = rotation_vector(start.rotation @ unmoved.swapaxes(1, 2))
    parts = (turns, start.translation, start.places, start.zeros, problem.targets)
    flat = np.concatenate([part.ravel() for part in parts])

    def ours() -> np.ndarray:
        lengths = lengths_of(problem, layout, start)
        model = model_of(problem, layout, lengths)
        fit = fit_model(model, np.ones(model.size[0], dtype=np.bool_), model.std, model.first)
        return lengths.stands(fit.x)[0][np.unique(lengths.station, return_index=True)[1]]

    def opponent() -> np.ndarray:
        c, d, q, _, _ = scipy.split(scipy.solve(flat, **FORCING).x)
        turned = scipy._turned(c)[layout.position]
        return (turned @ q[layout.place][:, :, None])[:, :, 0] + d[layout.position]

    a, b, difference = race(ours, opponent, (60, 10))
    return Row("six deviations 24 x 12 x 3", a, b, b / a, difference)


def rows() -> Iterator[Row]:
    """Yield all measurements."""
    yield joint()
