"""Monte Carlo against JCGM 101 in plain loops: figures, stop, tolerance, limits, defaults."""

import math
import statistics
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.stats import norm
from scipy.stats.mstats import mquantiles

from rotcal_ros.evaluation import monte_carlo
from rotcal_ros.evaluation.monte_carlo import (
    PropagatedResult,
    Propagation,
    compare_with_linear,
    numerical_tolerance,
    propagate,
    propagate_measurement,
)
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC


def model(rng, count):
    return rng.normal([1.0, -2.0], [0.5, 3.0], (count, 2)) ** 3


class Kept:
    """A model that remembers its trials."""

    def __init__(self):
        self.blocks = []

    def __call__(self, rng, count):
        self.blocks.append(model(rng, count))
        return self.blocks[-1]


def figures(trials, probability):
    """Mean, std, low and high of each output, with the standard library and scipy's quantiles."""
    tail = (1.0 - probability) / 2.0
    columns = []
    for column in trials.T.tolist():
        low, high = mquantiles(column, [tail, 1.0 - tail], alphap=1, betap=1)
        columns.append((statistics.fmean(column), statistics.stdev(column), low, high))
    return np.array(columns).T


@pytest.mark.parametrize("probability", [0.95, 0.5])
def test_figures_are_those_of_all_trials(probability):
    kept = Kept()
    found = propagate(kept, seed=1, max_trials=900, block=300, probability=probability)
    every = np.concatenate(kept.blocks)
    assert (found.trials, found.probability, found.digits) == (900, probability, 2)
    mean, std, low, high = figures(every, probability)
    np.testing.assert_allclose(found.mean, mean, rtol=1e-12)
    np.testing.assert_allclose(found.std, std, rtol=1e-12)
    np.testing.assert_allclose(found.low, low, rtol=1e-12)
    np.testing.assert_allclose(found.high, high, rtol=1e-12)
    centred = every - mean
    np.testing.assert_allclose(found.covariance, centred.T @ centred / 899.0, rtol=1e-10)


def half_a_unit(std, digits):
    """Half a unit in the last of so many digits of a number as it is printed."""
    return 0.5 * 10.0 ** (int(f"{std:.{digits - 1}e}".split("e")[1]) - digits + 1)


@pytest.mark.parametrize("digits", [1, 2, 3])
def test_tolerance_is_half_a_unit_of_the_last_digit_as_printed(digits):
    std = np.append(10.0 ** np.linspace(-9.0, 5.0, 97), [9.4, 9.6, 0.994, 0.996, 99.94, 99.96])
    expected = [half_a_unit(value, digits) for value in std.tolist()]
    np.testing.assert_allclose(numerical_tolerance(std, digits), expected, rtol=1e-12)


def test_a_constant_has_the_tolerance_of_one():
    np.testing.assert_allclose(numerical_tolerance(np.zeros(1), 2), [0.05])


@pytest.mark.slow
@pytest.mark.parametrize(("digits", "seed"), [(1, 0), (1, 5), (2, 9)])
def test_the_stop_is_that_of_the_standard(digits, seed):
    """JCGM 101, 7.9.4, block after block; a model of little spread, so that it ends soon."""
    blocks = []

    def narrow(rng, count):
        blocks.append(rng.uniform(0.0, [1.0, 30.0], (count, 2)))
        return blocks[-1]

    found = propagate(narrow, seed=seed, digits=digits, max_trials=500_000, block=500)
    own = [figures(block, 0.95) for block in blocks]

    def stands(h):
        if h < 2:
            return False
        average = statistics.fmean
        for output in (0, 1):
            tolerance = half_a_unit(average(f[1, output] for f in own[:h]), digits)
            for row in range(4):
                spread = statistics.stdev(f[row, output] for f in own[:h]) / math.sqrt(h)
                if 2.0 * spread > tolerance:
                    return False
        return True

    assert found.stable
    assert stands(len(blocks))
    assert not any(stands(h) for h in range(len(blocks)))


def test_two_blocks_are_the_least_that_can_be_stable():
    found = propagate(lambda _, count: np.zeros((count, 1)), seed=0, max_trials=100, block=10)
    assert (found.stable, found.trials) == (True, 20)
    alone = propagate(lambda _, count: np.zeros((count, 1)), seed=0, max_trials=1, block=2)
    assert (alone.stable, alone.trials, alone.covariance.shape) == (False, 2, (1, 1))


class EnoughError(Exception):
    pass


def test_defaults_are_a_hundred_thousand_trials_in_blocks_of_two_thousand():
    """docs/evaluation.md: blocks of 2000, two digits, ends of the 95 % interval."""

    def stop(done, total):
        raise EnoughError(done, total)

    with pytest.raises(EnoughError) as seen:
        propagate(model, seed=0, progress=stop)
    assert seen.value.args == (2000, 100_000)
    found = propagate(model, seed=0, max_trials=1)
    assert (found.trials, found.digits, found.probability) == (2000, 2, 0.95)


