"""Tables of many forms: each is read right, or asked about; none is read wrong.

The tables are written here from deviations that this file makes; nothing of the reader is used.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pytest

from rotcal_ros.evaluation.iso230 import read_any_runs
from rotcal_ros.evaluation.reference import read_deviations
from rotcal_ros.foundation.errors import BagError, DataError, RotcalError, UndecidedError
from rotcal_ros.foundation.table_columns import SheetSettings
from rotcal_ros.foundation.units import ARCSEC

ANGLES = np.arange(0.0, 360.0, 30.0)
OFF = np.round(3e-3 * np.sin(np.deg2rad(ANGLES) + 0.7) + 1e-3 * np.cos(np.deg2rad(3 * ANGLES)), 5)
"""Deviations in degrees, with five digits behind the point."""
PAIRS = [
    ("Target", "Actual"), ("Setpoint", "Actual"), ("Reference", "Measured"), ("Nom", "Meas"),
    ("Soll", "Ist"), ("commanded", "actual"), ("Sollwert", "Istwert"), ("Cmd", "Act"),
    ("Sollposition", "Istposition"), ("Target position", "Actual position"),
    ("Programmed", "Observed"), ("Angle", "Actual"), ("consigne", "mesuré"),
    ("指令角度", "実測角度"), ("A tgt", "A act"), ("Requested", "Achieved"), ("C cmd", "C fbk"),
]  # fmt: skip
NO_PAIRS = [("Angle", "Reference"), ("Angle", "Encoder"), ("Set", "Foo")]
"""What the second column is, its name does not say."""


@pytest.mark.parametrize(("separator", "mark"), [(",", "."), (";", ","), ("\t", "."), (" ", ".")])
@pytest.mark.parametrize("title", ["", "# Monday\n", "Calibration\n\n"])
def test_columns_without_any_name_are_stated_by_their_numbers(tmp_path, separator, mark, title):
    rows = zip(degrees(ANGLES, 0), seconds(OFF), strict=True)
    text = "".join(f"{separator.join(row).replace('.', mark)}\n" for row in rows)
    (path := tmp_path / "t.csv").write_text(title + text)
    with pytest.raises(BagError, match=r"no row names the columns.*angle=#1.*deviation=#2"):
        read_deviations(path, 1.0)
    stated = {"columns": ("angle=#1", "deviation=#2")}
    with pytest.raises(UndecidedError, match="states no unit"):
        read_deviations(path, 1.0, SheetSettings(**stated))
    assert_truth(path, **stated, angle_unit="deg", reading_unit="arcsec")


@pytest.mark.parametrize("text", ["P{}", "12:00:{:02}", "ok"])
@pytest.mark.parametrize("first", [True, False])
def test_no_row_is_lost_where_texts_stand_beside_columns_without_names(tmp_path, text, first):
    rows = zip(degrees(ANGLES, 0), seconds(OFF), strict=True)
    lines = [[text.format(k), *row] if first else [*row, text.format(k)]
             for k, row in enumerate(rows)]  # fmt: skip
    (path := tmp_path / "t.csv").write_text("".join(",".join(line) + "\n" for line in lines))
    columns = (f"angle=#{1 + first}", f"deviation=#{2 + first}")
    assert_truth(path, columns=columns, angle_unit="deg", reading_unit="arcsec")


def test_a_stated_column_of_another_quantity_is_refused(tmp_path):
    (path := tmp_path / "t.csv").write_text("angle [deg],length [mm]\n0,1.5\n30,1.7\n60,1.6\n")
    with pytest.raises(DataError, match=r"'length \[mm\]' is in mm, of length and not of angle"):
        read_deviations(path, 1.0, SheetSettings(columns=("deviation=length [mm]",)))


def table(path: Path, head: list[str], columns: list[list[str]], separator: str = ",") -> Path:
    rows = [head, *map(list, zip(*columns, strict=True))]
    (path / "t.csv").write_text("".join(separator.join(row) + "\n" for row in rows), "utf-8")
    return path / "t.csv"


def degrees(values: np.ndarray, digits: int = 5) -> list[str]:
    return [f"{value:.{digits}f}" for value in values]


def seconds(values: np.ndarray) -> list[str]:
    return [f"{3600 * value:.2f}" for value in values]


def sixtieths(values: np.ndarray, mark: str = ".") -> list[str]:
    found = []
    for value in values:
        whole, rest = divmod(round(abs(value) * 3600, 2), 3600)
        text = f"{int(whole)}°{int(rest // 60):02}'{rest % 60:05.2f}\""
        found.append(("-" if value < 0 else "") + text.replace(".", mark))
    return found


def assert_truth(path: Path, **settings: object) -> None:
    curve = read_deviations(path, 1.0, SheetSettings(**settings))
    np.testing.assert_allclose(np.rad2deg(curve.angles), ANGLES, atol=1e-9)
    np.testing.assert_allclose(np.rad2deg(curve.deviation), OFF, atol=3e-6)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize(("commanded", "actual"), PAIRS)
def test_actual_less_commanded_is_the_deviation(tmp_path, commanded, actual, turned) -> None:
    head = [f"{commanded} [deg]", f"{actual} [deg]"]
    columns = [degrees(ANGLES, 1), degrees(ANGLES + OFF)]
    way = -1 if turned else 1
    assert_truth(table(tmp_path, head[::way], columns[::way]))
    three = table(tmp_path, [*head[::way], "Error [arcsec]"], [*columns[::way], seconds(OFF)])
    assert_truth(three)


@pytest.mark.parametrize(("commanded", "actual"), [*PAIRS, *NO_PAIRS])
def test_an_error_of_the_other_sign_is_asked_about(tmp_path, commanded, actual) -> None:
    head = [f"{commanded} [deg]", f"{actual} [deg]", "Error [arcsec]"]
    path = table(tmp_path, head, [degrees(ANGLES, 1), degrees(ANGLES + OFF), seconds(-OFF)])
    with pytest.raises(UndecidedError, match="is commanded - actual") as asked:
        read_deviations(path, 1.0)
    assert asked.value.exit_code == 2
    assert f"column 2 '{head[1]}': first" in asked.value.log
    first, _ = asked.value.question.answers
    assert_truth(path, columns=(first[0],))


@pytest.mark.parametrize("errors", [True, False])
@pytest.mark.parametrize("digits", [0, 1, 5])
@pytest.mark.parametrize(("commanded", "actual"), [("Actual", "Target"), ("Ist", "Soll")])
def test_headings_that_may_be_exchanged_are_asked_about(
    tmp_path, commanded, actual, digits, errors
) -> None:
    head = [f"{commanded} [deg]", f"{actual} [deg]", "Error [arcsec]"][: 2 + errors]
    columns = [degrees(ANGLES, digits), degrees(ANGLES + OFF), seconds(OFF)][: 2 + errors]
    path = table(tmp_path, head, columns)
    with pytest.raises(UndecidedError, match="is rounder than") as asked:
        read_deviations(path, 1.0)
    (exchanged, _), (as_named, _) = asked.value.question.answers
    if not errors:  # the other one is asked for next
        with pytest.raises(BagError, match=rf'"actual={actual} \[deg\]"'):
            read_deviations(path, 1.0, SheetSettings(columns=(exchanged,)))
        assert_truth(path, columns=(exchanged, f"actual={actual} [deg]"))
        curve = read_deviations(path, 1.0, SheetSettings(columns=(as_named,)))
        np.testing.assert_allclose(np.rad2deg(curve.deviation), -OFF, atol=3e-6)
        return
    assert_truth(path, columns=(exchanged,))


@pytest.mark.parametrize("digits", [4, 9])
@pytest.mark.parametrize("faces", [7, 14, 23])
def test_faces_at_uneven_numbers_are_commanded_as_they_are_named(tmp_path, faces, digits) -> None:
    even = 360.0 / faces * np.arange(faces)
    off = 4e-3 * np.sin(np.deg2rad(even) + 0.4)
    path = table(tmp_path, ["Target [deg]", "Actual [deg]"],
                 [degrees(even, digits), degrees(even + off, 4)])  # fmt: skip
    curve = read_deviations(path, 1.0)
    np.testing.assert_allclose(np.rad2deg(curve.deviation), off, atol=1.1e-4)


@pytest.mark.parametrize(("shift", "row"), [(1e-3, 5), (2e-4, 11)])
def test_one_error_that_does_not_fit_is_named(tmp_path, shift, row) -> None:
    wrong = OFF + shift * (np.arange(12) == row)
    head = ["Target [deg]", "Actual [deg]", "Error [deg]"]
    path = table(tmp_path, head, [degrees(ANGLES, 1), degrees(ANGLES + OFF), degrees(wrong)])
    with pytest.raises(UndecidedError, match=f"in row {row + 2}, with actual"):
        read_deviations(path, 1.0)


@pytest.mark.parametrize(("commanded", "actual"), NO_PAIRS)
def test_a_second_column_of_angles_is_asked_for_and_the_advice_works(
    tmp_path, commanded, actual
) -> None:
    head = [f"{commanded} [deg]", f"{actual} [deg]"]
    path = table(tmp_path, head, [degrees(ANGLES, 1), degrees(ANGLES + OFF)])
    with pytest.raises(BagError, match=rf'"actual={actual} \[deg\]"') as asked:
        read_deviations(path, 1.0)
    (answer, _), (other, _) = asked.value.question.answers
    assert_truth(path, columns=(answer,))
    assert other == f"angle={actual} [deg]"
    with pytest.raises(BagError, match=rf'"actual={commanded} \[deg\]"'):
        read_deviations(path, 1.0, SheetSettings(columns=(other,)))


NUMBER, DEG, SEC = degrees(ANGLES, 1), degrees(ANGLES + OFF), seconds(OFF)
RIGHT = {
    "German": (["Winkel [°]", 'Abweichung ["]'], [NUMBER, SEC], ";"),
    "tabs": (["Angle (deg)", "Deviation (arcsec)"], [NUMBER, SEC], "\t"),
    "aligned": (["Winkel[°]", 'Abw.["]'], [NUMBER, SEC], "   "),
    "units below": (["Angle", "Deviation"], [["deg", *NUMBER], ["arcsec", *SEC]], ","),
    "BOM": (["\ufeffAngle [deg]", "Deviation [arcsec]"], [NUMBER, SEC], ","),
    "gon": (
        ["Winkel [gon]", "Abweichung [mgon]"],
        [degrees(ANGLES / 0.9, 6), degrees(OFF / 0.9e-3, 4)], ",",
    ),
    "rad": (["Target [rad]", "Actual [rad]"],
            [degrees(np.deg2rad(ANGLES), 9), degrees(np.deg2rad(ANGLES + OFF), 9)], ","),
    "sixtieths": (["Soll", "Ist"], [sixtieths(ANGLES), sixtieths(ANGLES + OFF)], ";"),
    "a whole turn less": (["Target [deg]", "Actual [deg]"],
                          [NUMBER, degrees((ANGLES + OFF) % 360.0)], ","),
    "its difference": (["Winkel [°]", "Ist - Soll [arcsec]"], [NUMBER, SEC], ";"),
    "another below": (["Angle [deg]", "Deviation [arcsec]", "x [mm]"],
                      [NUMBER, SEC, ["0"] * 12], ","),
}  # fmt: skip


@pytest.mark.parametrize("decimal_comma", [False, True])
@pytest.mark.parametrize("form", RIGHT)
def test_forms_that_leave_nothing_open(tmp_path, form, decimal_comma) -> None:
    head, columns, separator = RIGHT[form]
    if decimal_comma and separator == ",":
        separator = ";"
    if decimal_comma:
        columns = [[cell.replace(".", ",") for cell in column] for column in columns]
    assert_truth(table(tmp_path, head, columns, separator))


ASKED = {
    "no unit": (["Soll", "Ist", "Abweichung"], [NUMBER, DEG, SEC], {}),
    "no unit of a reading": (
        ["Angle [deg]", "Deviation"], [NUMBER, SEC], {"reading_unit": "arcsec"}
    ),
    "grad": (["Winkel [grad]", "Abweichung [arcsec]"], [NUMBER, SEC], {"angle_unit": "deg"}),
    "time or sixtieths": (
        ["Angle [deg]", "Deviation [arcsec]"],
        [NUMBER, [f"{'-' if d < 0 else ''}0:00:{abs(d) * 3600:05.2f}" for d in OFF]],
        {"reading_unit": "dms"},
    ),
    "either sign": (
        ["Winkel [°]", "Soll-Ist-Abweichung [arcsec]"], [NUMBER, seconds(-OFF)],
        {"values": "corrections"},
    ),
    "positions": (["Angle [deg]", "Deviation [deg]"], [NUMBER, DEG], {"values": "positions"}),
    "two angles": (
        ["Angle [deg]", "Target [deg]", "Deviation [arcsec]"], [DEG, NUMBER, SEC],
        {"columns": ("angle=Target [deg]",)},
    ),
    "no commanded": (["Actual [deg]", "Error [arcsec]"], [DEG, SEC], {}),
    "no angle": (["Angle [deg]", "Deviation [um]"], [NUMBER, SEC], {}),
    "commas within commas": (
        ["Angle [deg]", "Deviation [arcsec]"], [NUMBER, [s.replace(".", ",") for s in SEC]], {}
    ),
    "two angles, one of them requested": (
        ["Requested [deg]", "Position [deg]", "Deviation [arcsec]"], [NUMBER, DEG, SEC],
        {"columns": ("angle=Requested [deg]",)},
    ),
}  # fmt: skip


@pytest.mark.parametrize("form", ASKED)
def test_forms_that_leave_something_open_are_asked_about(tmp_path, form) -> None:
    head, columns, answer = ASKED[form]
    path = table(tmp_path, head, columns)
    with pytest.raises(RotcalError) as asked:
        read_deviations(path, 1.0)
    assert asked.value.exit_code == 2
    if answer:
        ((name, value),) = answer.items()
        assert asked.value.question.setting == f"sheet.{name}"
        offered = [given for given, _ in asked.value.question.answers]
        assert (value[0] if name == "columns" else value) in offered
        assert_truth(path, **answer)


# Targets x runs.

PLACES = np.array([-4.0, -2.0, 0.0, 2.0, 4.0])
UP = np.round(np.random.default_rng(3).normal(0.0, 30.0, (5, 3)), 1)
DOWN = np.round(np.random.default_rng(4).normal(-20.0, 30.0, (5, 3)), 1)
"""arcsec: five targets, three runs."""


def both(up: np.ndarray, down: np.ndarray) -> list[str]:
    return [f"{value:.7g}" for pair in zip(up, down, strict=True) for value in pair]


def matrix(head: list[str], *more: list[str], places: np.ndarray | None = None) -> list[list[str]]:
    rows = (
        both_positions()
        if places is not None
        else [both(u, d) for u, d in zip(UP, DOWN, strict=True)]
    )
    return [head, *more, *([f"{p:g}", *row] for p, row in zip(PLACES, rows, strict=True))]


def both_positions() -> list[list[str]]:
    shown = (PLACES[:, None] + UP / 3600.0, PLACES[:, None] + DOWN / 3600.0)
    return [[f"{float(v):.7f}" for pair in zip(u, d, strict=True) for v in pair]
            for u, d in zip(*shown, strict=True)]  # fmt: skip


def columns_of_runs(word: str, up: str, down: str, unit: str = "arcsec") -> list[str]:
    return [
        "Target [deg]",
        *(f"{word} {j} {way} [{unit}]" for j in (1, 2, 3) for way in (up, down)),
    ]


def as_printed(arrows: tuple[str, str], label: str) -> list[list[str]]:
    """Return the form of the standard's own tables: a column for each target and direction."""
    pairs = [cell for place in PLACES for cell in (f"{place:g}", "")]
    rows = [[f"{label}{j + 1}", *both(UP[:, j], DOWN[:, j])] for j in range(3)]
    return [["i", *"1 2 3 4 5".replace(" ", ",,").split(","), ""],
            ["Target position [deg]", *pairs], ["Approach", *(arrows * 5)], *rows,
            ["Mean unidirectional", *["7"] * 10], ["4 s", *["9"] * 10]]  # fmt: skip


