"""Scatter of unknown size: places that arrivals leave, from none to thirty times the noise."""

from functools import cache

import numpy as np
import pytest
from chances import LONG, share
from scipy import stats

from rotcal_ros.adjust.engine import adjust, predicted
from rotcal_ros.adjust.error_motion import Spectrum
from rotcal_ros.adjust.gathering import Words
from rotcal_ros.adjust.model import Grouping, Model, Unit, linear
from rotcal_ros.adjust.observable import observe_columns

SIGMA, READ = 1e-6, 4
MICRON = Unit("um", 1e-6)
WORDS = Words("readings", "warm air", "in the beams", "in its beams")


@cache
def network(m):
    """Return the design of m stations read four times each, and what they lie on: a circle."""
    angle = 2.0 * np.pi * np.arange(m) / m
    circle = np.column_stack([np.ones(m), np.cos(angle), np.sin(angle)])
    station = np.repeat(np.arange(m), READ)
    return np.hstack([np.eye(m)[station], np.zeros((len(station), 3))]), circle, station


def stations(m, rng, size, stated=None, ways=(), kind=None, off=()):
    """Return truth (3,) and a model of a circle that stations leave by ``size``, of a ``kind``."""
    design, circle, station = network(m)
    truth = 1e-3 * rng.standard_normal(3)
    left = rng.standard_normal(m) if kind is None else kind @ rng.standard_normal(kind.shape[1])
    observed = (circle @ truth + size * left)[station] + SIGMA * rng.standard_normal(m * READ)
    observed[list(off)] += 20.0 * SIGMA
    model = Model(
        blocks={"station": m, "circle": 3}, observed=observed, std=np.full(m * READ, SIGMA),
        equations=linear(design), outputs=np.eye(3, m + 3, m), words=WORDS, unit=MICRON,
        groupings=(Grouping("station", station),),
    )  # fmt: skip
    return truth, model.scattering(
        "the error motion", np.hstack([np.eye(m), -circle]), stated, 1e-3, ways
    )


@pytest.mark.parametrize("q", [5, 9, 36])
@pytest.mark.parametrize("size", [0.0, 0.5, 1.0, 3.0, 30.0])
def test_intervals_hold_the_truth_for_every_size(q, size):
    """Where circle and contrasts feel the scatter alike: 95 %, few contrasts of none 97 %."""
    inside, runs = [], 400 if LONG else 40
    for seed in range(runs):
        rng = np.random.default_rng([seed, q, int(10 * size)])
        truth, model = stations(q + 3, rng, size * 0.5 * SIGMA)
        found = adjust(model)
        inside += (np.abs(found.value - truth) < 1.96 * found.std).tolist()
    low, high = share(0.93, runs)[0], share(0.975, runs)[1]
    assert low < np.mean(inside) < high


def test_the_posterior_is_that_of_student_far_above_the_noise():
    """Nine contrasts: the interval is that of t with nine degrees of freedom, to 2 %."""
    _, circle, station = network(12)
    for seed in range(5):
        _, model = stations(12, np.random.default_rng(seed), 300.0 * SIGMA)
        found = adjust(model)
        mean = np.bincount(station, model.observed[: len(station)]) / READ
        fit, (left,), *_ = np.linalg.lstsq(circle, mean)
        spread = np.sqrt(left / 9.0 * np.linalg.inv(circle.T @ circle).diagonal())
        assert 1.96 * found.std == pytest.approx(stats.t.isf(0.025, 9) * spread, rel=0.02)
        assert found.value == pytest.approx(fit, rel=1e-6, abs=1e-8)
        assert found.verdict == "ok"


def test_contrasts_are_restricted_likelihood():
    """Against ln L of all readings by plain algebra, whatever size the rows are weighed by."""
    design, circle, station = network(8)
    _, model = stations(8, np.random.default_rng(3), 2.0 * SIGMA)
    errors = design[:, :8]
    free = np.linalg.svd(circle[station])[0][:, 3:]
    read = model.observed[: len(station)]

    def log_likelihood(size):
        whole = SIGMA**2 * np.eye(len(read)) + size**2 * errors @ errors.T
        inner = free.T @ whole @ free
        u = free.T @ read
        return -0.5 * (np.linalg.slogdet(inner)[1] + u @ np.linalg.solve(inner, u))

    for by in (1e-6, 1e-4):
        fit = adjust(model.scattered([by])).fit
        (sizes,) = fit.sizes.values()
        assert sizes.contrasts == 5
        x = sizes.size[1:] / sizes.noticed / 1.2
        prior = x**5 / (1.0 + x**5)
        logs = np.log(sizes.weight[1:] / prior)
        expected = [log_likelihood(size) for size in sizes.size[1:]]
        np.testing.assert_allclose(logs - logs[40], np.array(expected) - expected[40], atol=0.01)


