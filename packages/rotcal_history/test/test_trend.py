"""The model of a series against closed forms and simulated truth."""

from dataclasses import replace

import numpy as np
import pytest
from chances import scatter, share
from scipy.stats import norm

from rotcal_history import trend
from rotcal_history.trend import YEAR_NS, CampaignSeries, fit_trend

M, MODES = 8, 3


def series(values, years=None, u=1.0, common=None, temperature=None, steps=None):
    """Return a series of modes with two coefficients each."""
    m, p = values.shape
    years = np.linspace(0.0, 4.0, m) if years is None else years
    return CampaignSeries(
        times_ns=(years * YEAR_NS).astype(np.int64),
        values=values,
        std=np.full((m, p), u),
        orders=np.repeat(np.arange(1, p // 2 + 1), 2),
        steps=np.zeros(m, dtype=np.int64) if steps is None else steps,
        common=np.eye(m) if common is None else common,
        temperature_c=temperature,
    )


def only(monkeypatch, **sizes):
    """Leave one size of each cause of motion, none unless it is given."""
    row = [sizes.get(name, 0.0) for name in ("drift", "walk", "wear", "season")]
    monkeypatch.setattr(trend, "_grid", lambda _: (np.array([row]), np.zeros(1)))
    monkeypatch.setattr(trend, "SCALES", (1.0,))
    monkeypatch.setattr(trend, "_SCALE_PRIORS", np.zeros(1))


def test_of_a_still_table_the_mean_is_forecast(monkeypatch):
    only(monkeypatch)
    values = np.random.default_rng(1).standard_normal((M, 2))
    found = fit_trend(series(values)).forecast(
        np.array([5 * YEAR_NS], dtype=np.int64), draws=40_000
    )
    assert found.mean(axis=0)[0] == pytest.approx(values.mean(axis=0), abs=0.01)
    assert found.std(axis=0)[0] == pytest.approx(np.full(2, 1.0 / np.sqrt(M)), rel=0.02)


def test_a_drift_is_that_of_a_straight_line(monkeypatch):
    """With a drift that nothing is known of: ordinary least squares, and its uncertainty."""
    only(monkeypatch, drift=1e3)
    years = np.linspace(0.0, 4.0, M)
    values = np.random.default_rng(2).standard_normal((M, 2)) + 3.0 * years[:, None]
    moved, std, span = fit_trend(series(values)).change()
    slope = np.polyfit(years, values, 1)[0]
    apart = years - years.mean()
    assert span == pytest.approx(4.0)
    assert moved / span == pytest.approx(slope, rel=1e-5)
    assert std / span == pytest.approx(np.full(2, 1.0 / np.sqrt(apart @ apart)), rel=1e-5)


def test_errors_in_common_cancel_in_a_change_and_stay_in_a_level(monkeypatch):
    only(monkeypatch, drift=1e3)
    common = 0.75 + 0.25 * np.eye(M)
    values = np.zeros((M, 2))
    alone, joint = fit_trend(series(values)), fit_trend(series(values, common=common))
    assert joint.change()[1] == pytest.approx(0.5 * alone.change()[1], rel=1e-4)
    now = np.array([0], dtype=np.int64)
    assert joint.forecast(now, 20_000).std() > 0.85


def test_a_temperature_coefficient_has_the_uncertainty_of_a_regression(monkeypatch):
    only(monkeypatch)
    rng = np.random.default_rng(3)
    kelvin = rng.normal(20.0, 2.0, M)
    values = rng.standard_normal((M, 2)) + np.outer(kelvin, [0.7, -0.2])
    found = fit_trend(series(values, temperature=kelvin)).per_kelvin()
    slope = np.polyfit(kelvin, values, 1)[0]
    apart = kelvin - kelvin.mean()
    assert found[0] == pytest.approx(slope, rel=1e-3)
    assert found[1] == pytest.approx(np.full(2, 1.0 / np.sqrt(apart @ apart)), rel=1e-3)


def test_without_different_temperatures_there_is_no_coefficient():
    values = np.random.default_rng(4).standard_normal((M, 2))
    assert fit_trend(series(values)).per_kelvin() is None
    assert fit_trend(series(values, temperature=np.full(M, 20.1))).per_kelvin() is None


def test_wear_is_a_random_walk_that_is_integrated():
    """Covariance of the integral of Brownian motion: min^2 (3 max - min) / 6."""
    rng = np.random.default_rng(5)
    steps = 400
    walks = np.cumsum(rng.standard_normal((4000, steps)) / np.sqrt(steps), axis=1)
    worn = np.cumsum(walks, axis=1) / steps
    times = np.array([0.4, 1.0])
    picked = worn[:, [int(t * steps) - 1 for t in times]]
    expected = trend._moving(times, times, np.array([0.0, 0.0, 1.0, 0.0]))
    assert np.cov(picked.T) == pytest.approx(expected, rel=0.08)


def test_surprises_of_the_earlier_are_those_of_the_series_cut_short():
    values = np.cumsum(np.random.default_rng(6).standard_normal((M, 4)), axis=0)
    whole, years = fit_trend(series(values)), np.linspace(0.0, 4.0, M)
    short = fit_trend(series(values[:7], years[:7]))
    assert whole.surprise[1:7] == pytest.approx(short.surprise[1:7], rel=1e-6)
    assert np.isnan(whole.surprise[0]).all()


def test_stated_deviates_of_a_still_table_are_standard_normal():
    rng = np.random.default_rng(7)
    found = np.vstack(
        [fit_trend(series(rng.standard_normal((M, 6)))).stated[1:] for _ in range(25)]
    )
    low, high = scatter(found.size)
    assert low < np.mean(found**2) < high


def test_after_a_step_nothing_is_known_of_the_level_but_all_of_the_drift():
    years = np.linspace(0.0, 6.0, 13)
    rng = np.random.default_rng(8)
    values = np.outer(years, [4.0, 0.0]) + rng.standard_normal((13, 2))
    values[11:] += 500.0
    stepped = fit_trend(series(values, years, steps=(years > 5.2).astype(np.int64)))
    assert np.isnan(stepped.surprise[11]).all()
    assert np.abs(stepped.surprise[12]).max() < 3.5
    forecast = stepped.forecast(np.array([7 * YEAR_NS], dtype=np.int64))
    assert forecast.mean(axis=0)[0] == pytest.approx([528.0, 500.0], abs=4.0)


def test_a_jump_surprises_and_a_drift_does_not():
    years = np.linspace(0.0, 5.0, 11)
    rng = np.random.default_rng(9)
    values = np.outer(years, [2.0, 1.0]) + rng.standard_normal((11, 2))
    assert np.nanmax(np.abs(fit_trend(series(values, years)).surprise)) < 4.0
    values[9:] += 30.0
    assert np.abs(fit_trend(series(values, years)).surprise[9]).min() > 4.0


def test_what_a_forecast_promises_is_true_as_often_as_it_says():
    """Tables that drift and walk as the model thinks possible: intervals of 90 % of the next."""
    rng = np.random.default_rng(10)
    inside = total = 0
    years = np.linspace(0.0, 5.0, M + 1)
    for number in range(40):
        drift = rng.choice(trend.SIZES[:3]) * rng.standard_normal(2)
        truth = np.outer(years, drift)
        steps = np.sqrt(np.diff(years, prepend=0.0))[:, None] * rng.standard_normal((M + 1, 2))
        truth += (0.4 * (number % 2)) * np.cumsum(steps, axis=0)
        values = truth[:M] + rng.standard_normal((M, 2))
        at = np.array([round(years[-1] * YEAR_NS)])
        drawn = fit_trend(series(values, years[:M])).forecast(at, draws=1000)[:, 0]
        rank = np.mean(drawn < truth[-1], axis=0)
        inside += int(np.sum((rank > 0.05) & (rank < 0.95)))
        total += 2
    low, _ = share(0.90, total)
    assert low <= inside / total


def test_uncertainties_that_are_stated_too_small_widen_the_forecast():
    rng = np.random.default_rng(11)
    values = rng.standard_normal((12, 6))
    honest = fit_trend(series(values, u=1.0))
    bold = fit_trend(series(values, u=0.2))
    at = np.array([4 * YEAR_NS], dtype=np.int64)
    spread = [one.forecast(at).std(axis=0).mean() for one in (honest, bold)]
    assert spread[1] > 0.6 * spread[0]


def test_equal_input_gives_equal_output():
    one = series(np.random.default_rng(12).standard_normal((M, 4)))
    at = np.array([5 * YEAR_NS], dtype=np.int64)
    assert np.array_equal(fit_trend(one).forecast(at), fit_trend(replace(one)).forecast(at))


def test_deviates_follow_from_the_mixture_of_what_is_likely():
    """Of two campaigns only the difference matters; a wide prior surprises less."""
    surprise = fit_trend(
        series(np.array([[0.0, 0.0], [3.0, 3.0]]), np.array([0.0, 1.0]))
    ).surprise[1]
    still = norm.ppf(norm.cdf(3.0 / np.sqrt(2.0)))
    assert np.all(surprise < still)
