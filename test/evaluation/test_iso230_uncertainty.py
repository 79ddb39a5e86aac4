"""Uncertainties of the figures of ISO 230-2 against simulated tests of one axis."""

import json
from dataclasses import replace

import numpy as np
import pytest

from rotcal_ros.evaluation.iso230 import (
    BidirectionalRuns,
    add_device_uncertainty,
    iso230,
    require_runs,
)
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.results import RepeatedRuns, Result
from rotcal_ros.foundation.units import ARCSEC

TARGETS = np.deg2rad(np.arange(8) * 45.0)
UP = np.array([0.0, 6.0, 40.0, 5.0, -1.0, -11.0, -3.0, -1.0]) * ARCSEC
DOWN = UP - np.array([2.0, 3.0, 2.5, 2.0, 30.0, 2.0, 3.0, 1.0]) * ARCSEC
S_UP = np.array([0.2, 0.2, 0.3, 0.2, 0.2, 0.3, 0.2, 1.4]) * ARCSEC
S_DOWN = np.array([0.2, 0.3, 0.2, 0.2, 1.6, 0.2, 0.2, 0.2]) * ARCSEC
"""The largest and the smallest target stand out, so that noise never changes which they are."""
FIGURES = [
    "reversal", "mean_reversal", "repeatability", "repeatability_forward",
    "repeatability_reverse", "systematic", "systematic_forward", "systematic_reverse",
    "mean_range", "accuracy", "accuracy_forward", "accuracy_reverse",
]  # fmt: skip


def shared(rng):
    """A covariance of the device over the targets, with a first harmonic."""
    wave = np.cos(TARGETS)[:, None]
    return ARCSEC**2 * (0.3**2 * np.eye(8) + 0.5**2 * wave @ wave.T)


def true_figures():
    """The figures of the axis itself: its means and standard deviations are known."""
    means, s = np.array([UP, DOWN]), np.array([S_UP, S_DOWN])
    high, low = means + 2 * s, means - 2 * s
    repeat = np.maximum(2 * s.sum(axis=0) + np.abs(UP - DOWN), 4 * s.max(axis=0))
    return {
        "reversal": np.abs(UP - DOWN).max(),
        "mean_reversal": (UP - DOWN).mean(),
        "repeatability": repeat.max(),
        "repeatability_forward": 4 * S_UP.max(),
        "repeatability_reverse": 4 * S_DOWN.max(),
        "systematic": np.ptp(means),
        "systematic_forward": np.ptp(UP),
        "systematic_reverse": np.ptp(DOWN),
        "mean_range": np.ptp((UP + DOWN) / 2),
        "accuracy": high.max() - low.min(),
        "accuracy_forward": high[0].max() - low[0].min(),
        "accuracy_reverse": high[1].max() - low[1].min(),
    }


def simulated(rng, n=5):
    error = np.linalg.cholesky(shared(rng)) @ rng.normal(size=8)
    up, down = (
        mean[:, None] + error[:, None] + s[:, None] * rng.normal(size=(8, n))
        for mean, s in ((UP, S_UP), (DOWN, S_DOWN))
    )
    return BidirectionalRuns(TARGETS, up, down, shared(rng))


@pytest.fixture(scope="module")
def tests():
    rng = np.random.default_rng(1)
    return [iso230(simulated(rng)) for _ in range(2500)]


@pytest.mark.slow
@pytest.mark.parametrize("name", FIGURES)
def test_stated_uncertainty_is_the_scatter_of_many_tests(tests, name):
    values = np.array([getattr(t, name) for t in tests])
    stated = np.sqrt(np.mean([t.uncertainties[name].std ** 2 for t in tests]))
    assert np.std(values) == pytest.approx(stated, rel=0.05)


@pytest.mark.parametrize("name", FIGURES)
def test_coverage_of_the_expanded_uncertainty(tests, name):
    """An s of five runs is skew and small when the error is: its figures lose 2 to 4 %."""
    aim = true_figures()[name]
    inside = [abs(getattr(t, name) - aim) <= t.uncertainties[name].expanded for t in tests]
    low = 0.90 if "repeatability" in name or "accuracy" in name else 0.93
    assert low < np.mean(inside) < 0.97


def test_shared_errors_cancel_in_reversal_and_repeatability(tests):
    told = tests[0].uncertainties
    for name in ("reversal", "mean_reversal", "repeatability", "repeatability_forward"):
        assert told[name].measurement == pytest.approx(0.0, abs=1e-12 * ARCSEC)
        assert told[name].sampling > 0.0
    assert told["systematic"].measurement > 0.3 * ARCSEC


