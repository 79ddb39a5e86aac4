"""Tables, rows and the stated residual against independent figures."""

import hashlib
import struct
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pytest
from compensation_examples import TAU, d4_table, even, result_of, two_ways, wavy
from scipy.interpolate import CubicSpline

from rotcal_ros.compensation.controller import Controller
from rotcal_ros.compensation.controller_files import mean_deg
from rotcal_ros.compensation.export import residual_budget, simulate
from rotcal_ros.compensation.table import (
    CompensationTable,
    Correction,
    average_directions,
    resample,
    table_from_result,
)
from rotcal_ros.foundation.components import check_axis
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import ARCSEC

UP, DOWN = Approach.POSITIVE, Approach.NEGATIVE


def spline(angles, values):
    """The periodic cubic spline through values of one turn."""
    knots = np.append(angles, angles[0] + TAU)
    return CubicSpline(knots, np.append(values, values[0]), bc_type="periodic")


# The stated residual.


@dataclass(frozen=True)
class Drawn(Controller):
    """A control with steps and sides of one's choice; its files hold nothing."""

    steps: bool = False
    one: bool = False
    value_step: float = 0.0

    def write(self, table, stem):
        return {}

    def read(self, files: Mapping[str, str]):
        return Nothing()

    def resolution(self, table):
        return self.value_step

    @property
    def one_direction(self):
        return self.one

    @property
    def staircase(self):
        return self.steps


class Nothing:
    """A rule that corrects nothing."""

    def correction(self, angle, approach):
        return np.zeros_like(angle)


def truth(table):
    return [spline(table.angles, c) for c in (table.correction_forward, table.correction_reverse)]


FINE = np.linspace(0.0, TAU, 200_001)


def lines(rows, column, fine=FINE):
    knots = np.append(rows.angles, TAU)
    return np.interp(fine, knots, np.append(column, column[0]))


def stairs(rows, column):
    """Both neighbours of every angle between two rows."""
    knots = np.append(rows.angles, TAU)
    values = np.append(column, column[0])
    left = np.clip(np.searchsorted(knots, FINE, side="right") - 1, 0, len(knots) - 2)
    return values[left], values[left + 1]


@pytest.mark.parametrize("one", [False, True])
@pytest.mark.parametrize("steps", [False, True])
@pytest.mark.parametrize("count", [24, 16, 12])
def test_every_part_of_the_residual_is_its_maximum_by_brute_force(count, steps, one):
    """At two hundred thousand angles; the stated part is up to 2 % larger, never smaller."""
    table = two_ways()
    rows = resample(table, TAU / count)
    control = Drawn(steps=steps, one=one, value_step=0.4 * ARCSEC)
    found = residual_budget(table, rows, control, Nothing())
    needed = [curve(FINE) for curve in truth(table)]
    goal, columns = needed, [rows.correction_forward, rows.correction_reverse]
    direction = 0.0
    if one:
        mean = 0.5 * (needed[0] + needed[1])
        goal = [mean - mean[0]] * 2
        direction = np.max(np.abs(np.subtract(needed, goal)))
        mean = 0.5 * (columns[0] + columns[1])
        columns = [mean - mean[0]] * 2
    off = 0.0
    for column, wanted in zip(columns, goal, strict=True):
        for given in stairs(rows, column) if steps else [lines(rows, column)]:
            off = max(off, np.max(np.abs(given - wanted)))
    steepest = max(np.max(np.abs(curve(FINE, 1))) for curve in truth(table))

    def bounds(value, expected):
        assert expected * 0.999 <= value <= expected * 1.021

    bounds(found.before, max(np.max(np.abs(values)) for values in needed))
    bounds(found.interpolation, off)
    bounds(found.direction, direction)
    assert found.rounding == pytest.approx(0.2 * ARCSEC)
    before = found.before + found.interpolation + found.rounding + found.direction
    bounds(found.second_order, steepest * before)
    assert found.std == 0.5 * ARCSEC
    assert found.simulated == pytest.approx(found.before, rel=1e-9)  # nothing was corrected


