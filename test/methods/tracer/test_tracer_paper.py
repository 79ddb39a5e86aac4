"""The laser tracer paper's own numbers, from its Table 1 to its sigma."""

import numpy as np
import pytest

from rotcal_ros.foundation.units import ARCSEC, DEGREE, MILLIMETRE
from rotcal_ros.geometry.plane import fit_plane
from rotcal_ros.methods.tracer.solver.circle import algorithm_error, printed_scatter, table_motion

TABLE_1 = MILLIMETRE * np.array(
    [
        [-64.9938, -6.6256, 122.5146],
        [-53.0600, -38.1824, 122.5137],
        [-26.9493, -59.5448, 122.5127],
        [6.3444, -64.9883, 122.5125],
        [37.8969, -53.0580, 122.5123],
        [59.2589, -26.9510, 122.5112],
        [64.7067, 6.3400, 122.5104],
        [52.7784, 37.8971, 122.5107],
        [26.6701, 59.2624, 122.5109],
        [-6.6235, 64.7100, 122.5107],
        [-38.1803, 52.7804, 122.5108],
    ]
)
TABLE_2_Z_MM = (
    "122.5133 122.5136 122.5134 122.5128 122.5120 122.5112 122.5106 122.5103 122.5105 122.5110 "
    "122.5118"
)
TABLE_2_Z = MILLIMETRE * np.array(TABLE_2_Z_MM.split(), dtype=float)
TABLE_3 = ARCSEC * np.array([5.9, 0.7, -0.4, -9.9, -9.2, -7.2, 1.0, -0.1, 1.0, 2.9])
COMMANDED = DEGREE * (-145.0 + 30.0 * np.arange(11))


def test_plane_of_table_1():
    plane = fit_plane(TABLE_1)
    assert plane.normal == pytest.approx([1.9405e-5, 1.5739e-5, 1.0], abs=3e-7)
    assert plane.offset == pytest.approx(-122.5119 * MILLIMETRE, abs=5e-8)
    assert -plane.distances(TABLE_1)[0] == pytest.approx(-0.0013 * MILLIMETRE, abs=6e-8)


def test_projection_gives_table_2():
    table_2 = np.column_stack([TABLE_1[:, :2], TABLE_2_Z])
    plane = fit_plane(TABLE_1)
    projected = TABLE_1 - plane.distances(TABLE_1)[:, None] * plane.normal
    assert projected == pytest.approx(table_2, abs=1e-4 * MILLIMETRE)


def test_centre_of_the_circle():
    motion = table_motion(TABLE_1, COMMANDED)
    expected = MILLIMETRE * np.array([-0.1434, -0.1396, 122.5119])
    assert motion.centre == pytest.approx(expected, abs=1e-4 * MILLIMETRE)
    assert motion.radius == pytest.approx(65.1727 * MILLIMETRE, abs=1e-7)


def test_adjacent_deviations_are_table_3():
    motion = table_motion(TABLE_1, COMMANDED)
    assert motion.adjacent == pytest.approx(TABLE_3, abs=0.2 * ARCSEC)


def test_cumulative_deviations_sum_the_adjacent_ones():
    motion = table_motion(TABLE_1, COMMANDED)
    assert motion.cumulative[0] == 0.0
    assert motion.cumulative[1:] == pytest.approx(np.cumsum(motion.adjacent), abs=1e-12)
    assert motion.cumulative[-1] == pytest.approx(-15.4 * ARCSEC, abs=0.3 * ARCSEC)


def test_scatter_counts_deviations_not_stations():
    motion = table_motion(TABLE_1, COMMANDED)
    assert printed_scatter(motion.adjacent) == pytest.approx(0.88 * ARCSEC, abs=0.005 * ARCSEC)


def test_printed_algorithm_error_does_not_follow_from_its_equation():
    motion = table_motion(TABLE_1, COMMANDED)
    assert motion.tilt == pytest.approx(5.2 * ARCSEC, abs=0.05 * ARCSEC)
    error = algorithm_error(30 * DEGREE, motion.tilt)
    assert abs(error) == pytest.approx(3e-5 * ARCSEC, rel=0.1)
    assert error == pytest.approx(
        np.arctan(np.tan(30 * DEGREE) * np.cos(motion.tilt)) - 30 * DEGREE, abs=1e-15
    )