@pytest.mark.parametrize(
    ("wrong", "right"),
    [
        ({"probability": 0.0}, {"probability": 1e-3}),
        ({"probability": 1.0}, {"probability": 0.999}),
        ({"digits": 0}, {"digits": 1}),
        ({"workers": 0}, {"workers": 1}),
        ({"block": 1}, {"block": 2}),
        ({"seed": -1}, {"seed": 0}),
        ({"max_trials": 0}, {"max_trials": 1}),
    ],
)
def test_limits_of_an_order(wrong, right):
    given = {"seed": 1, "max_trials": 10, "block": 5}
    propagate(model, **(given | right))
    with pytest.raises(ConfigurationError, match="Monte Carlo needs"):
        propagate(model, **(given | wrong))


class InThreads(ThreadPoolExecutor):
    """Workers in this process; those of another would not feel what a test does here."""

    def __init__(self, workers, context, initializer, initargs):
        assert context.get_start_method() == "spawn"
        super().__init__(workers, initializer=initializer, initargs=initargs)
        self.workers = workers


@pytest.mark.parametrize("workers", [2, 3, 9])
@pytest.mark.parametrize("blocks", [1, 2, 5])
def test_workers_run_the_same_blocks_in_the_same_order(workers, blocks, monkeypatch):
    monkeypatch.setattr(monte_carlo, "ProcessPoolExecutor", InThreads)
    given = {"seed": 3, "max_trials": 40 * blocks, "block": 40, "digits": 3}
    progress = []
    one = propagate(model, **given)
    more = propagate(model, **given, workers=workers, progress=lambda *done: progress.append(done))
    assert one.trials == more.trials == 40 * blocks
    for name in ("mean", "std", "low", "high", "covariance"):
        np.testing.assert_array_equal(getattr(more, name), getattr(one, name))
    assert progress == [(40 * (k + 1), 40 * blocks) for k in range(blocks)]


def test_workers_compute_no_more_than_one_round_ahead(monkeypatch):
    monkeypatch.setattr(monte_carlo, "ProcessPoolExecutor", InThreads)
    begun = []

    def counted(rng, count):
        begun.append(count)
        return rng.normal(size=(count, 1))

    def stop(done, _):
        raise EnoughError(done)

    with pytest.raises(EnoughError):
        propagate(counted, seed=0, workers=3, max_trials=1000, block=10, progress=stop)
    assert set(begun) == {10}
    assert len(begun) <= 4


# The linear uncertainty beside the trials.


def spread_of(low, high, **changes):
    n = len(low)
    given = Propagation(
        mean=np.zeros(n),
        std=np.ones(n),
        low=np.asarray(low),
        high=np.asarray(high),
        covariance=np.eye(n),
        probability=0.95,
        digits=2,
        trials=10_000,
        stable=True,
    )
    return replace(given, **changes)


def allowed(std, probability, digits, trials):
    """Half a digit or 5 % of std, and four standard errors of a normal quantile."""
    tail = 0.5 * (1.0 - probability)
    chance = math.sqrt(tail * (1.0 - tail) / trials) * std / norm.pdf(norm.ppf(tail))
    return max(half_a_unit(std, digits), 0.05 * std) + 4.0 * chance


@pytest.mark.parametrize("end", ["low", "high"])
@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize(
    ("std", "probability", "digits", "trials"),
    [(1.0, 0.95, 2, 10_000), (0.3, 0.9, 1, 400), (20.0, 0.99, 3, 100), (9e-6, 0.5, 1, 1000)],
)
def test_an_end_of_the_interval_may_be_off_by_digit_and_chance(
    end, side, std, probability, digits, trials
):
    value, k = 5.0 * std, norm.isf(0.5 * (1.0 - probability))
    ends = {"low": value - k * std, "high": value + k * std}
    for share, warnings in ((0.999, 0), (1.001, 1)):
        off = side * share * allowed(std, probability, digits, trials)
        moved = {name: [place + off * (name == end)] for name, place in ends.items()}
        spread = spread_of(**moved, probability=probability, digits=digits, trials=trials)
        assert len(compare_with_linear(spread, np.array([value]), np.array([std]))) == warnings


def test_the_warning_says_both_uncertainties_and_the_shift():
    spread = spread_of(
        [-1.96, -9.0], [1.96, 9.0], mean=np.array([0.0, 12.5]), std=np.array([1.0, 4.75])
    )
    value, std = np.array([0.0, 2.5]), np.ones(2)
    words = (
        "the linear standard uncertainty is 1, the trials say 4.75 (mean shifted by 10); trust "
        "the trials"
    )
    assert compare_with_linear(spread, value, std) == [f"output 1: {words}"]
    assert compare_with_linear(spread, value, std, ("first", "second")) == [f"second: {words}"]


