"""Zeros of unbroken beams: found, tested against what was before, and in the uncertainty."""

import numpy as np
import pytest
from chances import LONG
from six_coverage import coverage
from six_scene import good_targets, scene

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.methods.tracer_six.solver import SixProblem, solve

KNOWN = {"scatter_translation_std": 0.0, "scatter_rotation_std": 0.0}


def curves(result):
    return np.array([result.deviations[name] for name in COMPONENTS])


def test_intervals_hold_with_beams_that_break_at_random():
    found = coverage(
        24 if LONG else 10, (0.0, 0.0), seed=3, zero="per_segment", breaks=4, slip=0.0, **KNOWN
    )
    assert (found.share > (0.91 if LONG else 0.88)).all()
    assert (found.share < (0.985 if LONG else 0.995)).all()


def test_a_segment_per_run_is_the_same_as_a_zero_per_run():
    rows = scene(np.random.default_rng(2), good_targets()[:14], m=5).rows
    one = solve(SixProblem(**rows, **KNOWN))
    other = solve(
        SixProblem(**{**rows, "zero": "per_segment", "segment": 7 - rows["place"]}, **KNOWN)
    )
    np.testing.assert_allclose(curves(one), curves(other), atol=1e-15)
    assert one.details["segments"] == []
    assert [s["segment"] for s in other.details["segments"]] == [7, 6, 5]


def test_a_counter_that_starts_anew_reads_metres_less_and_nothing_is_lost():
    """A beam breaks in the middle of a station; the step is as large as the counter likes."""
    rows = scene(np.random.default_rng(4), m=6).rows
    step = 2.5
    later = (rows["place"] == 1) & (rows["position"] * 24 + rows["target"] >= 60)
    segment = 2 * rows["place"] + later
    length = rows["length"] - step * later
    broken = {**rows, "length": length, "zero": "per_segment", "segment": segment}
    result = solve(SixProblem(**broken, **KNOWN))
    assert (result.verdict, result.rejected) == ("ok", ())
    within = np.abs(curves(result) - curves(solve(SixProblem(**rows, **KNOWN))))
    assert (within < 2.0 * np.array([result.std[name] for name in COMPONENTS])).all()
    first, second = (s for s in result.details["segments"] if s["place_id"] == 1)
    assert (first["lengths"], second["lengths"]) == (60, 84)
    assert second["step"] == pytest.approx(step, abs=5.0 * second["step_std"])
    assert second["step_std"] < 3e-7
    assert second["probability"] < 1e-9


def test_a_break_that_kept_the_zero_has_a_step_that_chance_explains():
    rows = scene(np.random.default_rng(5), m=6).rows
    segment = 2 * rows["place"] + (rows["position"] >= 3)
    result = solve(SixProblem(**{**rows, "zero": "per_segment", "segment": segment}, **KNOWN))
    steps = [s for s in result.details["segments"] if "step" in s]
    assert len(steps) == 3
    assert all(abs(s["step"]) < 4.0 * s["step_std"] for s in steps)
    assert all(s["probability"] > 1e-4 for s in steps)


def test_a_beam_that_breaks_at_every_angle_is_worse_than_an_unbroken_one():
    rows = scene(np.random.default_rng(6), good_targets()[:16], m=5, zero="per_station").rows
    own = solve(SixProblem(**rows, **KNOWN))
    number = {**rows, "zero": "per_segment", "segment": rows["place"] * 5 + rows["position"]}
    same = solve(SixProblem(**number, **KNOWN, slip=0.0))
    np.testing.assert_allclose(curves(own), curves(same), atol=1e-13)
    for name in COMPONENTS:
        np.testing.assert_allclose(own.std[name], same.std[name], rtol=1e-7)
