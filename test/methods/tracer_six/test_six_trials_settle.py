"""A trial ends where the solver does, though its steps use the normal matrix of another."""

from dataclasses import replace

import numpy as np
import pytest

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.methods.tracer.solver import TracerLimits
from rotcal_ros.methods.tracer_six.solver import SixProblem, SixTrials, adjust, solve

ANGLES = np.radians(45.0 * np.arange(8))
KEEP_ALL = TracerLimits(
    rejection_significance=1e-12, noise_significance=1e-300, test_significance=1e-300
)
"""As if there were no rejection and no second thought about noise and scatter."""
AROUND = np.radians(120.0 * np.arange(3))
PLACES = np.column_stack([0.15 * np.cos(AROUND), 0.15 * np.sin(AROUND), [0.1, 0.1, 0.13]])


def measured(scatter=0.0, seed=0, **options):
    """Return lengths with noise; the table has no deviations but a ``scatter`` (m)."""
    rng = np.random.default_rng(seed)
    targets = rng.uniform([-0.5, -0.5, 0.2], [0.5, 0.5, 1.0], (10, 3))
    turn = ANGLES[:, None] + np.arctan2(PLACES[:, 1], PLACES[:, 0])
    radius = np.hypot(*PLACES[:, :2].T)
    height = np.broadcast_to(PLACES[:, 2], turn.shape)
    stations = np.stack([radius * np.cos(turn), radius * np.sin(turn), height], axis=-1)
    stations = stations + scatter * rng.standard_normal(stations.shape)
    seen = targets + 1e-6 * rng.standard_normal(targets.shape)
    length = np.linalg.norm(stations[:, :, None] - seen, axis=3)
    length += 2e-7 * rng.standard_normal(length.shape) - 0.3
    position, place, target = (axis.ravel() for axis in np.indices(length.shape))
    known = {"scatter_translation_std": 0.0, "scatter_rotation_std": 0.0}
    return SixProblem(
        position=position, place=place, target=target, length=length.ravel(), length_std=2e-7,
        targets=targets, target_std=1e-6, table_angles=ANGLES, places=PLACES,
        **{**known, **options},
    )  # fmt: skip


@pytest.mark.parametrize("datum", ["prior", "free"])
def test_a_trial_is_what_the_solver_finds(datum):
    """The steps with the normal matrix of the measurement end where a new solution does."""
    problem = measured(settings=KEEP_ALL, datum=datum)
    trials = SixTrials(adjust(problem))
    drawn, layout = trials._drawn(np.random.default_rng(5))
    station = np.empty(len(problem.length), dtype=int)
    station[trials.network.grid.row.ravel()] = np.repeat(np.arange(24), 10)
    length = drawn.length[station, problem.target]
    answer = solve(replace(problem, length=length, targets=drawn.targets))
    found = trials._solved(drawn, layout).reshape(6, 8)
    for at, name in enumerate(COMPONENTS):
        np.testing.assert_allclose(
            found[at], answer.deviations[name], atol=1e-12 if datum == "prior" else 1e-10
        )
