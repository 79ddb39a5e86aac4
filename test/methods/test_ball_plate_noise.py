"""Noise that differs from axis to axis: estimated, tested, reported, and in the uncertainties."""

import re
from dataclasses import replace

import numpy as np
import pytest
from chances import LONG
from chances import share as by_chance
from coded import coded
from exact_plate import ExactPlate

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.methods.ball_plate.solver import plate_trials, solve
from rotcal_ros.methods.ball_plate.solver.result import SCATTER_UNEQUALLY

SIGMA = 5e-8
SIX = [0, 3, 4, 9, 14, 20]
N = 24 * len(SIX)
RUNS = 40 if LONG else 5
ABOUT = (0.92, 0.98) if LONG else by_chance(0.95, RUNS * 24 // 3)
"""Each of the 24 angles of a run has centres of its own; a third counts as independent."""
REAL = {"table": 2e-6, "machine": 2e-6, "made": 1e-5}


@pytest.fixture(scope="module")
def plate():
    return ExactPlate(24, SIX, **REAL, seed=1)


@pytest.fixture(scope="module")
def exact(plate):
    return plate.problem()


def axis_noise(result):
    """What a result says that centres scatter along x, y and z, m."""
    (text,) = [text for text in result.warnings if SCATTER_UNEQUALLY in coded(text)]
    found = re.search(r"by (\S+), (\S+), (\S+) um along", text).groups()
    return 1e-6 * np.array(found, dtype=float)


def covered(plate, exact, axes, runs, **stated):
    """Share of the deviations of each component within 1.96 stated standard deviations."""
    rng = np.random.default_rng(11)
    inside = {name: [] for name in COMPONENTS}
    for _ in range(runs):
        noise = np.array(axes) * SIGMA * rng.normal(size=exact.centres.shape)
        result = solve(replace(exact, centres=exact.centres + noise, **stated))
        for name in COMPONENTS:
            error = result.deviations[name] - plate.true(name)
            inside[name].append(np.abs(error) < 1.96 * result.std[name])
    return {name: float(np.mean(inside[name])) for name in COMPONENTS}


@pytest.mark.long  # statistics
@pytest.mark.parametrize("axes", [(1, 1, 1), (1, 1, 2), (1, 1, 0.5), (2, 1, 1), (1, 0.5, 2)])
def test_intervals_hold_for_all_six_components(plate, exact, axes):
    share = covered(plate, exact, axes, RUNS)
    assert all(ABOUT[0] <= value <= ABOUT[1] for value in share.values()), share


def test_intervals_hold_where_the_statement_is_wrong_in_one_axis(plate, exact):
    share = covered(plate, exact, (1, 1, 2), RUNS, sigma=SIGMA)
    assert all(ABOUT[0] <= value <= ABOUT[1] for value in share.values()), share


@pytest.mark.slow
@pytest.mark.parametrize("axes", [(3.0, 2.0, 1.0), (6.0, 2.0, 1.0)])
def test_each_axis_is_estimated_without_bias(exact, axes):
    """Whether they are called unequal or not.

    Of 3 : 2 the best test with the 66 degrees of freedom of these 144 centres finds every second
    one, if it may call one of a thousand alike ones unequal: F of 2.25 is 3.3 standard deviations.
    """
    rng, square, runs = np.random.default_rng(5), np.zeros(3), 20 if LONG else 8
    for _ in range(runs):
        noise = np.array(axes) * SIGMA * rng.normal(size=exact.centres.shape)
        result = solve(replace(exact, centres=exact.centres + noise))
        square += np.square(result.details["sigma_axes"]) / runs
    np.testing.assert_allclose(np.sqrt(square) / SIGMA, axes, rtol=0.045 if LONG else 0.07)


def test_axes_of_the_plane_that_differ_are_named_and_counted_each_by_itself(exact):
    noise = np.array([2, 1, 1.5]) * SIGMA * np.random.default_rng(2).normal(size=(N, 3))
    result = solve(replace(exact, centres=exact.centres + noise))
    assert result.verdict == "suspect"
    np.testing.assert_allclose(axis_noise(result) / SIGMA, [2, 1, 1.5], rtol=0.2)


@pytest.mark.parametrize("axes", [(1, 1, 2), (1, 1, 0.4)])
def test_noise_along_the_axis_of_its_own_is_nothing_odd(exact, axes):
    noise = np.array(axes) * SIGMA * np.random.default_rng(2).normal(size=(N, 3))
    result = solve(replace(exact, centres=exact.centres + noise))
    assert result.verdict == "ok"
    plane, along = (result.std[name].mean() for name in ("EXC", "EZC"))
    assert along / plane == pytest.approx(axes[2], rel=0.3)


def test_equal_noise_is_rarely_called_unequal(exact):
    rng, called = np.random.default_rng(8), 0
    for _ in range(60 if LONG else 20):
        noise = SIGMA * rng.normal(size=exact.centres.shape)
        result = solve(replace(exact, centres=exact.centres + noise, sigma=SIGMA))
        called += any("scatter" in text for text in result.warnings)
    assert called <= 1  # two tests of 0.1 %


def test_a_statement_is_tested_axis_by_axis(exact):
    noise = SIGMA * np.random.default_rng(2).normal(size=exact.centres.shape)
    noise *= [1.0, 1.0, 2.0]
    stated = 1.4 * SIGMA
    result = solve(replace(exact, centres=exact.centres + noise, sigma=stated))
    assert result.verdict == "suspect"  # right over all axes, wrong in z
    assert any("along the axis is" in text for text in result.warnings)
    noise = result.details["noise"]
    assert noise["the centres along the axis"] == pytest.approx(2.0 / 1.4, rel=0.2)


def test_a_stated_standard_deviation_for_each_axis(plate, exact):
    for axes in ((1.0, 1.0, 2.0), (1.0, 1.5, 0.7)):
        rng = np.random.default_rng(3)
        std = np.broadcast_to(np.array(axes) * SIGMA, exact.centres.shape)
        noisy = replace(exact, centres=exact.centres + std * rng.normal(size=std.shape), std=std)
        result = solve(noisy)
        assert result.verdict == "ok"
        assert result.warnings == ()
        for name in COMPONENTS:
            error = result.deviations[name] - plate.true(name)
            assert np.sqrt(np.mean((error / result.std[name]) ** 2)) < 1.6, name


def test_trials_have_the_noise_of_each_axis(exact):
    for axes in ((1.0, 1.0, 2.0), (2.0, 1.0, 1.0)):
        noise = np.array(axes) * SIGMA * np.random.default_rng(2).normal(size=exact.centres.shape)
        problem = replace(exact, centres=exact.centres + noise)
        values = plate_trials(problem)(np.random.default_rng(1), 4000)
        result = solve(problem)
        stated = np.concatenate([result.std[name] for name in COMPONENTS])
        np.testing.assert_allclose(values.std(axis=0), stated, rtol=0.06)


@pytest.mark.slow
def test_groups_know_their_axes():
    plate = ExactPlate(24, [0, 2, 4, 8, 14, 20], seed=6)
    exact = plate.problem(separate_groups=True)
    for axes in ((1, 1, 2), (2, 1, 1)):
        share = covered(plate, exact, axes, 15 if LONG else 5)
        # frames are turned from group to group: of x and y the larger one is stated for both
        assert all(value > (0.9 if LONG else 0.86) for value in share.values()), (axes, share)


@pytest.mark.parametrize("sizes", [{}, REAL])
def test_exact_data_have_no_noise_to_compare(sizes):
    result = solve(ExactPlate(12, [0, 1, 3, 7, 8, 10], **sizes, seed=2).problem())
    assert result.verdict == "ok"
    assert result.warnings == ()
    assert max(result.std["EXC"].max(), result.std["EZC"].max()) < 1e-9
