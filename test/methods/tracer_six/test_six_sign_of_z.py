"""Targets and tracer both typed in a frame whose z points into the table: who can tell?

The world is that of a table with known motions, in a frame with z away from the table.
"""

import numpy as np
import pytest
from coded import coded
from scipy.spatial.transform import Rotation

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.methods.tracer_six.solver import SixProblem, solve
from rotcal_ros.methods.tracer_six.solver.solve import UPSIDE_DOWN

N = 12
ANGLES = 2 * np.pi * np.arange(N) / N
MIRROR = np.array([1.0, 1.0, -1.0])
LEVEL, STEEP = 0.25, 1.5
TURNED = ("EZC", "EAC", "EBC")


def world(height, seed=3):
    """Return targets (k, 3) up to ``height`` (m) above the tracer, places (3, 3), lengths, truth.

    Truth: shifts (N, 3) m and small rotations (N, 3) rad about x, y, z, beside the angle.
    """
    rng = np.random.default_rng(seed)
    around = rng.uniform(0, 2 * np.pi, 20)
    far = rng.uniform(0.45, 0.8, 20)
    targets = np.column_stack([far * np.cos(around), far * np.sin(around), np.zeros(20)])
    targets[:, 2] = 0.1 + rng.permutation(np.linspace(0.15, 1.0, 20)) * height
    places = Rotation.from_rotvec(np.outer([0.2, 2.3, 4.4], [0, 0, 1])).apply([0.14, 0.0, 0.1])
    waves = np.array([np.cos(k * ANGLES + p) for k, p in ((2, 0.3), (3, 1.1), (2, 2.0))]).T
    shift, small = 2e-6 * waves, 2e-5 * waves[:, ::-1]
    lengths = []
    for angle, moved, tilt in zip(ANGLES, shift, small, strict=True):
        turn = Rotation.from_rotvec(tilt) * Rotation.from_euler("z", angle)
        stations = turn.apply(places) + moved
        lengths.append(np.linalg.norm(targets - stations[:, None], axis=2) - 0.3)
    length = np.array(lengths) + 2e-7 * rng.standard_normal((N, 3, 20))
    return targets, places, length, np.column_stack([shift, small])


def solved(height, mirrored=False):
    targets, places, length, truth = world(height)
    mirror = MIRROR if mirrored else 1.0
    position, place, target = np.indices(length.shape).reshape(3, -1)
    problem = SixProblem(
        position=position, place=place, target=target, length=length.ravel(), length_std=2e-7,
        targets=targets * mirror, target_std=1e-6, table_angles=ANGLES, places=places * mirror,
        scatter_translation_std=0.0, scatter_rotation_std=0.0,
    )  # fmt: skip
    return solve(problem), dict(zip(COMPONENTS, truth.T, strict=True))


@pytest.mark.parametrize("height", [LEVEL, STEEP])
@pytest.mark.parametrize("mirrored", [False, True])
def test_a_mirrored_frame_turns_three_of_the_six_and_no_length_tells(height, mirrored):
    result, truth = solved(height, mirrored)
    assert 0.8 < result.sigma0 < 1.2
    for name, curve in truth.items():
        wrong = mirrored and name in TURNED
        error = result.deviations[name] * (-1.0 if wrong else 1.0) - (curve - curve.mean())
        assert np.abs(error / result.std[name]).max() < 4.5, name
        assert np.abs(curve / result.std[name]).max() > 10.0  # a sign that matters


def test_it_is_named_where_nothing_tells():
    """Beams that are nearly level could go past the table, up or down."""
    for mirrored in (False, True):
        result, _ = solved(LEVEL, mirrored)
        assert result.verdict == "ok"
        assert "sign of z" in result.verdict_line


def test_beams_that_would_go_through_the_table_tell():
    good, _ = solved(STEEP)
    assert good.verdict == "ok"
    assert "sign of z" not in good.verdict_line
    wrong, _ = solved(STEEP, mirrored=True)
    assert wrong.verdict == "suspect"
    assert UPSIDE_DOWN in coded(*wrong.warnings)
    assert "sign of z" in wrong.verdict_line
