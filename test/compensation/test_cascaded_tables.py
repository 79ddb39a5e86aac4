"""A table on top of another: against two controllers in series that know nothing of tables."""

from dataclasses import replace
from datetime import datetime, timezone

import numpy as np
import pytest
from compensation_examples import TAU, even, result_of
from hypothesis import given, settings
from hypothesis import strategies as st

from rotcal_ros.compensation.cascaded_tables import add_tables, combine_with_table_in_force
from rotcal_ros.compensation.earlier_export import read_earlier
from rotcal_ros.compensation.export import describe_replacement, prepare_export
from rotcal_ros.compensation.held_table import hash_in_force, held_table
from rotcal_ros.compensation.plain_csv import PlainCsv
from rotcal_ros.compensation.table import CompensationTable, table_from_result
from rotcal_ros.compensation.writing import write_files
from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import ARCSEC, DEGREE

NOW = datetime(2025, 1, 1, tzinfo=timezone.utc)
WAYS = (Approach.POSITIVE, Approach.NEGATIVE)
wave = st.tuples(st.integers(1, 5), st.floats(0.5, 40.0), st.floats(0.0, TAU))
waves = st.lists(wave, min_size=1, max_size=3)


class Axis:
    """Harmonics of the true angle and play in the reverse direction, radians."""

    def __init__(self, harmonics, play=0.0):
        self.harmonics, self.play = harmonics, play

    def deviation(self, angle, way):
        total = sum(a * ARCSEC * np.sin(k * angle + p) for k, a, p in self.harmonics)
        return total + self.play * ARCSEC * (way is Approach.NEGATIVE)


class Control:
    """A control with the lines of a CSV file: a straight line between two rows."""

    def __init__(self, files):
        text = next(text for name, text in files.items() if name.endswith(".csv"))
        self.rows = np.loadtxt(text.splitlines()[1:], delimiter=",")

    def moved(self, command, way):
        column = 1 if way is Approach.POSITIVE else 2
        at = np.mod(np.rad2deg(command), 360.0)
        return command + np.interp(at, self.rows[:, 0], self.rows[:, column]) * ARCSEC


def measured(axis, angles, controls=(), measured_on="none", std=0.0, play=0.0):
    """Return the table of a measurement without noise, as seen behind all of ``controls``."""
    seen = []
    for way in WAYS:
        motor = angles
        for control in controls:
            motor = control.moved(motor, way)
        seen.append(motor - angles + axis.deviation(motor, way))
    up, down = (column - seen[0][0] for column in seen)
    both = [
        replace(result_of(angles, column, std), measured_on=measured_on) for column in (up, down)
    ]
    table = table_from_result(both[0])
    return replace(table, correction_reverse=-down)


def exported(table, spacing_deg=10.0):
    return prepare_export(table, "csv", now=NOW, spacing=spacing_deg * DEGREE)


def left(axis, files, angles):
    """Return the range of what is left between the rows too, over both directions."""
    control = Control(files)
    values = [(m := control.moved(angles, way)) - angles + axis.deviation(m, way) for way in WAYS]
    return np.ptp(values)


@settings(max_examples=8, deadline=None)
@given(waves, waves, st.floats(-20.0, 20.0), st.sampled_from([12, 24, 30, 36, 50]))
def test_the_sum_is_what_two_controllers_in_series_do(first, second, play, count):
    held_files = exported(measured(Axis(first, play), even(36))).files
    held = held_table(PlainCsv(), held_files)
    new = measured(Axis(second, play), even(count), measured_on=held.in_force)
    total = add_tables(new, held)
    assert set(np.round(new.angles, 9)) <= set(np.round(total.angles, 9))
    control = Control(held_files)
    for way, further, both in zip(
        WAYS,
        (new.correction_forward, new.correction_reverse),
        (total.correction_forward, total.correction_reverse),
        strict=True,
    ):
        at = np.searchsorted(total.angles, new.angles - 1e-9)
        series = control.moved(new.angles + further, way) - new.angles
        np.testing.assert_allclose(both[at], series, rtol=0.0, atol=1e-13)