@pytest.mark.parametrize("place", [1e-6, 3e-5])
def test_a_rounded_position_moves_the_value_by_the_slope(place, monkeypatch):
    table = two_ways()
    monkeypatch.setattr(Drawn, "position_resolution", place)
    found = residual_budget(table, table, Drawn(), Nothing())
    steepest = max(np.max(np.abs(curve(FINE, 1))) for curve in truth(table))
    assert steepest * place <= found.rounding <= 1.03 * steepest * place


class Known:
    """A rule that is off by some figure in one turn and direction."""

    def __init__(self, table, turn, approach, off):
        self.curve = Correction(table)
        self.turn, self.approach, self.off = turn, approach, off

    def correction(self, angle, approach):
        right = self.curve(angle, approach)
        for _ in range(50):  # the correction at the angle that is reached
            right = self.curve(angle + right, approach)
        wrong = (np.floor(angle / TAU + 1e-9) == self.turn) & (approach is self.approach)
        return right + np.where(wrong, self.off, 0.0)


@pytest.mark.parametrize("approach", [UP, DOWN])
@pytest.mark.parametrize(("turn", "seen"), [(-2, False), (-1, True), (0, True), (1, True)])
def test_every_turn_of_the_travel_is_simulated_from_both_sides(turn, approach, seen):
    """The travel of a control that wraps is proven from -360 to 720 degrees."""
    table = two_ways()
    grid = np.linspace(0.0, TAU, 500)[:-1]
    off = 2.0 * ARCSEC
    found = simulate(table, Drawn(), Known(table, turn, approach, off), grid)
    assert found == pytest.approx(off if seen else 0.0, rel=2e-3, abs=1e-12)


def test_an_arc_is_simulated_once_and_not_beyond_its_ends():
    angles = np.deg2rad(np.arange(0.0, 91.0, 10.0))
    table = table_from_result(result_of(angles, wavy(angles)), reference_angle=0.0)
    curve = CubicSpline(angles, table.correction_forward)

    class Held:
        def correction(self, angle, approach):
            return np.interp(angle, angles, table.correction_forward)

    grid = np.linspace(angles[0], angles[-1], 3000)
    moved = np.clip(grid + Held().correction(grid, UP), angles[0], angles[-1])
    expected = np.max(np.abs(Held().correction(grid, UP) - curve(moved)))
    assert simulate(table, Drawn(), Held(), grid) == pytest.approx(expected, rel=1e-9)


# Other rows, another reference, one direction.


@pytest.mark.parametrize("spacing", [None, TAU / 30])
@pytest.mark.parametrize("reference", [None, 1.0, TAU + 1.0])
def test_other_rows_and_reference_in_one_go(spacing, reference):
    table = two_ways()
    found = resample(table, spacing, reference_angle=reference)
    rows = table.angles if spacing is None else np.arange(30) * spacing
    up, down = truth(table)
    zero = 0.0 if reference is None else up(1.0)
    np.testing.assert_allclose(found.angles, rows, atol=1e-14)
    np.testing.assert_allclose(found.correction_forward, up(rows) - zero, atol=1e-15)
    np.testing.assert_allclose(found.correction_reverse, down(rows) - zero, atol=1e-15)
    assert found.reference_angle == pytest.approx(0.0 if reference is None else 1.0)
    basis = np.column_stack([spline(table.angles, unit)(np.append(rows, 1.0))
                             for unit in np.eye(24)])  # fmt: skip
    weights = basis[:-1] - (0.0 if reference is None else basis[-1])
    np.testing.assert_allclose(found.std, np.abs(weights) @ table.std, rtol=1e-9, atol=1e-20)
    assert (found.axis, found.method, found.warnings) == ("C", "m", ("known",))
    if spacing is None and reference is None:
        assert found is table