def listed(down_first: bool = False) -> list[list[str]]:
    ways = [("up", UP), ("down", DOWN)][:: -1 if down_first else 1]
    rows = [[f"{j + 1}", way, f"{p:g}", f"{p + values[k, j] / 3600:.7f}"]
            for j in range(3) for way, values in ways for k, p in enumerate(PLACES)]  # fmt: skip
    return [["Run", "Direction", "Target [deg]", "Actual [deg]"], *rows]


WAYS = [("up", "down"), ("+", "-"), ("↑", "↓"), ("hin", "rück"), ("fwd", "rev")]
RUNS = {
    **{f"{word} {up}": (matrix(columns_of_runs(word, up, down)), {})
       for word, (up, down) in product(("Run", "Lauf", "M"), WAYS)},
    "two rows of heads": (
        matrix(["Target [deg]", *(x for j in "123" for x in (f"Run {j} [arcsec]", ""))],
               ["", *["up", "down"] * 3]), {}),
    "actual positions": (
        matrix(columns_of_runs("Actual", "up", "down", "deg"), places=PLACES), {}),
    "positions, told": (
        matrix(columns_of_runs("Run", "up", "down", "deg"), places=PLACES),
        {"values": "positions"}),
    "two rows, words repeated": (
        matrix(["Target [deg]", *(x for j in "123" for x in [f"Lauf {j} [arcsec]"] * 2)],
               ["", *["auf", "ab"] * 3]), {}),
    "two rows, runs below": (
        [["Target [deg]", "up [arcsec]", "", "", "down [arcsec]", "", ""], ["", *"123", *"123"],
         *([f"{p:g}", *map(str, UP[k]), *map(str, DOWN[k])] for k, p in enumerate(PLACES))], {}),
    "up1": (matrix(["Target [deg]", *(f"{way}{j} [arcsec]" for j in "123"
                                      for way in ("up", "dn"))]), {}),
    "x i1": (matrix(["Pi [deg]", *(f"x i{j} {way} [arcsec]" for j in "123" for way in "↑↓")]), {}),
    "as printed": (as_printed(("up", "down"), ""), {"reading_unit": "arcsec"}),
    "as printed, arrows": (as_printed(("↑", "↓"), "j = "), {"reading_unit": "arcsec"}),
    "list": (listed(), {}), "list, down first": (listed(down_first=True), {}),
    "a column up, one down": (
        [["Target [deg]", "Run", "Forward [arcsec]", "Reverse [arcsec]"],
         *([f"{p:g}", str(j + 1), str(UP[k, j]), str(DOWN[k, j])]
           for j in range(3) for k, p in enumerate(PLACES))], {}),
}  # fmt: skip