def test_in_closed_form():
    """E of both directions lies between targets 2 up and 4 down; the device cancels nowhere."""
    steps = np.array([-2.0, -1.0, 0.0, 1.0, 2.0]) / np.sqrt(2.5)
    up, down = (m[:, None] + np.outer(s, steps) for m, s in ((UP, S_UP), (DOWN, S_DOWN)))
    figures = iso230(add_device_uncertainty(BidirectionalRuns(TARGETS, up, down), 0.4 * ARCSEC))
    told = figures.uncertainties["systematic"]
    assert told.sampling / ARCSEC == pytest.approx(np.sqrt((0.3**2 + 1.6**2) / 5))
    assert told.measurement / ARCSEC == pytest.approx(0.4 * np.sqrt(2))
    assert told.std == pytest.approx(np.hypot(told.sampling, told.measurement))
    repeat = figures.uncertainties["repeatability_forward"]
    assert repeat.std / ARCSEC == pytest.approx(4 * 1.4 / np.sqrt(8))
    assert repeat.dof == pytest.approx(4.0)
    assert repeat.expanded / repeat.std == pytest.approx(2.7764, abs=1e-4)


@pytest.mark.parametrize("side", [0, 1])
def test_repeatability_that_one_direction_decides(side):
    """R = 4 s of one direction alone: the mean of no target and the other s play no part."""
    s = np.full((2, 8), 0.1 * ARCSEC)
    s[side, 3] = 2.0 * ARCSEC
    steps = np.array([-2.0, -1.0, 0.0, 1.0, 2.0]) / np.sqrt(2.5)
    up, down = (UP[:, None] + np.outer(width, steps) for width in s)
    figures = iso230(BidirectionalRuns(TARGETS, up, down))
    told = figures.uncertainties["repeatability"]
    assert figures.repeatability == pytest.approx(8.0 * ARCSEC)
    assert told.sampling == pytest.approx(4 * 2.0 * ARCSEC / np.sqrt(8))
    assert told.dof == pytest.approx(4.0)


def test_nothing_stated_is_said():
    runs = replace(simulated(np.random.default_rng(2)), common=None)
    figures = iso230(runs)
    assert not figures.measurement_stated
    assert all(u.measurement == 0.0 for u in figures.uncertainties.values())
    assert iso230(add_device_uncertainty(runs, ARCSEC)).measurement_stated
    with pytest.raises(DataError, match=r"shape \(3, 3\), expected \(8, 8\)"):
        replace(runs, common=np.eye(3))


def test_runs_without_any_scatter_have_unlimited_degrees_of_freedom():
    flat = np.repeat(UP[:, None], 5, axis=1)
    told = iso230(add_device_uncertainty(BidirectionalRuns(TARGETS, flat, flat), ARCSEC))
    data = json.loads(json.dumps(told.to_dict(), allow_nan=False))["uncertainties"]
    assert data["systematic"]["dof"] is None
    assert data["systematic"]["expanded"] == pytest.approx(1.96 * np.sqrt(2) * ARCSEC, rel=1e-3)
    assert data["repeatability"]["expanded"] < 1e-12 * ARCSEC


def test_of_a_result_only_what_all_runs_share_is_measurement():
    """The mean curve of a result holds the scatter of its runs too: it is not counted twice."""
    rng, n = np.random.default_rng(3), 5
    found = []
    for _ in range(200):
        runs = simulated(rng, n)
        runs = replace(
            runs,
            forward=UP[:, None] + 0.3 * ARCSEC * rng.normal(size=(8, n)),
            reverse=DOWN[:, None] + 0.3 * ARCSEC * rng.normal(size=(8, n)),
        )
        tied = np.eye(8)
        tied[:, 0] -= 1.0
        total = tied @ (shared(rng) + (0.3 * ARCSEC) ** 2 / (2 * n) * np.eye(8)) @ tied.T
        result = Result(
            method="m",
            angles=TARGETS,
            deviations={"ECC": UP},
            std={"ECC": np.sqrt(np.diag(total))},
            covariance={"ECC": total},
            sigma0=1.0,
            dof=1,
            n_observations=80,
            runs=RepeatedRuns(TARGETS, runs.forward, runs.reverse),
        )
        figures = iso230(require_runs(result, "x"))
        found.append(figures.uncertainties["systematic"].measurement ** 2)
    # Targets 2 up and 4 down: at 90 and 180 degrees.
    exact = shared(rng)[2, 2] + shared(rng)[4, 4] - 2 * shared(rng)[2, 4]
    assert np.mean(found) == pytest.approx(exact, rel=0.02, abs=0.0)