def test_an_arc_is_counted_from_any_angle_in_it():
    angles = np.deg2rad(np.arange(-90.0, 31.0, 10.0))
    table = table_from_result(result_of(angles, wavy(angles)))
    found = resample(table, reference_angle=np.deg2rad(-40.0))
    assert found.reference_angle == np.deg2rad(-40.0)
    expected = wavy(np.deg2rad(-40.0)) - wavy(angles)
    np.testing.assert_allclose(found.correction_forward, expected, atol=1e-12)


def test_the_mean_of_both_directions_is_zero_at_the_reference():
    table = two_ways(reference_angle=even(24)[3])
    found = average_directions(table)
    mean = (table.correction_forward + table.correction_reverse) / 2.0
    mean = mean - mean[3]
    np.testing.assert_allclose(found.correction_forward, mean, atol=1e-18)
    np.testing.assert_allclose(found.correction_reverse, mean, atol=1e-18)
    left = max(np.max(np.abs(table.correction_forward - mean)),
               np.max(np.abs(table.correction_reverse - mean)))  # fmt: skip
    words = f"mean of both directions: up to {left / ARCSEC:.3g} arcsec of reversal remain"
    assert found.warnings == ("known", words)
    np.testing.assert_allclose(mean_deg(table)[:-1], np.rad2deg(mean), atol=1e-16)
    same = replace(table, correction_reverse=table.correction_forward)
    assert average_directions(same) is same


# A table by itself.


@pytest.mark.parametrize(
    ("angles", "period", "fits"),
    [
        ([0.0, 1.0], TAU, True),
        ([0.0, 1.0], TAU + 0.5e-12, True),
        ([0.0, 1.0], TAU + 3e-12, False),
        ([0.0, 1.0], 0.0, True),
        ([3.5, 5.0], TAU, True),
        ([0.0], TAU, False),
        ([0.0, TAU - 1e-8], TAU, True),
        ([0.0, TAU - 1e-10], TAU, False),
        ([0.0, TAU], 0.0, True),
        ([1.0, 1.0], 0.0, False),
        ([1.0, 0.5], TAU, False),
    ],
)
def test_angles_of_a_table(angles, period, fits):
    columns = dict.fromkeys(("correction_forward", "correction_reverse", "std"),
                            np.zeros(len(angles)))  # fmt: skip
    given = {**vars(d4_table()), **columns, "angles": np.array(angles), "period": period}
    if fits:
        assert CompensationTable(**given).closed == (period > 0.0)
        return
    with pytest.raises(DataError, match=r"^compensation table: "):
        CompensationTable(**given)


@pytest.mark.parametrize(("name", "fits"), [
    ("C", True), ("C1", True), ("A_B9", True), ("A" * 16, True), ("A" * 17, False), ("", False),
    ("c", False), ("1C", False), ("_C", False), ("C-1", False), ("C ", False), ("Ca", False),
])  # fmt: skip
def test_names_of_axes(name, fits):
    if fits:
        assert check_axis(name) == name
        return
    with pytest.raises(ConfigurationError, match="axis name"):
        check_axis(name)


def test_the_hash_is_documented_by_its_bytes():
    """SHA-256 over names, each ended by a zero byte, and little-endian doubles."""
    table = two_ways(4)
    text = b"C\0m\0ok\0"
    numbers = [TAU, 0.0, 4.0, *table.angles, *table.correction_forward,
               *table.correction_reverse, *table.std]  # fmt: skip
    expected = hashlib.sha256(text + struct.pack(f"<{len(numbers)}d", *numbers)).hexdigest()
    assert table.table_hash == expected


def test_a_table_of_a_result_names_axis_and_method_and_keeps_its_warnings():
    result = replace(result_of(even(12), wavy(even(12))), warnings=("first",))
    table = table_from_result(result)
    assert (table.axis, table.method, table.warnings) == ("C", "simulated", ("first",))
    assert table.reference_angle == 0.0
    assert table_from_result(result, axis="B").axis == "B"
    turned = table_from_result(result_of(even(12) - 3.0, np.zeros(12)))
    assert turned.reference_angle == pytest.approx(TAU - 3.0)