def assert_runs(path: Path, **settings: object) -> None:
    runs = read_any_runs(path, SheetSettings(**settings))
    np.testing.assert_allclose(np.rad2deg(runs.targets), PLACES, atol=1e-9)
    np.testing.assert_allclose(runs.forward / ARCSEC, UP, atol=1e-3)
    np.testing.assert_allclose(runs.reverse / ARCSEC, DOWN, atol=1e-3)


@pytest.mark.parametrize("form", RUNS)
def test_targets_times_runs(tmp_path, form) -> None:
    (path := tmp_path / "t.csv").write_text("\n".join(map(",".join, RUNS[form][0])), "utf-8")
    assert_runs(path, **RUNS[form][1])


@pytest.mark.parametrize("way", [("", ""), (" cw", " ccw")])
def test_runs_without_known_directions_are_refused(tmp_path, way) -> None:
    head = ["P [deg]", *(f"x{j}{way[j % 2]} [arcsec]" for j in range(1, 7))]
    (path := tmp_path / "t.csv").write_text("\n".join(map(",".join, matrix(head))), "utf-8")
    with pytest.raises(BagError, match=r'"angle=P \[deg\]"') as asked:
        read_any_runs(path)
    assert "column 2 'x1" in asked.value.log
    with pytest.raises(DataError, match=r"up or down behind|'ccw' and 'cw' do not say"):
        read_any_runs(path, SheetSettings(columns=("angle=P [deg]",)))
    if way[0]:
        assert_runs(path, columns=("angle=P [deg]",), up="ccw")


