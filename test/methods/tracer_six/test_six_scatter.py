"""Scatter from run to run: found, tested, and in the uncertainty."""

import numpy as np
import pytest
from chances import LONG
from coded import coded
from six_coverage import KINDS, TWELVE, coverage
from six_scene import on_circle, scene

from rotcal_ros.adjust.engine import SCATTERS
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.methods.tracer_six.solver import SixProblem, adjust, solve

LEAST = 0.92 if LONG else 0.9
NONE = {"scatter_translation_std": 0.0, "scatter_rotation_std": 0.0}


@pytest.mark.slow
def test_intervals_hold_without_scatter():
    found = coverage(60 if LONG else 20, (0.0, 0.0), seed=1, slip=0.0, **NONE)
    assert (found.share > LEAST).all()
    assert (found.share < (0.975 if LONG else 0.99)).all()


@pytest.mark.slow
def test_intervals_hold_with_scatter_that_is_estimated():
    found = coverage(40 if LONG else 12, (1e-7, 5e-7), seed=2, slip=0.0)
    assert (found.share > LEAST).all()
    ignored = coverage(15 if LONG else 8, (1e-7, 5e-7), seed=2, ignored=True)
    assert ignored.share.mean() < 0.85


def test_intervals_hold_where_the_estimate_has_nothing_to_find():
    """Uncertainties (um, urad) of the same lengths with the scatter known to be none beside."""
    runs = 60 if LONG else 6
    found = coverage(runs, (0.0, 0.0), seed=6, slip=0.0)
    assert (found.share > (0.94 if LONG else 0.88)).all()
    assert (found.std < 1.3 * 0.5e-6 * np.array([0.078, 0.080, 0.072, 0.650, 0.653, 0.554])).all()
    found = coverage(4, (0.0, 0.0), arrivals=2, chosen=TWELVE, seed=7, slip=0.0)
    assert (found.std < 1.06 * 0.5e-6 * np.array([0.076, 0.082, 0.072, 0.653, 0.652, 0.555])).all()


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_intervals_hold_whatever_scatters(kind):
    found = coverage(60 if LONG else 20, KINDS[kind], seed=8, slip=0.0)
    assert (found.share > LEAST).all()


@pytest.mark.slow
def test_intervals_hold_with_two_arrivals():
    options = {"arrivals": 2, "chosen": TWELVE, "slip": 0.0}
    found = coverage(40 if LONG else 24, KINDS["turns"], seed=9, **options)
    assert (found.share > LEAST).all()


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
    (sizes,) = adjust(SixProblem(**rows)).found.fit.sizes.values()
    assert sizes.contrasts == n_contrasts


@pytest.mark.slow
def test_two_arrivals_halve_the_error_of_the_estimate():
    error = {}
    for arrivals in (1, 2):
        found = []
        for seed in range(14 if LONG else 8):
            rows = scene(np.random.default_rng(seed), arrivals=arrivals, scatter=(4e-7, 2e-6)).rows
            (sizes,) = adjust(SixProblem(**rows)).found.fit.sizes.values()
            found.append(sizes.median_size / 5e-7)
        error[arrivals] = np.sqrt(np.mean((np.array(found) - 1.0) ** 2))
    assert error[1] < 0.25
    assert error[2] < 0.75 * error[1]


def test_a_stated_scatter_is_believed_until_the_places_contradict_it():
    rows = scene(np.random.default_rng(5), scatter=(4e-7, 2e-6)).rows
    wrong = solve(SixProblem(**rows, scatter_translation_std=1e-7, scatter_rotation_std=5e-7))
    assert wrong.verdict == "suspect"
    assert "the arrivals" in [what for what, _ in coded(*wrong.warnings)[SCATTERS]]
    right = solve(SixProblem(**rows, scatter_translation_std=4e-7, scatter_rotation_std=2e-6))
    assert right.verdict == "ok"
