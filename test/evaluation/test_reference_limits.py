"""Reference tables: the numbers, what may differ at 360 degrees, and how near a face has to be."""

import numpy as np
import pytest
from text_tables import table_in

from rotcal_ros.evaluation.reference import read_reference, subtract_polygon
from rotcal_ros.foundation.curves.measured import MeasuredCurve
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.units import ARCSEC

TAU = 2.0 * np.pi


def read(rows, columns=3):
    head = ["angle_deg", "deviation_arcsec", "u_arcsec"][:columns]
    lines = [",".join(map(str, row[:columns])) for row in [head, *rows]]
    return read_reference(
        table_in("\n".join(lines) + "\n", "ref.csv"), 0.0 if columns == 2 else None
    )


def test_rows_in_any_order_become_a_circle_from_zero():
    """-90 degrees is 270; the values go with their angles."""
    found = read([(180, 3, 0.3), (-90, 4, 0.4), (90, 2, 0.2), (0, 1, 0.1)])
    np.testing.assert_allclose(np.rad2deg(found.angles), [0.0, 90.0, 180.0, 270.0])
    np.testing.assert_allclose(found.deviation / ARCSEC, [1.0, 2.0, 3.0, 4.0])
    variance = np.array([0.01, 0.04, 0.09, 0.16]) * ARCSEC**2
    np.testing.assert_allclose(found.covariance, np.diag(variance), rtol=1e-12, atol=0.0)
    assert found.period == TAU


def test_an_arc_keeps_its_angles_and_may_be_stated_to_be_exact():
    found = read([(-30, 1), (20, 3), (0, 2)], columns=2)
    np.testing.assert_allclose(np.rad2deg(found.angles), [-30.0, 0.0, 20.0])
    np.testing.assert_allclose(found.deviation / ARCSEC, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(found.covariance, np.zeros((3, 3)))
    assert found.period == 0.0


@pytest.mark.parametrize("first", [0, 100])
@pytest.mark.parametrize(("last", "fits"), [(29.999, True), (30.001, False), (-9.999, True)])
def test_the_row_a_turn_later_agrees_within_four_standard_uncertainties(first, last, fits):
    """Uncertainties of 3 and 4 arcsec: 20 arcsec of difference."""
    rows = [(first, 10, 3), (first + 120, 1, 1), (first + 240, 2, 1), (first + 360, last, 4)]
    if not fits:
        words = rf"rows at {first} and {first + 360} deg differ by 20 arcsec, expected the same"
        with pytest.raises(DataError, match=words):
            read(rows)
        return
    found = read(rows)
    at = np.sort([first, (first + 120) % 360, (first + 240) % 360])
    np.testing.assert_allclose(np.rad2deg(found.angles), at)
    place = int(np.argmin(np.abs(found.angles - np.deg2rad(first))))
    assert found.deviation[place] / ARCSEC == pytest.approx(10.0)
    assert found.covariance[place, place] / ARCSEC**2 == pytest.approx(9.0)


def test_a_turn_without_uncertainties_has_to_close():
    exact = [(0, 5), (120, 1), (240, 2), (360, 5)]
    assert len(read(exact, columns=2).angles) == 3
    with pytest.raises(DataError, match=r"differ by 0\.001 arcsec"):
        read([*exact[:3], (360, 5.001)], columns=2)


@pytest.mark.parametrize(("rows", "enough"), [(2, False), (3, True)])
def test_three_rows_are_enough(rows, enough):
    given = [(0, 1, 1), (120, 1, 1), (240, 1, 1)][:rows]
    if enough:
        assert len(read(given).angles) == 3
        return
    with pytest.raises(DataError, match=r"ref\.csv: 2 rows, expected at least 3"):
        read(given)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ([(0, 1, 0), (40, 1, 0), (40, 2, 0), (70, 1, 0)], "the angle 40 deg occurs twice"),
        ([(0, 1, 0), (70, 1, 0), (40, 2, 0), (40, 1, 0)], "the angle 40 deg occurs twice"),
        ([(0, 1, 0), (90, 1, -0.5), (180, 1, 0)], r"row 3: the uncertainty is negative: -0.5"),
        (
            [(0, 1, 0), (90, 1, 0), (180, "nan", 0)],
            r"row 4: deviation_arcsec must be .* found 'nan'",
        ),
        ([(0, 1, 0), (90, 1), (180, 1, 0)], r"row 3: expected 3 values .*, found 2"),
        (
            [(0, 1, 0), ("",), (90, 1, 0), (1, "x", 0)],
            r"row 5: deviation_arcsec must be .* found 'x'",
        ),
    ],
)
def test_a_row_that_cannot_be_is_named(rows, words):
    with pytest.raises(DataError, match=rf"ref\.csv.*{words}"):
        read(rows)


def test_a_value_below_zero_is_fine_where_it_is_no_uncertainty():
    found = read([(-10, -1, 0), (0, -2, 0.5), (10, -3, 1)])
    np.testing.assert_allclose(found.deviation / ARCSEC, [-1.0, -2.0, -3.0])
    np.testing.assert_allclose(np.diag(found.covariance) / ARCSEC**2, [0.0, 0.25, 1.0])


def circle(angles, deviation, covariance):
    return MeasuredCurve(np.asarray(angles), np.asarray(deviation), np.asarray(covariance), TAU)


def test_the_faces_are_taken_off_with_their_correlations():
    """A polygon with faces every 90 degrees, read at two angles in another order of rows."""
    rng = np.random.default_rng(2)
    root = rng.normal(size=(4, 4))
    polygon = circle(np.arange(4) * TAU / 4, [1.0, 2.0, 4.0, 8.0], root @ root.T)
    reading = circle([TAU / 2, 3 * TAU / 4], [10.0, 20.0], [[5.0, 1.0], [1.0, 6.0]])
    found = subtract_polygon(reading, polygon)
    np.testing.assert_allclose(found.deviation, [6.0, 12.0])
    faces = (root @ root.T)[2:, 2:]
    np.testing.assert_allclose(found.covariance, np.add([[5.0, 1.0], [1.0, 6.0]], faces))
    np.testing.assert_array_equal(found.angles, reading.angles)
    assert found.period == TAU


@pytest.mark.parametrize("turns", [0, 1, -1])
@pytest.mark.parametrize(
    ("away", "found"), [(0.9e-6, True), (-0.9e-6, True), (1.1e-6, False), (-1.1e-6, False)]
)
def test_a_face_is_there_within_a_microradian_in_any_turn(away, found, turns):
    polygon = circle(np.arange(8) * TAU / 8, np.arange(8.0), np.eye(8))
    reading = circle(np.array([away, 3 * TAU / 8]) + turns * TAU, [5.0, 5.0], np.eye(2))
    if found:
        np.testing.assert_allclose(subtract_polygon(reading, polygon).deviation, [5.0, 2.0])
        return
    with pytest.raises(DataError, match="the polygon has no face for"):
        subtract_polygon(reading, polygon)