@settings(max_examples=4, deadline=None)
@given(waves, st.floats(0.0, 15.0), st.sampled_from([(36, 36), (72, 36), (36, 24), (36, 50)]))
def test_the_second_round_is_not_worse_than_the_first(harmonics, play, counts):
    axis, fine = Axis(harmonics, play), np.linspace(0.0, TAU, 1441)
    first = exported(measured(axis, even(counts[0])))
    control, held = Control(first.files), held_table(PlainCsv(), first.files)
    rest = measured(axis, even(counts[1]), [control], held.in_force)
    second = exported(combine_with_table_in_force(rest, lambda: held))
    once, twice = left(axis, first.files, fine), left(axis, second.files, fine)
    # the straight lines between rows 10 deg apart stay, and so does what the digits hold
    assert twice <= once + 1.1 * first.residual.interpolation + 1e-3 * ARCSEC
    assert twice <= 2.0 * second.residual.stated + 1e-12
    erased = left(axis, exported(replace(rest, measured_on="none")).files, fine)
    assert erased > 3.0 * twice  # what applying it like a first one would have done


def test_a_table_that_was_wrong_is_put_right_by_what_is_measured_on_top_of_it():
    axis, fine = Axis([(1, 30.0, 0.4), (3, 6.0, 1.0)], 5.0), np.linspace(0.0, TAU, 1441)
    wrong = exported(measured(Axis([(1, 24.0, 0.5), (2, 9.0, 0.0)], 2.0), even(36)), 5.0)
    held = held_table(PlainCsv(), wrong.files)
    rest = measured(axis, even(36), [Control(wrong.files)], held.in_force)
    assert left(axis, wrong.files, fine) > 20.0 * ARCSEC
    right = exported(combine_with_table_in_force(rest, lambda: held), 5.0)
    assert left(axis, right.files, fine) <= 2.0 * right.residual.stated < 1.0 * ARCSEC


def test_the_uncertainty_is_that_of_the_new_measurement_as_drawn_at_random():
    steep = Axis([(3, 20_000.0, 0.3)])  # absurd, so that the slope of the table shows
    held = held_table(PlainCsv(), exported(measured(steep, even(72)), 5.0).files)
    angles, std = even(36), 2.0 * ARCSEC
    draws = np.random.default_rng(3).normal(size=(4000, 36)) * std
    draws -= draws[:, :1]
    base = np.zeros((4000, 36)) + 30.0 * ARCSEC * np.sin(angles)
    sums = (n := base + draws) + held.correction(angles + n, Approach.POSITIVE)
    result = replace(result_of(angles, -base[0], std), measured_on=held.in_force)
    total = add_tables(table_from_result(result), held)
    at = np.searchsorted(total.angles, angles - 1e-9)
    drawn = np.std(sums, axis=0)
    np.testing.assert_allclose(total.std[at][1:], drawn[1:], rtol=0.06)
    assert np.ptp(drawn[1:] / (np.sqrt(2.0) * std)) > 0.3


def test_the_zero_stays_that_of_the_table_in_force():
    axis = Axis([(1, 30.0, 0.4)])
    first = measured(axis, even(36))
    files = prepare_export(first, "csv", now=NOW, reference_angle=90.0 * DEGREE).files
    held = held_table(PlainCsv(), files)
    total = add_tables(measured(axis, even(36), [Control(files)], held.in_force), held)
    assert total.reference_angle == pytest.approx(np.pi / 2)
    assert total.correction_forward[9] == pytest.approx(0.0, abs=1e-15)
    assert np.max(np.abs(total.correction_forward - held.correction(total.angles, WAYS[0]))) < (
        1e-2 * ARCSEC
    )


def small(**changes):
    table = measured(Axis([(1, 5.0, 0.0)]), even(12), measured_on="unknown", std=0.1 * ARCSEC)
    return replace(table, **changes)


def held_small():
    return held_table(PlainCsv(), exported(small(measured_on="none")).files)


@pytest.mark.parametrize(
    ("measured_on", "word", "there", "reason"),
    [
        ("unknown", "as_measured", True, "not known which table was in force.*Say which"),
        ("none", "add", True, "not added: measured with no table in force"),
        ("held", "replace", True, "not replaced.*lose what it corrects"),
        ("held", "as_measured", False, "there is no table to add to"),
        ("unknown", "add", False, "there is no table to add to"),
        ("a" * 64, "as_measured", True, "not added.*aaaaaaaaaaaa.*the one to add to is"),
        ("a" * 64, "add", True, "measure again with what the controller holds now"),
    ],
)
def test_a_wrong_combination_is_refused_with_the_reason(measured_on, word, there, reason):
    held = held_small()
    table = small(measured_on=held.in_force if measured_on == "held" else measured_on)
    with pytest.raises(DataError, match=reason):
        combine_with_table_in_force(table, lambda: held if there else None, word)


