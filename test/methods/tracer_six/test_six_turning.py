"""Six deviations of a table that turns, from three places: what is true lies within U."""

import numpy as np
import pytest
from six_turning_scene import six_turning_scene

from rotcal_ros.methods.tracer_six.solver.problem import SixProblem
from rotcal_ros.methods.tracer_six.solver.solve import adjust, result_of

WHITE, CORRELATED = 0.035e-6, 0.2e-6
"""Noise of a length from a window of a degree at 1 kHz."""


def problem_of(scene, length_std, **more):
    n = len(scene.angles)
    columns = {
        "position": scene.run * n + scene.angle,
        "target": scene.target,
        "place": scene.place,
        "length": scene.length,
        "length_std": length_std,
        "targets": scene.nominal,
        "target_std": 1e-6,
        "table_angles": np.tile(scene.angles, 2),
        "places": scene.places,
        "order": np.arange(len(scene.length)),
        "zero": "per_segment",
        "segment": scene.turn,
        "slip": 0.0,
        "scatter_translation_std": 0.0,
        "scatter_rotation_std": 0.0,
        "upward": np.repeat([True, False], n),
        "speed": scene.speed,
    }
    return SixProblem(**{**columns, **more})


def normalised(scene, solution):
    """Errors of both runs' curves in their standard uncertainty (6, 2 n)."""
    found, n = solution.deviations(), len(scene.angles)
    design = np.zeros((4 * n, 4))
    both = np.tile(scene.angles, 2)
    design[::2, 0] = design[1::2, 1] = 1.0
    design[::2, 2], design[1::2, 2] = np.cos(both), np.sin(both)
    design[::2, 3], design[1::2, 3] = -np.sin(both), np.cos(both)
    true = scene.true.reshape(6, -1).copy()
    for first in (0, 3):  # what turns with the table, or stands still, defines the axis
        pair = true[first : first + 2].T.ravel()
        pair -= design @ np.linalg.lstsq(design, pair, rcond=None)[0]
        true[first : first + 2] = pair.reshape(-1, 2).T
    true[[2, 5]] -= true[[2, 5]].mean(axis=1, keepdims=True)
    return (found - true) / solution.found.std.reshape(6, -1)


@pytest.mark.parametrize(("seed", "correlated_s", "std"), [(5, 0.0, WHITE), (1, 0.1, CORRELATED)])
def test_all_six_are_within_the_stated_uncertainty(seed, correlated_s, std):
    scene = six_turning_scene(seed, correlated_s=correlated_s)
    solution = adjust(problem_of(scene, std))
    result = result_of(solution)
    assert result.verdict == "ok", result.warnings
    share = (np.abs(normalised(scene, solution)) < 1.96).mean()
    assert share > 0.85
    assert solution.part("lag")[0] == pytest.approx(1e-3, abs=4.0 * 1e-5)
