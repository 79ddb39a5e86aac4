"""Scatter from run to run: found, tested, and in the uncertainty."""

import numpy as np
import pytest
from chances import LONG
from six_coverage import KINDS, TWELVE, coverage
from six_linear import Linear, linear_coverage
from six_scene import good_targets, on_circle, scene

from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.methods.tracer_six.solver import SixProblem, solve
from rotcal_ros.methods.tracer_six.solver.scatter import enlargement, stated
from rotcal_ros.methods.tracer_six.solver.solution import adjust

LEAST = 0.92 if LONG else 0.9
NONE = {"scatter_translation_std": 0.0, "scatter_rotation_std": 0.0}


@pytest.mark.slow
def test_intervals_hold_without_scatter():
    found = coverage(60 if LONG else 20, (0.0, 0.0), seed=1, slip=0.0, **NONE)
    assert (found.share > LEAST).all()
    assert (found.share < (0.975 if LONG else 0.99)).all()


@pytest.mark.slow
@pytest.mark.slow
def test_intervals_hold_with_scatter_that_is_estimated():
    found = coverage(40 if LONG else 12, (1e-7, 5e-7), seed=2, slip=0.0)
    assert (found.share > LEAST).all()
    ignored = coverage(15 if LONG else 8, (1e-7, 5e-7), seed=2, ignored=True)
    assert ignored.share.mean() < 0.85


@pytest.fixture(scope="module")
def once():
    return Linear()


@pytest.fixture(scope="module")
def twice():
    return Linear(good_targets()[TWELVE], arrivals=2)


def test_intervals_hold_where_the_estimate_has_nothing_to_find(once, twice):
    """Uncertainties (um, urad) of the same lengths with the scatter known to be none beside."""
    found = linear_coverage(once, 200 if LONG else 80, (0.0, 0.0), seed=6)
    assert (found.share > (0.94 if LONG else 0.92)).all()
    assert (found.share < (0.98 if LONG else 0.99)).all()
    assert (found.std < 1.22 * 0.5e-6 * np.array([0.078, 0.080, 0.072, 0.650, 0.653, 0.554])).all()
    found = linear_coverage(twice, 40, (0.0, 0.0), seed=7)
    assert (found.std < 1.03 * 0.5e-6 * np.array([0.076, 0.082, 0.072, 0.653, 0.652, 0.555])).all()


@pytest.mark.parametrize("kind", KINDS)
def test_intervals_hold_whatever_scatters(once, kind):
    found = linear_coverage(once, 400 if LONG else 100, KINDS[kind], seed=8)
    assert (found.share > LEAST).all()


def test_intervals_hold_with_two_arrivals(twice):
    found = linear_coverage(twice, 80 if LONG else 40, KINDS["turns"], seed=9)
    assert (found.share > LEAST).all()


def test_first_order_gives_what_the_solver_does(once):
    quiet = {"noise": 0.0, "mounted": 0.0, "curves": (0.0, 0.0)}
    result = solve(SixProblem(**scene(np.random.default_rng(1), **quiet).rows, slip=0.0))
    _, std = once.solved(np.zeros(72), np.zeros(33))
    np.testing.assert_allclose(list(result.std.values()), std, rtol=1e-4)


def test_turns_that_no_distance_shows():
    """Places that face each other: turns of the table change no distance between them."""
    opposite = on_circle(2, spacing_deg=180.0)
    rows = scene(np.random.default_rng(4), places=opposite, mounted=0.0, curves=(0.0, 0.0)).rows
    found = solve(SixProblem(**rows, tilt_std=1e-4))
    assert found.std["EXC"].max() < 3e-7
    with pytest.raises(ObservabilityError, match="state scatter_translation_std and"):
        solve(SixProblem(**rows, tilt_std=1e-4, scatter_translation_std=1e-7))


@pytest.mark.parametrize(("arrivals", "n_contrasts"), [(1, 33), (2, 141)])
def test_counts_of_contrasts(arrivals, n_contrasts):
    rows = scene(np.random.default_rng(3), arrivals=arrivals, scatter=(1e-7, 5e-7)).rows
    assert adjust(SixProblem(**rows)).scatter.n_contrasts == n_contrasts


@pytest.mark.slow
def test_two_arrivals_halve_the_error_of_the_estimate():
    error = {}
    for arrivals in (1, 2):
        found = []
        for seed in range(14 if LONG else 8):
            rows = scene(np.random.default_rng(seed), arrivals=arrivals, scatter=(4e-7, 2e-6)).rows
            scatter = adjust(SixProblem(**rows)).scatter
            found.append(np.hypot(scatter.translation, 0.15 * scatter.rotation) / 5e-7)
        error[arrivals] = np.sqrt(np.mean((np.array(found) - 1.0) ** 2))
    assert error[1] < 0.25
    assert error[2] < 0.75 * error[1]


def test_a_stated_scatter_is_believed_until_the_places_contradict_it():
    rows = scene(np.random.default_rng(5), scatter=(4e-7, 2e-6)).rows
    wrong = solve(SixProblem(**rows, **NONE))
    assert wrong.verdict == "suspect"
    assert any("stated scatter of the table" in text for text in wrong.warnings)
    assert wrong.details["scatter"]["estimated"]
    right = solve(SixProblem(**rows, scatter_translation_std=4e-7, scatter_rotation_std=2e-6))
    assert right.verdict == "ok"
    assert not right.details["scatter"]["estimated"]


def test_known_scatter_needs_no_enlargement_and_a_wide_posterior_does():
    variance, slope = np.ones(2), np.array([[1.0, 0.5], [0.0, 0.0]])
    assert enlargement(stated(1.0, 0.0), (1.0, 0.0), variance, slope).tolist() == [1.0, 1.0]
