"""What a file demands of the rows, and what the rules make of them."""

import numpy as np
import pytest
from compensation_examples import even, two_ways

from rotcal_ros.compensation.controller_files import (
    PeriodicTable,
    columns_deg,
    even_interval_deg,
    fixed,
    interpolate_periodically,
    require_at_most,
    require_zero_at_start,
)
from rotcal_ros.compensation.linuxcnc import load_as_linuxcnc
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import ARCSEC, DEGREE

UP, DOWN = Approach.POSITIVE, Approach.NEGATIVE


@pytest.mark.parametrize(
    ("value", "decimals", "text"),
    [(0.0, 2, "0.00"), (-0.0, 2, "0.00"), (-0.004, 2, "0.00"), (-0.006, 2, "-0.01"),
     (-1.0, 0, "-1"), (0.5, 1, "0.5"), (12.3456, 3, "12.346")],
)  # fmt: skip
def test_a_number_has_no_negative_zero(value, decimals, text):
    assert fixed(value, decimals) == text


@pytest.mark.parametrize(("first", "text"), [(0.9e-9, None), (1.1e-9, "6.30254e-08"),
                                             (0.25, "14.3239")])  # fmt: skip
def test_the_first_row_of_a_turn_stands_at_zero(first, text):
    angles = even(8) + first
    table = two_ways(8, angles=angles)
    if text is None:
        degrees, up, down = columns_deg(table)
        np.testing.assert_allclose(degrees, np.append(np.rad2deg(angles), 360.0))
        np.testing.assert_allclose(np.deg2rad(up[[0, -1]]), table.correction_forward[0])
        np.testing.assert_allclose(np.deg2rad(down[[0, -1]]), table.correction_reverse[0])
        return
    with pytest.raises(ConfigurationError, match=rf"is at {text} deg and a controller's"):
        columns_deg(table)


@pytest.mark.parametrize(
    ("rows", "step", "expected"),
    [(36, 1.0, 10.0), (36, 0.001, 10.0), (7, 1.0, "such as 51.4285714|72 or 60|60 or 45"),
     (36, 4.0, "holds its spacing in whole steps of 4 deg and 36 rows are 10 deg apart: choose "
      "a spacing such as 12 or 8"), (100, 1.0, "such as 4 or 3")],
)  # fmt: skip
def test_a_spacing_in_whole_steps(rows, step, expected):
    table = two_ways(rows)
    if isinstance(expected, float):
        assert even_interval_deg(table, "Test", step) == expected
        return
    with pytest.raises(ConfigurationError, match=expected):
        even_interval_deg(table, "Test", step)


def test_rows_that_are_not_even_are_told_with_spacings_nearby():
    """A row of 36 moved by 2e-7 degrees is uneven, by 0.5e-7 it is not."""
    for off, uneven in ((2e-7, True), (0.5e-7, False)):
        angles = even(36)
        angles[7] += np.deg2rad(off)
        table = two_ways(36, angles=angles)
        if not uneven:
            assert even_interval_deg(table, "Test", 0.5) == 10.0
            continue
        words = r"up to 10 deg apart\) are not: choose a spacing that divides 360, such as 10"
        with pytest.raises(ConfigurationError, match=words):
            even_interval_deg(table, "Test", 0.5)


@pytest.mark.parametrize(("share", "fits"), [(0.5, True), (0.5001, False), (-0.5, True)])
def test_a_table_of_the_machine_zero_may_be_half_a_step_off_there(share, fits):
    table = two_ways(correction_forward=np.full(24, share * 2.0**-16))
    if fits:
        require_zero_at_start(table, "Test", 2.0**-16)
        return
    words = rf"Test counts .* the table is {share * 2.0**-16 / ARCSEC:.4g} arcsec there: move"
    with pytest.raises(ConfigurationError, match=words):
        require_zero_at_start(table, "Test", 2.0**-16)


def test_as_many_as_there_is_room_for():
    require_at_most(7, 7, "rows", "a hint")
    with pytest.raises(ConfigurationError, match=r"^rows: 8, and the controller holds 7: a hint$"):
        require_at_most(8, 7, "rows", "a hint")


def test_a_periodic_rule_repeats_and_scales():
    rows, values = np.array([0.0, 90.0, 360.0]), np.array([0.0, 9.0, 0.0])
    at = np.array([45.0, 405.0, -315.0, 225.0, 0.0, 360.0]) * DEGREE
    expected = [4.5, 4.5, 4.5, 4.5, 0.0, 0.0]
    np.testing.assert_allclose(interpolate_periodically(at, rows, values), expected, atol=1e-9)
    table = PeriodicTable("f", rows, values, -values, -2.0)
    np.testing.assert_allclose(table.correction(at, UP), np.multiply(expected, -2.0), atol=1e-9)
    np.testing.assert_allclose(table.correction(at, DOWN), np.multiply(expected, 2.0), atol=1e-9)


@pytest.mark.parametrize(
    ("rows", "up", "down", "words"),
    [
        ([0, 360], [1, 1], [2, 2], None),
        ([0], [1], [1], "expected positions that ascend from 0 to 360"),
        ([0, 180, 180, 360], [0] * 4, [0] * 4, "expected positions that ascend"),
        ([1, 360], [0, 0], [0, 0], "expected positions that ascend"),
        ([0, 359], [0, 0], [0, 0], "expected positions that ascend"),
        ([0, 360], [0, 0, 0], [0, 0], "f: 3 values for 2 positions"),
        ([0, 360], [0, 0], [0], "f: 1 values for 2 positions"),
        ([0, 360], [0, 1], [0, 0], "f does not close: it holds 0 at 0 and 1 at 360 deg"),
        ([0, 360], [0, 0], [3, 4], "f does not close: it holds 3 at 0 and 4 at 360 deg"),
    ],
)
def test_a_periodic_table_is_a_whole_turn_that_closes(rows, up, down, words):
    given = "f", np.array(rows, float), np.array(up), np.array(down), 1.0
    if words is None:
        assert PeriodicTable(*given).unit == 1.0
        return
    with pytest.raises(BagError, match=words):
        PeriodicTable(*given)


@pytest.mark.parametrize(
    ("line", "values"),
    [
        ("0 1 2", [0.0, 1.0, 2.0]),
        ("  +1.5\t-2e-3  .25 rest", [1.5, -0.002, 0.25]),
        ("1E1 2.e+1 3e1", [10.0, 20.0, 30.0]),
        ("1 2", None),
        ("1,2,3", None),
        ("1 2 x", None),
        ("", None),
    ],
)
def test_three_numbers_as_the_c_library_scans_them(line, values):
    loaded = load_as_linuxcnc(line + "\n", 1)
    if values is None:
        assert len(loaded.nominal_deg) == 0
        return
    found = [loaded.nominal_deg[0], loaded.forward_deg[0], loaded.reverse_deg[0]]
    assert found == pytest.approx(values)


def test_a_line_is_read_up_to_254_letters():
    assert len(load_as_linuxcnc("1 2" + " " * 250 + "3\n", 1).nominal_deg) == 1
    assert len(load_as_linuxcnc("1 2" + " " * 251 + "3\n", 1).nominal_deg) == 0