@pytest.mark.parametrize("form", [name for name, (_, answer) in RUNS.items() if answer])
def test_what_a_matrix_of_runs_leaves_open_is_asked(tmp_path, form) -> None:
    (path := tmp_path / "t.csv").write_text("\n".join(map(",".join, RUNS[form][0])), "utf-8")
    with pytest.raises(UndecidedError) as asked:
        read_any_runs(path)
    ((name, value),) = RUNS[form][1].items()
    assert asked.value.question.setting == f"sheet.{name}"
    assert value in [given for given, _ in asked.value.question.answers]


@pytest.mark.parametrize(
    "rows",
    [
        [["a", "b", "g"], ["1", "2", "3"], ["2", "4", "5"], ["3", "3", "3"]],
        [["1", "2", "3"], ["2", "4", "5"], ["3", "3", "3"]],
        matrix(["Target [deg]", *(f"Run {j} [arcsec]" for j in range(1, 7))]),
        matrix(["Target [deg]", *(f"{word} [arcsec]" for word in "abdefg")]),
    ],
)
def test_unknown_headings_are_no_matrix(tmp_path, rows) -> None:
    (path := tmp_path / "t.csv").write_text("\n".join(map(",".join, rows)), "utf-8")
    with pytest.raises((BagError, DataError)):
        read_any_runs(path)


