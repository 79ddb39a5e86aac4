"""Lines in what a turning table leaves of its lengths, found beside white and correlated noise."""

from dataclasses import replace

import numpy as np
import pytest
from test_turning_lengths import CORRELATED, WHITE, problem_of
from turning_scene import turning_scene

from rotcal_ros.methods.tracer.method import METHOD
from rotcal_ros.methods.tracer.solver.solution import adjust
from rotcal_ros.methods.tracer.solver.solve import result_of

SIZE, SPEED = 60e-9, 12.0


def lines_of(scene, std=WHITE):
    result = result_of(adjust(problem_of(scene, std)))
    return result, result.details["turning"]["lines"]


@pytest.mark.slow
@pytest.mark.parametrize("std", [WHITE, CORRELATED])
def test_noise_alone_has_no_line(std):
    correlated = 0.3 if std == CORRELATED else 0.0
    for seed in (50, 51):
        scene = turning_scene(seed, angles=72, correlated_s=correlated)
        result, lines = lines_of(scene, std)
        assert lines == []
        assert not any("hold a line" in warning for warning in result.warnings)


@pytest.mark.slow
def test_a_vibration_at_its_own_time_is_named_with_its_frequency():
    scene = turning_scene(0, angles=72)
    phase = np.random.default_rng(0).uniform(0.0, 2.0 * np.pi, 8)[scene.turn]
    shakes = SIZE * np.cos(2.0 * np.pi * 1.137 * scene.time + phase)
    result, lines = lines_of(replace(scene, length=scene.length + shakes))
    assert {np.sign(line["speed"]) for line in lines} == {-1.0, 1.0}
    for line in lines:
        assert line["frequency"] == pytest.approx(1.137, abs=0.5 * SPEED / 360.0)
        assert line["order"] == pytest.approx(line["frequency"] * 360.0 / SPEED, rel=1e-3)
        assert 0.3 * SIZE < line["amplitude"] < 1.1 * SIZE  # places take up a part of it
        assert line["likeness"] < 0.8
    assert any("hold a line at order 34" in warning for warning in result.warnings)
    (table,) = (t for t in METHOD.tables(result) if t.name == "lines")
    radius = result.details["circle"]["radius"]
    ecc = dict(zip(table.head, table.rows[0], strict=True))["ECC_arcsec"]
    assert ecc == pytest.approx(np.rad2deg(lines[0]["amplitude"] / radius) * 3600.0, rel=1e-9)


@pytest.mark.slow
def test_what_comes_back_with_the_angle_is_alike_in_both_directions():
    scene = turning_scene(1, angles=72)
    angle = scene.angles[scene.angle]
    bearing = np.arctan2(scene.nominal[scene.target, 1], scene.nominal[scene.target, 0])
    radial = (
        1.5 * SIZE * np.cos(20.0 * angle) * np.cos(bearing - angle)
    )  # of an axis that runs out
    _, lines = lines_of(replace(scene, length=scene.length + radial))
    assert lines
    assert {round(line["order"]) for line in lines} <= {19, 21}  # seen from targets at rest
    assert all(line["likeness"] > 0.8 for line in lines)
