"""Beams of one arrival that are off together: found, left out, named by place and position."""

import sys
from pathlib import Path

import numpy as np
import pytest
from six_scene import scene

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.methods.tracer_six.solver import SixProblem, solve

sys.path.insert(0, str(Path(__file__).parents[1]))
from gathered_worlds import chosen

KNOWN = {"scatter_translation_std": 0.0, "scatter_rotation_std": 0.0}
N = 24


def disturbed(seed, size, pattern="sector", zero="per_run"):
    """Ten of the 24 beams of one arrival are `size` (m) too long; rows, and which they are."""
    rng = np.random.default_rng(seed)
    truth = scene(rng, m=8, zero=zero)
    rows = truth.rows
    station = int(rng.integers(len(rows["length"]) // N))
    mine = np.arange(N * station, N * (station + 1))
    angle, place = rows["table_angles"][rows["position"][mine[0]]], rows["place"][mine[0]]
    x, y, z = rows["places"][place]
    stands = [np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y, z]
    bad = mine[chosen(pattern, 10, rows["targets"] - stands, rng)]
    length = rows["length"].copy()
    length[bad] += size
    return truth, {**rows, "length": length}, bad


@pytest.mark.parametrize("zero", ["per_run", "per_station"])
@pytest.mark.parametrize("pattern", ["sector", "random"])
def test_the_bad_beams_are_left_out_and_named(zero, pattern):
    truth, rows, bad = disturbed(3, 2e-6, pattern, zero)
    result = solve(SixProblem(**rows, **KNOWN))
    assert result.verdict == "suspect"
    assert {one.index for one in result.rejected} == set(bad.tolist())
    place, position = rows["place"][bad[0]], rows["position"][bad[0]]
    said = " ".join(result.warnings)
    assert f"10 of the 24 lengths of place {place}, position {position} are off together" in said
    error = np.array([result.deviations[name] for name in COMPONENTS]) - truth.truth
    std = np.array([result.std[name] for name in COMPONENTS])
    assert (np.abs(error) < 4.5 * std).all()


def test_sound_lengths_are_not_touched():
    for seed in range(3):
        _, rows, _ = disturbed(seed, 0.0)
        result = solve(SixProblem(**rows, **KNOWN))
        assert result.verdict == "ok"
        assert not result.rejected
        assert "one place" in {one.effect for one in result.protections}