def test_columns_are_shown_with_their_own_numbers_where_a_heading_is_empty(tmp_path) -> None:
    rows = ["Foo,,", ",Bar,Baz", *(f"{k},{100 + k},{200 + k}" for k in range(4))]
    (path := tmp_path / "t.csv").write_text("\n".join(rows), "utf-8")
    with pytest.raises(BagError) as asked:
        read_any_runs(path)
    assert "column 2 'Bar': first 100, largest 103" in asked.value.log
    assert "column 3 'Baz': first 200, largest 203" in asked.value.log


def test_a_title_of_several_cells_is_no_head_of_columns_stated_by_number(tmp_path):
    rows = list(zip(degrees(ANGLES, 0), seconds(OFF), strict=True))
    (path := tmp_path / "t.csv").write_text(
        "Operator;Meier\nfoo;bar\n" + "".join(f"{a};{d}\n" for a, d in rows), encoding="utf-8"
    )
    stated = {"columns": ("angle=#1", "deviation=#2")}
    assert_truth(path, **stated, angle_unit="deg", reading_unit="arcsec")


def test_rows_with_their_name_in_front_are_columns(tmp_path):
    rows = [["Angle [deg]", *degrees(ANGLES, 0)], ["Deviation [arcsec]", *seconds(OFF)]]
    assert_truth(table(tmp_path, rows[0], [[cell] for cell in rows[1]]))
