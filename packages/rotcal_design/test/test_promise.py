"""What a plan promises: order statistics against the binomial law, and results that state none."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from rotcal_design.tracer.ordering import (
    LOOKS,
    SimulatedUncertainties,
    allowed_misses,
    expanded_about_mean,
    simulate_uncertainties,
)
from rotcal_ros.geometry.rotations import positions_on_table
from rotcal_ros.methods.tracer.policy.information import Scene
from rotcal_ros.methods.tracer.solver.problem import TracerProblem

NEVER = (0.0, 0.0)
"""A goal that no run meets: all are simulated."""
ANGLES = 2.0 * np.pi * np.arange(8) / 8


def of(values, factor=1.1):
    values = np.asarray(values, dtype=float)
    return SimulatedUncertainties(values, factor * values)


@pytest.mark.parametrize("confidence", [0.5, 0.8, 0.9, 0.95])
def test_a_promise_is_kept_where_the_binomial_law_leaves_little_doubt(confidence):
    """At each of three looks a plan that misses as often as is allowed passes with 5 % / 3."""
    for runs in LOOKS:
        most = allowed_misses(runs, confidence)
        assert binom.cdf(most, runs, 1.0 - confidence) < 0.05 / 3
        assert binom.cdf(most + 1, runs, 1.0 - confidence) >= 0.05 / 3
        rng = np.random.default_rng(runs)
        values = rng.permutation(np.append(np.linspace(1.0, 2.0, runs - most), [3.0] * most))
        promise = of(values)
        assert promise.kept(confidence, 2.0)
        assert promise.below(confidence) == (2.0, 2.2)
        assert not promise.kept(confidence, 1.99)
        assert not promise.kept(confidence, 2.0, 2.19)


def test_too_few_runs_promise_nothing():
    assert allowed_misses(20, 0.95) == -1
    assert of(np.ones(20)).below(0.95) == (np.inf, np.inf)
    assert not of(np.ones(20)).kept(0.95, 2.0)


def test_results_that_state_nothing_count_as_missed():
    promise = of([*np.linspace(1.0, 2.0, 300), *[np.inf] * 100])
    assert promise.suspected == 0.25
    assert promise.met(2.0) == promise.met(np.inf) == promise.met(2.0, 2.2) == 0.75
    assert promise.met(2.0, 1.1) == pytest.approx(1 / 400)
    assert promise.below(0.8) == (np.inf, np.inf)
    assert promise.likely(0.8) == (2.0, 2.2)  # of those that are ok
    assert promise.below(0.6)[0] <= 2.0
    assert promise.hopeless(0.8)
    assert not promise.hopeless(0.7)


def test_both_goals_are_met_by_the_same_run():
    """A tenth is too large in rms, another tenth at the worst angle."""
    rms, largest = np.ones(100), np.ones(100)
    rms[:10] = largest[90:] = 2.0
    assert SimulatedUncertainties(rms, largest).met(1.5, 1.5) == pytest.approx(0.8)


def test_u_is_about_the_mean_of_the_angles():
    rng = np.random.default_rng(3)
    root = rng.standard_normal((5, 5))
    drawn = root @ rng.standard_normal((5, 400_000))
    spread = 2.0 * (drawn - drawn.mean(axis=0)).std(axis=1)
    assert expanded_about_mean(root @ root.T) == pytest.approx(spread, rel=5e-3)


def posed(**options):
    """Ten targets low around the table from eight stations, with a zero each."""
    fixed = np.random.default_rng(4)
    around, far = 2.0 * np.pi * np.arange(10) / 10, fixed.uniform(0.3, 0.6, 10)
    targets = np.column_stack(
        [far * np.cos(around), far * np.sin(around), fixed.uniform(0.15, 0.7, 10)]
    )
    scene = Scene(
        positions_on_table((0.065, 0.0, 0.12), ANGLES), ANGLES, targets, np.array(1e-6), 2e-7,
        error_motion_std=options.get("error_motion_std"),
        circle_std=options.get("circle_std"),
    )  # fmt: skip
    position, target = np.divmod(np.arange(80), 10)
    problem = TracerProblem(
        position, target, np.ones(80), np.full(80, 2e-7), targets, 1e-6, ANGLES, **options
    )
    return problem, scene


@pytest.mark.slow
def test_a_stated_error_motion_is_held_and_none_scatters_what_is_stated():
    stated, estimated, circle = (
        simulate_uncertainties(*posed(**options), NEVER, 0.5, looks=(60,))
        for options in (
            {"error_motion_std": 1e-7},
            {"error_motion_std": None},
            {"error_motion_std": 0.0, "circle_std": 1e-7},
        )
    )
    for known in (stated, circle):
        assert np.sort(known.rms)[2] == pytest.approx(known.median[0], rel=1e-2)
        assert known.met(np.inf) > 0.95  # what is drawn agrees with what is stated
    assert np.sort(estimated.rms)[53] > 1.3 * estimated.median[0]
    # the part of the error motion is 1e-7 / 65 mm at each angle, and the mean takes little of it
    bare = simulate_uncertainties(*posed(error_motion_std=0.0), NEVER, 0.5, looks=(60,))
    added = np.sqrt(stated.median[0] ** 2 - bare.median[0] ** 2) / 2.0
    assert added == pytest.approx(1e-7 / 0.065, rel=0.25)


def test_the_same_seed_promises_the_same():
    problem, scene = posed(error_motion_std=None)
    first, again = (
        simulate_uncertainties(problem, scene, NEVER, 0.5, looks=(5,), seed=2) for _ in range(2)
    )
    assert np.array_equal(first.rms, again.rms)
    blind = replace(problem, targets=problem.targets * [1, 1, 0])
    assert simulate_uncertainties(blind, scene, NEVER, 0.5, looks=(3,)).runs == 3


@pytest.mark.slow
@pytest.mark.slow
@pytest.mark.parametrize(
    ("goal", "runs"), [(1.0, 20), (1e-9, 100)], ids=["met by all", "met by none"]
)
def test_no_more_runs_are_simulated_than_tell_it(goal, runs):
    """Of 20 runs with none missed more than half meet it; where none does, 100 show how far."""
    found = simulate_uncertainties(
        *posed(error_motion_std=0.0), (goal, goal), 0.5, looks=(20, 160)
    )
    assert found.runs == runs
    assert found.kept(0.5, goal, goal) == (goal == 1.0)
