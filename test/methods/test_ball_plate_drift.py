"""Drift of the CMM as parameters of the fit: their cost, and what an order hides of it."""

import re
from dataclasses import replace

import numpy as np
import pytest
from chances import LONG, share
from coded import coded
from plate_data import RADIUS
from plate_disturbed import DEMO_PLATE, NOISE, ORDERS, by_pseudo_inverse, drifted, measured

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.methods.ball_plate.solver import plate_trials, solve
from rotcal_ros.methods.ball_plate.solver.result import ORIGIN_DRIFTS


@pytest.mark.parametrize("degree", [1, 2])
def test_an_estimated_drift_is_taken_off_with_its_uncertainty(degree):
    """Beside the orders, it equals the dense normal equations with its columns."""
    problem, _ = measured(
        12, list(range(12)), 4, displaced=lambda i, _: drifted(len(i), [1e-6, -2e-6, 3e-6])
    )
    result = solve(replace(problem, drift=degree, sigma=NOISE))
    dense, unit = by_pseudo_inverse(problem, degree)
    for number, name in enumerate(COMPONENTS):
        scale = 1.0 if number < 3 else RADIUS
        value = result.deviations[name] * scale  # beside products of small quantities
        np.testing.assert_allclose(value, dense[number], atol=1e-9)
        np.testing.assert_allclose(result.std[name] * scale, NOISE * unit[number], rtol=1e-6)
    (text,) = [text for text in result.warnings if ORIGIN_DRIFTS in coded(text)]
    found = np.array(re.search(r"by \((\S+) \+- \S+, (\S+) \+- \S+, (\S+)", text).groups(), float)
    np.testing.assert_allclose(found, [1.0, -2.0, 3.0], atol=0.06)


@pytest.mark.slow
def test_trials_know_an_estimated_drift():
    problem, _ = measured(12, list(range(12)), 0, drift=1)
    trials = plate_trials(problem)(np.random.default_rng(1), 60)
    spread = trials.reshape(60, 6, 12).std(axis=0).mean(axis=1)
    stated = np.array([solve(problem).std[name].mean() for name in COMPONENTS])
    np.testing.assert_allclose(spread / stated, 1.0, atol=0.08)


def test_estimated_drift_keeps_its_intervals():
    inside = total = 0
    for seed in range(15 if LONG else 5):
        problem, truth = measured(
            36, DEMO_PLATE, seed, drift=1,
            displaced=lambda i, _: drifted(len(i), [2e-6, -1e-6, 1e-6]),
        )  # fmt: skip
        found = solve(problem)
        assert found.protections[0].treatment == "estimated"
        for name in COMPONENTS:
            off = np.abs(found.deviations[name] - truth.component(name)) / found.std[name]
            inside, total = inside + np.count_nonzero(off < 1.96), total + len(off)
    low, high = (0.93, 0.97) if LONG else share(0.95, 5 * 36 // 3)
    assert low < inside / total < high


@pytest.mark.parametrize("order", ["table_once", "probe_rests"])
def test_a_drift_that_the_order_hides_is_not_estimated(order):
    problem, _ = measured(36, DEMO_PLATE, 0, ORDERS[order] | {"closing": False}, drift=1)
    with pytest.raises(ObservabilityError, match="interleaved"):
        solve(problem)


def test_a_stated_allowance_enlarges_the_uncertainty_by_what_it_does():
    order = {"order": "table_once", "closing": False}
    plain, _ = measured(36, DEMO_PLATE, 2, order)
    bounded, _ = measured(36, DEMO_PLATE, 2, order, drift_allowance=1e-6)
    disturbed, _ = measured(
        36, DEMO_PLATE, 2, order, displaced=lambda i, _: drifted(len(i), [1e-7, 1e-7, 1e-7])
    )  # a tenth, which stays unseen
    less, more, moved = solve(plain), solve(bounded), solve(disturbed)
    assert "drift" not in more.unprotected
    assert more.protections[0].treatment == "bounded"
    error = 10.0 * (moved.deviations["EZC"] - less.deviations["EZC"])
    added = more.std["EZC"] ** 2 - less.std["EZC"] ** 2
    np.testing.assert_allclose(added, error**2 / 3.0, atol=0.02 * np.max(error**2))
    for name in COMPONENTS:
        np.testing.assert_allclose(
            np.sqrt(np.diag(more.covariance[name])), more.std[name], rtol=1e-9
        )
