"""Histories that are unlike the usual one: what is said of them is true, or says why it is not."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_park import BEGIN_NS, YEAR_NS, basis, result

from rotcal_history.database import ParkHistory
from rotcal_history.outlook import all_outlooks
from rotcal_history.settings import HistorySettings
from rotcal_ros.foundation.units import ARCSEC

YEARS = np.linspace(0.0, 5.0, 8)
CIRCLE = np.arange(24) * 2.0 * np.pi / 24
STD = 0.3


def noisy(year, rng, angles=CIRCLE, size=1.0, **more):
    """Return a result at these angles of a table that deviates by ``size`` arcsec times cos."""
    n = len(angles)
    plain = result("X", BEGIN_NS + round(year * YEAR_NS), np.zeros(24), STD, **more)
    deviation = (size * np.cos(angles) + STD * rng.standard_normal(n)) * ARCSEC
    return replace(
        plain, angles=angles, deviations={"ECC": deviation},
        std={"ECC": np.full(n, STD * ARCSEC)}, covariance={"ECC": np.eye(n) * (STD * ARCSEC) ** 2},
    )  # fmt: skip


def outlook_of(tmp_path, results):
    """Return what the park says of the one table."""
    with ParkHistory(str(tmp_path / "history.db")) as history:
        for each in results:
            history.add_result(each)
        (view,) = all_outlooks(history, HistorySettings())
    return view


def test_results_of_the_same_moment_tell_no_drift(tmp_path):
    rng = np.random.default_rng(1)
    view = outlook_of(tmp_path, [noisy(0.0, rng) for _ in range(4)])
    (curve,) = view.deviations
    assert (curve.rate, curve.due_ns) == (None, None)
    assert view.due == "2022-01-01"
    assert "as agreed (fewer than 3 results)" in view.reason


def test_results_of_another_arc_are_not_compared(tmp_path):
    rng = np.random.default_rng(2)
    arcs = [np.linspace(0.0, np.pi / (1 + i % 2), 13) for i in range(8)]
    view = outlook_of(tmp_path, [noisy(y, rng, a) for y, a in zip(YEARS, arcs, strict=True)])
    (curve,) = view.deviations
    assert len(curve.times_ns) == 4
    assert curve.notes == ("4 of 8 results of ECC: too few angles, or another arc",)


def test_the_newest_result_counts_with_however_few_angles(tmp_path):
    rng = np.random.default_rng(3)
    before = [noisy(year, rng) for year in YEARS[:-1]]
    coarse = noisy(5.0, rng, np.arange(5) * 2.0 * np.pi / 5, size=9.5)
    view = outlook_of(tmp_path, [*before, coarse])
    (curve,) = view.deviations
    assert curve.times_ns[-1] == view.last_ns
    assert "beyond" in {found.kind for found in view.urgent}


def test_of_a_curve_with_few_parameters_the_drift_is_found(tmp_path):
    """Its covariance has rank 4: nothing was free beyond the second order."""
    rng, modes = np.random.default_rng(4), basis()[:, :4]
    spread = np.full(4, 0.1 * ARCSEC)
    covariance = modes @ np.diag(spread**2) @ modes.T
    results = []
    for year in YEARS:
        truth = np.array([1.0 + 0.3 * year, 0.0, 0.0, 0.0]) * ARCSEC
        curve = modes @ (truth + spread * rng.standard_normal(4))
        std = np.sqrt(np.diag(covariance))
        each = replace(noisy(year, rng), deviations={"ECC": curve}, std={"ECC": std})
        results.append(replace(each, covariance={"ECC": covariance}))
    (curve,) = outlook_of(tmp_path, results).deviations
    assert curve.moved
    at = np.cos(curve.angle)
    assert curve.rate / ARCSEC == pytest.approx(0.3 * at, abs=0.15)


def test_what_cannot_be_compared_is_no_missing_tolerance(tmp_path):
    rng = np.random.default_rng(5)
    exact = [replace(noisy(y, rng), covariance={"ECC": np.zeros((24, 24))}) for y in YEARS]
    exact = [replace(each, std={"ECC": np.zeros(24)}) for each in exact]
    reason = outlook_of(tmp_path, exact).reason
    assert "as agreed (no curves that can be compared)" in reason


def test_measurements_before_1970_count(tmp_path):
    rng = np.random.default_rng(6)
    view = outlook_of(tmp_path, [noisy(year - 60.0, rng) for year in YEARS])
    assert len(view.deviations[0].times_ns) == 8


def test_temperatures_that_rise_with_time_make_no_table_due_at_once(tmp_path):
    """A coefficient of which nothing were known would leave nothing known of the level."""
    rng = np.random.default_rng(7)
    warm = [noisy(year, rng, temperature=20.0 + year) for year in YEARS]
    view = outlook_of(tmp_path, warm)
    assert view.due_ns > view.last_ns + 0.25 * YEAR_NS
    (curve,) = view.deviations
    assert curve.per_kelvin is not None


def test_an_explained_jump_is_no_drift_of_a_control_chart(tmp_path):
    """Still before and after: nothing reaches the tolerance, by whatever method."""
    rng = np.random.default_rng(8)
    with ParkHistory(str(tmp_path / "history.db")) as history:
        for year in YEARS:
            history.add_result(noisy(year, rng, size=1.0 if year < 2.5 else 5.0))
        history.add_event(history.item("X"), "crash", BEGIN_NS + round(2.5 * YEAR_NS), "")
        (view,) = all_outlooks(history, HistorySettings())
    assert dict(view.deviations[0].intervals_days)["control chart"] > 300.0


def test_the_drift_of_each_harmonic_is_that_of_the_table(tmp_path):
    rng = np.random.default_rng(9)
    results = []
    for year in YEARS:
        each = noisy(year, rng)
        truth = 0.4 * year * np.sin(2.0 * CIRCLE) * ARCSEC
        results.append(replace(each, deviations={"ECC": each.deviations["ECC"] + truth}))
    (curve,) = outlook_of(tmp_path, results).deviations
    orders, rates, stds = map(np.array, zip(*curve.harmonics, strict=True))
    assert orders.tolist() == [1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 6]
    expected = np.where(np.arange(12) == 3, 0.4 * ARCSEC, 0.0)
    assert np.all(np.abs(rates - expected) < 4.0 * stds)
    assert rates[3] > 10.0 * stds[3]
