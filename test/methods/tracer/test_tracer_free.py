"""Free networks of weak geometry settle; targets that too few lengths reach are no bad data."""

import numpy as np
import pytest
from coded import coded

from rotcal_ros.methods.tracer.solver import TracerProblem, solve
from rotcal_ros.methods.tracer.solver.solve import TARGETS_LEFT_OUT

STD = 2e-7


def weak(seed, level=0.02):
    """Few targets, some about level with a tracer on a small circle; good lengths, STD noise.

    ``level``: how far the nearest of them are off the tracer's height, m.
    """
    rng = np.random.default_rng(seed)
    m, n = int(rng.integers(6, 10)), int(rng.integers(14, 24))
    radius = rng.uniform(0.03, 0.07)
    angles = np.linspace(0.0, rng.uniform(4.0, 6.0), m)
    stations = np.stack([radius * np.cos(angles), radius * np.sin(angles), 0 * angles], axis=1)
    around = rng.uniform(0.0, 2 * np.pi, n)
    far = rng.uniform(0.3, 0.7, n)
    height = rng.choice([level, 0.1, 0.5], n) * rng.uniform(-1.0, 1.0, n) + rng.choice([0, 0.1])
    targets = np.stack([far * np.cos(around), far * np.sin(around), height], axis=1)
    said = targets + 2e-6 * rng.standard_normal((n, 3))
    distance = np.sqrt(((stations[:, None] - targets) ** 2).sum(axis=2))
    reading = distance - distance[:, :1] + STD * rng.standard_normal((m, n))
    j, i = np.divmod(np.arange(m * n), n)
    return TracerProblem(
        position=j, target=i, length=reading.ravel(), length_std=STD, targets=said,
        target_std=2e-6, table_angles=angles, variant="joint", datum="free", error_motion_std=0.0,
    )  # fmt: skip


HARD = (0, 2, 3, 5, 42, 56, 117, 247)
"""A third of such networks ran away along the height of a target, or halved steps for ever."""


@pytest.mark.parametrize("seed", HARD)
def test_good_lengths_settle_in_a_long_bent_valley(seed):
    result = solve(weak(seed))
    assert result.verdict != "failed"
    assert result.sigma0**2 < 1.0 + 4.0 * np.sqrt(2.0 / result.dof)


@pytest.mark.parametrize("reached", [1, 3])
def test_a_target_that_few_lengths_reach_is_left_out_and_nothing_else(reached):
    problem = weak(1, level=0.4)
    keep = (problem.target != 4) | (problem.position < reached)
    rows = {
        name: getattr(problem, name)[keep]
        for name in ("position", "target", "length", "length_std")
    }
    result = solve(TracerProblem(**{**vars(problem), **rows}))
    assert result.verdict == "ok"
    assert not result.rejected
    ((targets, _),) = coded(*result.warnings)[TARGETS_LEFT_OUT]
    assert targets == "4"
    assert 4 not in result.details["target_ids"]
    at = rows["target"] == 4
    assert at.sum() == reached
    assert not result.residuals.used[at].any()
    assert result.residuals.used[~at].all()