@pytest.mark.parametrize(
    ("measured_on", "word", "words"),
    [
        ("none", "as_measured", "replaces the table in force"),
        ("none", "replace", "replaces the table in force"),
        ("unknown", "replace", "replaces the table in force; not known"),
        ("unknown", "add", "adds to the table"),
        ("held", "as_measured", "adds to the table"),
        ("held", "add", "adds to the table"),
    ],
)
def test_what_fits_is_taken_and_told(measured_on, word, words):
    held = held_small()
    table = small(measured_on=held.in_force if measured_on == "held" else measured_on)
    table = replace(
        table, correction_forward=np.roll(table.correction_forward, 3)
    )  # another shape
    done = combine_with_table_in_force(table, lambda: held, word)
    assert describe_replacement(done).startswith(words)
    on_word = any("the word of a person" in warning for warning in done.warnings)
    assert on_word == (measured_on == "unknown")
    if done.adds_to:
        with pytest.raises(DataError, match="contains the table"):
            combine_with_table_in_force(done, lambda: held, "add")


def test_what_a_table_left_is_never_written_alone():
    with pytest.raises(DataError, match="alone it would lose"):
        exported(small(measured_on="b" * 64))


def test_an_arc_is_not_added_to_a_circle():
    arc = replace(small(), period=0.0, measured_on=held_small().in_force)
    arc = replace(arc, correction_forward=np.roll(arc.correction_forward, 3))  # another shape
    with pytest.raises(DataError, match="one in force covers the full circle"):
        combine_with_table_in_force(arc, held_small)


def test_tables_without_this_knowledge_keep_their_hash():
    rows = even(4)
    table = CompensationTable("C", "m", rows, *[np.zeros(4)] * 3, TAU, 0.0, "ok")
    assert table.measured_on == "unknown"
    assert replace(table, measured_on="").table_hash == table.table_hash
    assert replace(table, measured_on="none").table_hash != table.table_hash


def test_both_directions_are_measured_on_the_same_table():
    one, other = (replace(result_of(even(12), even(12) * 0), measured_on=m * 64) for m in "ab")
    with pytest.raises(DataError, match="measure both directions with the same table"):
        table_from_result(one, reverse=other)
    assert table_from_result(one, reverse=one).measured_on == "a" * 64
    unknown = replace(one, measured_on="unknown")
    assert table_from_result(one, reverse=unknown).measured_on == "unknown"


def test_an_earlier_export_is_read_whole_or_not_at_all(tmp_path):
    export = exported(small(measured_on="none"))
    write_files(export.files, tmp_path)
    held = read_earlier(tmp_path, "csv", "C")
    assert held.in_force == hash_in_force(export.files)
    at = np.linspace(-7.0, 7.0, 300)
    expected = [Control(export.files).moved(at, way) - at for way in WAYS]
    for way, values in zip(WAYS, expected, strict=True):
        np.testing.assert_allclose(held.correction(at, way), values, atol=1e-14)
    with pytest.raises(ConfigurationError, match="holds 0 tables of axis A"):
        read_earlier(tmp_path, "csv", "A")
    (tmp_path / "c_csv.csv").write_text("changed")
    with pytest.raises(BagError, match="was changed since it was written"):
        read_earlier(tmp_path, "csv", "C")


def test_a_side_file_of_a_schema_that_is_not_known_is_refused(tmp_path):
    """Its entries may mean something else: neither its numbers nor its names are believed."""
    write_files(exported(small(measured_on="none")).files, tmp_path)
    side = next(tmp_path.glob("*.provenance.json"))
    text = side.read_text()
    assert '"schema": 1,' in text
    side.write_text(text.replace('"schema": 1,', '"schema": 2,'))
    with pytest.raises(BagError, match="its schema is 2, expected 1"):
        read_earlier(tmp_path, "csv", "C")
    files = {path.name: path.read_text() for path in tmp_path.iterdir()}
    with pytest.raises(DataError, match="of another schema; measure without"):
        held_table(PlainCsv(), files)