ANGLES = np.deg2rad([0.0, 45.0, 90.0])


def solved():
    """EXC of 1, 2, 3 um and ECC of 4, 5, 6 arcsec, with 0.1 of both as uncertainties."""
    values = {"ECC": np.array([4.0, 5.0, 6.0]) * ARCSEC, "EXC": np.array([1e-6, 2e-6, 3e-6])}
    return Result(
        method="simulated",
        angles=ANGLES,
        deviations=values,
        std={"EXC": np.full(3, 1e-7), "ECC": np.full(3, 0.1 * ARCSEC)},
        covariance={},
        sigma0=1.0,
        dof=9,
        n_observations=18,
    )


def trials_about(factor=1.0, **changes):
    """What trials of a linear model say, their std ``factor`` times as large at 45 degrees."""
    result = solved()
    mean = np.concatenate([result.deviations[name] for name in ("EXC", "ECC")])
    std = np.concatenate([result.std[name] for name in ("EXC", "ECC")])
    std[4] *= factor
    k = norm.isf(0.025)
    spread = spread_of(mean - k * std, mean + k * std, mean=mean, std=std, **changes)
    return PropagatedResult(result, spread, seed=11)


def test_components_are_split_in_the_order_of_all_methods():
    found = trials_about()
    assert list(found.components) == ["EXC", "ECC"]
    for name, size in (("EXC", 1e-6), ("ECC", ARCSEC)):
        part = found.components[name]
        value = np.array([1.0, 2.0, 3.0]) + (3.0 if name == "ECC" else 0.0)
        for column, expected in (
            (part.value, value),
            (part.mean, value),
            (part.linear_std, 0.1),
            (part.std, 0.1),
            (part.low, value - 0.1 * norm.isf(0.025)),
            (part.high, value + 0.1 * norm.isf(0.025)),
        ):
            np.testing.assert_allclose(column / size, np.broadcast_to(expected, 3), rtol=1e-9)


def test_contradictions_are_told_in_the_units_of_people():
    assert trials_about().warnings == ()
    assert trials_about().describe() == (
        "10000 trials confirm the solver's uncertainty; stable to 2 digits, seed 11"
    )
    found = trials_about(2.0, stable=False)
    assert found.warnings == (
        "ECC at 45 deg (arcsec): the linear standard uncertainty is 0.1, the trials say 0.2 "
        "(mean shifted by 0); trust the trials",
    )
    assert found.describe() == (
        "10000 trials CONTRADICT the solver's uncertainty; not yet stable to 2 digits, seed 11"
    )


def test_the_file_of_the_trials_holds_si_numbers():
    found = trials_about(2.0).to_dict()
    parts = found.pop("components")
    assert list(parts) == ["EXC", "ECC"]
    assert parts["EXC"]["value"] == pytest.approx([1e-6, 2e-6, 3e-6])
    assert parts["ECC"]["std"] == pytest.approx(np.array([0.1, 0.2, 0.1]) * ARCSEC)
    for part in parts.values():
        assert set(part) == {"value", "linear_std", "mean", "std", "low", "high"}
    assert found == {
        "schema": 1,
        "method": "simulated",
        "trials": 10_000,
        "stable": True,
        "digits": 2,
        "probability": 0.95,
        "seed": 11,
        "angles_rad": ANGLES.tolist(),
        "open_zeros": "",
        "warnings": list(trials_about(2.0).warnings),
    }


@dataclass(frozen=True)
class Prepared:
    """Stands for what was measured: trials and solution know how many observations there are."""

    n: int

    def trials(self):
        return lambda rng, count: rng.normal(self.n, 1.0, (count, 6))

    def solve(self):
        return replace(solved(), n_observations=self.n)


@pytest.mark.parametrize(("trials", "done"), [(500, 500), (2000, 2000), (2001, 4000)])
def test_an_order_reaches_the_trials_and_the_solver(trials, done, monkeypatch):
    monkeypatch.setattr(monte_carlo, "ProcessPoolExecutor", InThreads)
    seen = []
    found = propagate_measurement(
        Prepared(7), trials=trials, digits=3, seed=5, workers=2,
        progress=lambda *given: seen.append(given),
    )  # fmt: skip
    assert (found.result.n_observations, found.seed, found.spread.digits) == (7, 5, 3)
    assert (found.spread.trials, seen[-1]) == (done, (done, done))
    block = min(trials, 2000)
    alone = propagate(Prepared(7).trials(), seed=5, digits=3, max_trials=trials, block=block)
    np.testing.assert_array_equal(found.spread.mean, alone.mean)
