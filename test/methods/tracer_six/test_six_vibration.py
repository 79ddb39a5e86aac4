"""Lines in what a table that turned leaves of lengths from three places."""

from dataclasses import replace

import numpy as np
import pytest
from six_turning_scene import ARCSEC, DEGREE, six_turning_scene
from test_six_turning import CORRELATED, WHITE, problem_of

from rotcal_ros.methods.tracer_six.method import METHOD
from rotcal_ros.methods.tracer_six.solver.solve import adjust, result_of

SIZE, HERTZ = 90e-9, 0.5


def lines_of(scene, std):
    result = result_of(adjust(problem_of(scene, std)))
    return result, result.details["turning"]["lines"]


@pytest.mark.slow
@pytest.mark.parametrize(("correlated_s", "std"), [(0.0, WHITE), (0.1, CORRELATED)])
def test_a_vibration_is_named_with_its_frequency_and_noise_is_not(correlated_s, std):
    scene = six_turning_scene(60, angles=36, correlated_s=correlated_s)
    _, lines = lines_of(scene, std)
    assert lines == []
    phase = np.random.default_rng(0).uniform(0.0, 2.0 * np.pi, 24)[scene.turn]
    time = scene.angles[scene.angle] / scene.speed
    size = SIZE * std / WHITE
    shakes = size * np.cos(2.0 * np.pi * HERTZ * time + phase)
    result, lines = lines_of(replace(scene, length=scene.length + shakes), std)
    assert {np.sign(line["speed"]) for line in lines} == {-1.0, 1.0}
    for line in lines:
        assert line["frequency"] == pytest.approx(HERTZ, rel=1e-6)
        assert line["order"] == pytest.approx(HERTZ * 2.0 * np.pi / (12.0 * DEGREE), rel=1e-6)
        assert 0.3 * size < line["amplitude"] < 1.1 * size  # places take up a part of it
        assert line["likeness"] < 0.8
    assert any("hold a line at order 15" in warning for warning in result.warnings)
    (table,) = (t for t in METHOD.tables(result) if t.name == "lines")
    ecc = dict(zip(table.head, table.rows[0], strict=True))["ECC_arcsec"]
    assert ecc == pytest.approx(lines[0]["amplitude"] / 0.15 / ARCSEC, rel=0.01)
