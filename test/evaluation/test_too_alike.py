"""Results that agree too well: what is the same is named, and what is independent is not accused.

Where scatter or error motion is estimated, U is wider than noise alone makes it, and independent
results of a table that has none of it agree better than their U says.
"""

from dataclasses import replace

import numpy as np
import pytest
from chances import LONG

from rotcal_ros.evaluation.combination import CombinationInput
from rotcal_ros.evaluation.compare import compare
from rotcal_ros.evaluation.joint import combine
from rotcal_ros.foundation.curves.measured import measured_curve
from rotcal_ros.methods.ball_plate.solver import BallPlateProblem
from rotcal_ros.methods.ball_plate.solver import solve as solve_plate
from rotcal_ros.methods.tracer import solver as tracer
from rotcal_ros.methods.tracer_six.solver import SixProblem
from rotcal_ros.methods.tracer_six.solver import solve as solve_six

ANGLES = 2 * np.pi * np.arange(14) / 14
AROUND = 2 * np.pi * np.arange(3) / 3


def six(seed, rounded=None):
    rng = np.random.default_rng(seed)
    places = np.column_stack([0.15 * np.cos(AROUND), 0.15 * np.sin(AROUND), np.zeros(3)])
    said = rng.uniform([-0.6, -0.5, 0.2], [0.6, 0.5, 1.0], (16, 3))
    true = said + 1e-6 * rng.standard_normal(said.shape)
    c, s = np.cos(ANGLES)[:, None], np.sin(ANGLES)[:, None]
    x, y, z = places.T
    stations = np.stack([c * x - s * y, s * x + c * y, z + 0.0 * c], axis=2)  # (14, 3, 3)
    length = np.linalg.norm(true - stations[:, :, None], axis=3) - 0.4
    length += 2e-7 * rng.standard_normal(length.shape)
    if rounded:
        length = np.round(length / rounded) * rounded
    position, place, target = (k.ravel() for k in np.indices(length.shape))
    return solve_six(
        SixProblem(
            position=position, place=place, target=target, length=length.ravel(),
            length_std=2e-7, targets=said, target_std=1e-6, table_angles=ANGLES, places=places,
        )
    )  # fmt: skip


def one_place(seed, rounded=None):
    rng = np.random.default_rng(seed)
    turn, far = rng.uniform(0, 2 * np.pi, 24), rng.uniform(0.35, 0.8, 24)
    said = np.column_stack([far * np.cos(turn), far * np.sin(turn), rng.uniform(0.1, 0.6, 24)])
    true = said + 1e-6 * rng.standard_normal(said.shape)
    stations = np.column_stack([0.07 * np.cos(ANGLES), 0.07 * np.sin(ANGLES), np.full(14, 0.15)])
    length = np.linalg.norm(true - stations[:, None], axis=2) - 0.4
    length += 2e-7 * rng.standard_normal(length.shape)
    if rounded:
        length = np.round(length / rounded) * rounded
    j, i = np.divmod(np.arange(length.size), 24)
    return tracer.solve(
        tracer.TracerProblem(
            position=j, target=i, length=length.ravel(), length_std=2e-7, targets=said,
            target_std=1e-6, table_angles=ANGLES,
        )
    )  # fmt: skip


def together(*results):
    return combine([CombinationInput.of(str(k), r) for k, r in enumerate(results)]).result


def accused(found):
    return any("agree better than" in text for text in found)


@pytest.mark.slow
@pytest.mark.parametrize(("measure", "pairs"), [(six, 16 if LONG else 6), (one_place, 16)])
def test_independent_results_with_an_estimated_scatter_are_not_too_alike(measure, pairs):
    """1 % of them by chance, four groups of components together. It was 30 and 5 %."""
    combined = compared = 0
    for seed in range(pairs):
        results = measure(2 * seed), measure(2 * seed + 1)
        combined += accused(together(*results).warnings)
        compared += accused(compare(*map(measured_curve, results)).notes)
    assert combined <= 1
    assert compared <= 1


@pytest.mark.parametrize("measure", [six, one_place])
def test_the_same_lengths_with_fewer_digits_are(measure):
    """Only that they agree shows that they are the same."""
    for seed in (1, 2):
        results = measure(seed), measure(seed, rounded=1e-8)
        found = together(*results)
        assert found.verdict == "suspect"
        assert accused(found.warnings)
        assert accused(compare(*map(measured_curve, results)).notes)


def plate(seed, stated):
    """Six balls on a 30 degree grid, 30 nm of noise: a plate and a CMM of its own each time."""
    rng = np.random.default_rng(seed)
    position, ball = (k.ravel() for k in np.meshgrid(range(12), [0, 1, 3, 4, 7, 9], indexing="ij"))
    angle = np.pi / 6.0 * (position + ball)
    made, cmm = rng.normal(0.0, 2e-6, (12, 3)), rng.normal(0.0, 1e-6, (12, 3))
    c, s = np.cos(np.pi / 6.0 * position), np.sin(np.pi / 6.0 * position)
    x, y, z = made[ball].T
    centres = 0.2 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    centres += np.column_stack([c * x - s * y, s * x + c * y, z]) + cmm[(position + ball) % 12]
    centres += rng.normal(0.0, 3e-8, centres.shape)
    return solve_plate(BallPlateProblem(12, 0.2, position, ball, centres, sigma=stated))


@pytest.mark.parametrize("times", [2.0, 3.0])
def test_noise_that_is_stated_with_care_accuses_nobody(times):
    """Each result says that it finds less noise; together they were suspect, all of them."""
    results = [plate(seed, times * 3e-8) for seed in range(12)]
    assert all(r.verdict == "ok" and r.sigma0 < 0.7 for r in results)
    pairs = list(zip(results[::2], results[1::2], strict=True))
    assert sum(accused(together(*pair).warnings) for pair in pairs) <= 1
    assert sum(accused(compare(*map(measured_curve, pair)).notes) for pair in pairs) <= 1


def test_the_same_centres_with_fewer_digits_are_accused_all_the_same():
    result = plate(1, 9e-8)
    hidden = replace(result, raw_data=replace(result.raw_data, hashes=()))
    assert accused(compare(measured_curve(result), measured_curve(hidden)).notes)