def test_what_is_stated_stands_until_it_is_contradicted():
    rng = np.random.default_rng(5)
    _, model = stations(39, rng, 3.0 * SIGMA, stated=3.0 * SIGMA)
    found, plan = adjust(model), predicted(model)
    assert found.verdict == "ok"
    assert found.std == pytest.approx(plan.std)
    _, model = stations(39, rng, 12.0 * SIGMA, stated=3.0 * SIGMA)
    wrong = adjust(model)
    assert wrong.verdict == "suspect"
    assert "the error motion is 4" in " ".join(wrong.doubts)
    assert wrong.std / plan.std == pytest.approx(4.0, rel=0.3)
    assert wrong.details()["scattering"]["the error motion"]["contrasts"] == 36


@pytest.mark.parametrize("unit", [1.0, 1e-6])
def test_the_unit_of_the_ways_is_no_matter(unit):
    """Stated by a size, or by the root of the covariance itself; so is what is unknown."""
    rng, plain = np.random.default_rng(5), np.eye(39)
    _, model = stations(39, rng, 3e-6, stated=3e-6, ways=[(1.0, plain)])
    rng = np.random.default_rng(5)
    _, other = stations(39, rng, 3e-6, stated=3e-6 / unit, ways=[(1.0, unit * plain)])
    assert adjust(other).std == pytest.approx(adjust(model).std)
    rng = np.random.default_rng(5)
    _, unknown = stations(39, rng, 3e-6, ways=[(1.0, unit * plain)])
    (found,) = adjust(unknown).details()["scattering"].values()
    assert found["size"] == pytest.approx(3e-6, rel=0.4)


def test_a_wrong_reading_is_left_out_however_much_stations_scatter():
    for size in (0.0, 30.0):
        _, model = stations(12, np.random.default_rng(6), size * SIGMA, off=[9])
        assert list(adjust(model).why) == [9]


@pytest.mark.parametrize("order", [None, 2, 3])
def test_motions_of_few_orders_are_held(order):
    """White or of one order: four ways of 12 stations, the truth one of them."""
    angle, runs = 2.0 * np.pi * np.arange(12) / 12, 200 if LONG else 25
    ways = [(0.4, np.eye(12))]
    ways += [(0.2, Spectrum((k,), (1.0,)).root(angle)) for k in (2, 3, 4)]
    kind = None if order is None else ways[order - 1][1]
    inside = []
    for seed in range(runs):
        rng = np.random.default_rng([seed, order or 0])
        truth, model = stations(12, rng, 5.0 * SIGMA, ways=ways, kind=kind)
        found = adjust(model)
        inside += (np.abs(found.value - truth) < 1.96 * found.std).tolist()
    assert np.mean(inside) > share(0.93, runs)[0]


def test_trials_scatter_as_intervals_say():
    _, model = stations(12, np.random.default_rng(7), 5.0 * SIGMA)
    found = adjust(model)
    drawn = found.trials(np.random.default_rng(8), 20_000)
    assert drawn.std(axis=0) == pytest.approx(found.std, rel=0.03)
    assert np.sqrt(found.covariance.diagonal()) == pytest.approx(found.std)


def test_errors_of_unknown_sizes_are_further_unknowns():
    """Stations as errors of their readings, which then lie on the circle itself."""
    _, model = stations(12, np.random.default_rng(9), 4.0 * SIGMA)
    design, circle, station = network(12)
    other = Model(
        blocks={"circle": 3}, observed=model.observed[: len(station)],
        std=np.full(len(station), SIGMA), equations=linear(circle[station]), outputs=np.eye(3),
        words=WORDS, unit=MICRON, groupings=(Grouping("station", station),),
    ).with_unknowns("station off the circle", design[:, :12])  # fmt: skip
    other = other.scattering("the error motion", np.eye(12, 15, 3), None, 1e-3)
    one, two = adjust(model), adjust(other)
    assert two.value == pytest.approx(one.value, rel=1e-6)
    assert two.std == pytest.approx(one.std, rel=1e-6)


def test_an_effect_is_tested_by_the_covariance_of_what_scatters():
    """Against plain algebra, for the likeliest sizes; rows weigh as if each scattered alone."""
    angle = 2.0 * np.pi * np.arange(18) / 18
    ways = [(0.5, Spectrum((k,), (1.0,)).root(angle)) for k in (2, 3)]
    _, circle, station = network(18)
    rng, errors = np.random.default_rng(1), np.linspace(-SIGMA, SIGMA, 18 * READ)[:, None]
    _, model = stations(18, rng, 2.0 * SIGMA, ways=ways, kind=ways[0][1])
    fit = adjust(model).fit
    (each,) = fit.model.scatterings
    seen = observe_columns(fit, np.pad(errors, ((0, 18), (0, 0))))
    white = np.pad(errors / SIGMA, ((0, 18), (0, 0)))
    sizes = each.beside(fit, white)[1]
    squares, weight = each.squares_of(fit, white, seen.score, seen.information)
    for k in np.argsort(-weight)[:3].tolist():
        spread = sizes.size[k] * ways[sizes.way[k]][1][station]
        inverse = np.linalg.inv(SIGMA**2 * np.eye(len(errors)) + spread @ spread.T)
        free, on = circle[station], errors.T @ inverse
        left = on - on @ free @ np.linalg.solve(free.T @ inverse @ free, free.T @ inverse)
        expected = (left @ model.observed[: len(errors)]) ** 2 / (left @ errors)[0]
        assert squares[k] == pytest.approx(expected[0], rel=1e-6)
