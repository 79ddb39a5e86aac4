"""Monte Carlo about a measured problem agrees with the stated uncertainty."""

import numpy as np
import pytest
from six_scene import good_targets, on_circle, scene

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.methods.tracer_six.solver import SixProblem, adjust, solve


@pytest.mark.parametrize("known", [0.0, 2e-7])
def test_trials_scatter_as_stated(known):
    rows = scene(np.random.default_rng(1), good_targets()[:14], m=5, scatter=(known, known)).rows
    problem = SixProblem(
        **rows, scatter_translation_std=known, scatter_rotation_std=known, slip=0.0
    )
    result = solve(problem)
    drawn = adjust(problem).trials(np.random.default_rng(2), 120)
    curves = np.concatenate([result.deviations[name] for name in COMPONENTS])
    std = np.concatenate([result.std[name] for name in COMPONENTS])
    assert np.abs(drawn.mean(axis=0) - curves).max() < 5.0 * std.max() / np.sqrt(120)
    ratio = (drawn.std(axis=0) / std).reshape(6, 5)
    assert ratio.mean(axis=1) == pytest.approx(np.ones(6), abs=0.15)


def test_trials_hold_what_is_stated_about_the_tilts():
    """Two places: what the lengths do not determine of the tilts is the prior's."""
    known = {"scatter_translation_std": 0.0, "scatter_rotation_std": 0.0}
    known |= {"tilt_std": 1e-5, "slip": 0.0}
    rows = scene(np.random.default_rng(1), good_targets()[:14], on_circle(2), m=5).rows
    problem = SixProblem(**rows, **known)
    result = solve(problem)
    drawn = adjust(problem).trials(np.random.default_rng(2), 150)
    std = np.concatenate([result.std[name] for name in COMPONENTS])
    ratio = (drawn.std(axis=0) / std).reshape(6, 5)
    assert ratio.mean(axis=1) == pytest.approx(np.ones(6), abs=0.15)
    assert std[15:25].max() > 4e-6


def test_trials_slip_as_often_as_the_uncertainty_holds():
    """One round of lengths: slips that nobody sees add most to EZC."""
    known = {"scatter_translation_std": 0.0, "scatter_rotation_std": 0.0}
    rows = scene(np.random.default_rng(1), good_targets()[:14], m=5).rows
    result, alone = (solve(SixProblem(**rows, **known, slip=slip)) for slip in (0.3164e-6, 0.0))
    drawn = adjust(SixProblem(**rows, **known)).trials(np.random.default_rng(2), 300)
    curves = drawn.reshape(-1, 6, 5).std(axis=0)[2]
    assert curves == pytest.approx(result.std["EZC"], rel=0.2)
    # The lengths say that these did not slip, so that less of the allowance is left (1.2 before).
    assert result.std["EZC"].mean() > 1.15 * alone.std["EZC"].mean()


def test_a_table_that_only_turns_can_be_drawn():
    """What turns alone do to a place has no part along its arm: the covariance is singular."""
    rows = scene(np.random.default_rng(1), good_targets()[:14], m=5).rows
    turning = SixProblem(**rows, scatter_translation_std=0.0, scatter_rotation_std=1e-6)
    assert np.isfinite(adjust(turning).trials(np.random.default_rng(2), 2)).all()
