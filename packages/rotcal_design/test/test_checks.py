"""What the lengths of a plan check of each other, by Baarda's figures and by counting unknowns."""

import numpy as np
import pytest
from tracer_scenes import some_plan

from rotcal_design.tracer.search import length_reliability
from rotcal_ros.methods.tracer.policy.information import Information, Scene, detectable_in_std


def exact(scene):
    """The scene with targets that are known, on a table whose error motion nothing bounds."""
    return Scene(
        scene.stations, scene.table_angles, scene.targets, 1e-15, scene.length_std,
        error_motion_std=1e3,
    )  # fmt: skip


def test_an_undetected_error_does_what_is_said_of_it():
    scene, pairs, chosen = some_plan()
    known = Information(scene, pairs[chosen], 11)
    checks = length_reliability(known, 0.001, 0.8)
    # One length, Baarda's delta0 = 4.13 for 0.001 and 0.80
    assert detectable_in_std(1, 0.001, 0.8) == pytest.approx(4.132, abs=1e-3)
    delta0 = detectable_in_std(len(chosen), 0.001, 0.8)
    assert checks.detectable == pytest.approx(delta0 * 0.2e-6 / np.sqrt(checks.redundancy))
    # With known targets the redundancies add up to the lengths less 4 unknowns per station; the
    # machine's coordinates take a part of them.
    assert 0.0 < checks.redundancy.sum() < len(chosen) - 44
    tight = exact(scene)
    sure = length_reliability(Information(tight, pairs[chosen], 11), 0.001, 0.8)
    assert sure.redundancy.sum() == pytest.approx(len(chosen) - 44, abs=1e-2)


def test_an_error_that_nothing_checks_may_have_any_size():
    # 4 lengths determine a station and its zero: no residual is left where targets are known
    scene, pairs, _chosen = some_plan()
    four = pairs[np.flatnonzero(np.isin(pairs.target, [0, 13, 27, 60]))]
    checks = length_reliability(Information(exact(scene), four, 11), 0.01, 0.8)
    assert (checks.redundancy == 0.0).all()
    assert np.isinf(checks.detectable).all()
    assert np.isinf(checks.share).all()
