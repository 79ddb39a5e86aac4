"""Undamped steps against scipy's Levenberg-Marquardt, and what happens where they do not help."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from rotcal_ros.methods.tracer.solver.station_by_station import (
    locate_by_contraction,
    locate_damped,
    locate_stations,
)

EXACT = {"method": "lm", "xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}


def scene(seed=0, m=11, n=64):
    """Return stations (m, 4), targets, lengths and weights with gaps and unequal noise."""
    rng = np.random.default_rng(seed)
    angles = np.linspace(0.0, 5.5, m)
    stations = np.column_stack([0.065 * np.cos(angles), 0.065 * np.sin(angles), 0.12 + 0 * angles])
    truth = np.column_stack([stations, rng.uniform(0.3, 0.6, m)])
    targets = rng.uniform([-0.225, -0.3, 0.5], [0.225, 0.3, 0.95], size=(n, 3))
    distance = np.linalg.norm(stations[:, None] - targets, axis=2)
    length = distance - truth[:, 3:] + 2e-7 * rng.normal(size=(m, n))
    weights = (rng.random((m, n)) < 0.9) / rng.uniform(1e-7, 1e-6, (m, n)) ** 2
    return truth, targets, length, weights


def by_scipy(targets, length, weights, start):
    root = np.sqrt(weights / weights.max())

    def misfit(p):
        return root * (np.linalg.norm(p[:3] - targets, axis=1) - p[3] - length)

    def slope(p):
        away = p[:3] - targets
        unit = away / np.linalg.norm(away, axis=1)[:, None]
        return root[:, None] * np.column_stack([unit, -np.ones(len(targets))])

    return least_squares(misfit, start, slope, **EXACT).x


def started(truth, spread, seed=1):
    return truth + spread * np.random.default_rng(seed).normal(size=truth.shape)


def test_the_answer_is_that_of_scipy():
    truth, targets, length, weights = scene()
    start = started(truth, 0.05)
    found, contracts = locate_by_contraction(targets, length, weights, start)
    assert contracts.all()
    expected = [by_scipy(targets, *row) for row in zip(length, weights, start, strict=True)]
    assert found == pytest.approx(np.array(expected), abs=1e-12)
    assert found == pytest.approx(locate_damped(targets, length, weights, start)[0], abs=1e-12)


@pytest.mark.parametrize(
    ("spread", "least", "most"), [(0.1, 0.0, 0.05), (0.5, 0.1, 0.9), (2, 0.9, 1)]
)
def test_from_afar_some_fall_back_and_none_is_wrong(spread, least, most):
    truth, targets, length, weights = scene()
    minimum = locate_damped(targets, length, weights, truth)[0]
    fallen = 0
    for seed in range(20):
        start = started(truth, 0.5 * spread, seed)
        found, contracts = locate_by_contraction(targets, length, weights, start)
        assert found[contracts] == pytest.approx(minimum[contracts], abs=1e-12)
        fallen += int((~contracts).sum())
        again, settled = locate_stations(targets, length, weights, start)
        assert settled.all()
        if not (rest := ~contracts).any():
            continue
        damped = locate_damped(targets, length[rest], weights[rest], start[rest])[0]
        assert np.array_equal(again[rest], damped)
    assert least <= fallen / (20 * len(truth)) <= most


def test_a_minimum_stays_where_it_is():
    truth, targets, length, weights = scene()
    minimum = locate_by_contraction(targets, length, weights, truth)[0]
    again, contracts = locate_by_contraction(targets, length, weights, minimum)
    assert contracts.all()
    assert again == pytest.approx(minimum, abs=1e-14)


def test_a_station_that_the_targets_leave_open_is_not_called_found():
    truth, targets, length, weights = scene()
    targets[:, 2] = truth[0, 2]  # level with the stations: no length feels their height
    length = np.linalg.norm(truth[:, None, :3] - targets, axis=2) - truth[:, 3:]
    start = started(truth, 0.01)
    start[:, 2] = truth[:, 2]
    assert not locate_by_contraction(targets, length, weights, start)[1].any()
