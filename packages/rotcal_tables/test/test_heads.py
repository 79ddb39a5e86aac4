"""Heads of more than a row of names: directions, symbols, merged cells, tables side by side.

The tables are written here, as text and as workbook, from numbers that this file makes.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import openpyxl
import pytest

from rotcal_ros.evaluation.iso230 import BidirectionalRuns, read_any_runs
from rotcal_ros.evaluation.reference import read_deviations
from rotcal_ros.foundation.errors import (
    BagError,
    ConfigurationError,
    DataError,
    RotcalError,
    UndecidedError,
)
from rotcal_ros.foundation.table_columns import SheetSettings
from rotcal_ros.foundation.table_forms import read_any, remember
from rotcal_ros.foundation.table_reading import Reading
from rotcal_ros.foundation.units import ARCSEC

ANGLES = np.arange(0.0, 360.0, 45.0)
OFF = np.round(70.0 * np.sin(np.deg2rad(ANGLES) + 0.3), 2)
"""Deviations in arcsec, some of more than a minute."""
X, Y = (np.round(20.0 * f(np.deg2rad(ANGLES)) + 100.0, 4) for f in (np.cos, np.sin))
PLACES = np.array([-4.0, -2.0, 0.0, 2.0, 4.0])
UP, DOWN = (np.round(np.random.default_rng(k).normal(0.0, 30.0, (5, 3)), 1) for k in (5, 6))


def file(folder: Path, rows: list[list[str]], ending: str = "csv") -> Path:
    path = folder / f"t.{ending}"
    if ending == "csv":
        path.write_text("\n".join(map(",".join, rows)), "utf-8")
        return path
    book = openpyxl.Workbook()
    for row in rows:
        book.active.append([float(c) if re.fullmatch(r"-?[\d.]+", c) else c or None for c in row])
    book.save(path)
    return path


def column(values: np.ndarray) -> list[str]:
    return [f"{value:.9g}" for value in values]


def below(heads: list[list[str]], *columns: np.ndarray) -> list[list[str]]:
    return [*heads, *map(list, zip(*map(column, columns), strict=True))]


# Directions.

TURNS = [
    ("CW", "CCW"), ("ccw", "cw"), ("Rechtslauf", "Linkslauf"), ("counter-clockwise", "clockwise"),
    ("gegen den Uhrzeigersinn", "im Uhrzeigersinn"), ("↻", "↺"), ("oraria", "antioraria"),
    ("時計回り", "反時計回り"), ("CW ↻", "CCW ↺"), ("left", "right"),
]  # fmt: skip
WAYS = [("↑", "↓"), ("+", "-"), ("increasing", "decreasing"), ("aller", "retour")]
BOTH = [np.ravel([u, d], "F") for u, d in zip(UP, DOWN, strict=True)]
ONE_THEN_OTHER = [np.ravel([u, d]) for u, d in zip(UP, DOWN, strict=True)]


def heads(form: str, up: str, down: str) -> list[list[str]]:
    """Return the head of targets x runs in a form, with its words for up and down."""
    a, merged = [up, down] * 3, [x for j in "123" for x in (f"Run {j} [arcsec]", "")]
    found = {
        "CW 1": [f"{w} {j} [arcsec]" for j in "123" for w in (up, down)],
        "1 CW": [f"{j} {w} [arcsec]" for j in "123" for w in (up, down)],
        "Run 1 CW": [f"Run {j} {w} [arcsec]" for j in "123" for w in (up, down)],
        "CW, CW": [f"{w} [arcsec]" for w in a],
        "CW 1, CW 2": [f"{w} {j} [arcsec]" for w in (up, down) for j in "123"],
        "+1": [f"{w}{j} [sec]" for j in "123" for w in (up, down)],
    }
    if form == "merged runs":
        return [["Target [deg]", *merged], ["", *a]]
    if form == "merged ways":
        ways = [f"{up} [arcsec]", "", "", f"{down} [arcsec]", "", ""]
        return [["Target [deg]", *ways], ["", *"123123"]]
    return [["Target [deg]", *found[form]]]


def assert_runs(runs: BidirectionalRuns) -> None:
    np.testing.assert_allclose(np.rad2deg(runs.targets), PLACES, atol=1e-9)
    np.testing.assert_allclose(runs.forward / ARCSEC, UP, atol=1e-6)
    np.testing.assert_allclose(runs.reverse / ARCSEC, DOWN, atol=1e-6)


FORMS = ["CW 1", "1 CW", "Run 1 CW", "CW, CW", "CW 1, CW 2", "+1", "merged runs", "merged ways"]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(("up", "down"), [*TURNS, *WAYS])
def test_a_direction_that_may_be_of_either_sign_is_asked(tmp_path, form, up, down) -> None:
    values = np.array(ONE_THEN_OTHER if form in ("CW 1, CW 2", "merged ways") else BOTH)
    path = file(tmp_path, below(heads(form, up, down), PLACES, *values.T))
    if (up, down) in WAYS:
        assert_runs(read_any_runs(path))
        return
    with pytest.raises(UndecidedError, match="in which direction the table angle grows") as asked:
        read_any_runs(path)
    assert asked.value.question.setting == "sheet.up"
    (first, _), (second, _) = asked.value.question.answers
    assert (first, second) == (up, down)
    assert_runs(read_any_runs(path, SheetSettings(up=first)))
    other = read_any_runs(path, SheetSettings(up=second))
    np.testing.assert_allclose(other.forward / ARCSEC, DOWN, atol=1e-6)


@pytest.mark.parametrize(("up", "down"), TURNS)
@pytest.mark.parametrize("as_driven", [True, False])
def test_the_order_of_rows_may_show_which_direction_it_is(tmp_path, up, down, as_driven) -> None:
    rows = [
        [f"{place:g}", str(run + 1), way, str(values[k, run])]
        for run in range(3)
        for way, values in ((up, UP), (down, DOWN))
        for k, place in [*enumerate(PLACES)][:: -1 if as_driven and way == down else 1]
    ]
    path = file(tmp_path, [["Target [deg]", "Run", "Direction", "Deviation [arcsec]"], *rows])
    if not as_driven:
        with pytest.raises(UndecidedError, match="do not say"):
            read_any_runs(path)
    assert_runs(read_any_runs(path, SheetSettings(up="" if as_driven else up)))


@pytest.mark.parametrize(
    "head",
    ["{j}{w}", "#{j}{w}", "{j} {w}", "dev {j}{w} [arcsec]", "x{j}{w} [arcsec]"],
)
@pytest.mark.parametrize(("up", "down"), [("+", "-"), ("↑", "↓")])
def test_signs_and_arrows_at_the_number_of_a_run_are_its_direction(tmp_path, head, up, down):
    names = [head.format(j=j, w=w) for j in "123" for w in (up, down)]
    path = file(tmp_path, below([["Target [deg]", *names]], PLACES, *np.array(BOTH).T))
    assert_runs(read_any_runs(path, SheetSettings(reading_unit="arcsec")))


def test_a_symbol_of_something_else_with_both_directions_is_no_deviation(tmp_path):
    head = ["Target [deg]", *(f"{name}{way} [arcsec]" for name in "sR" for way in "↑↓")]
    path = file(tmp_path, below([head], PLACES, *UP[:, :2].T, *DOWN[:, :2].T))
    with pytest.raises(BagError, match="no column deviation_rad"):
        read_any_runs(path)


def test_unknown_words_for_a_direction_are_refused_with_advice_that_works(tmp_path) -> None:
    def table(up: str, down: str) -> Path:
        return file(tmp_path, below(heads("Run 1 CW", up, down), PLACES, *np.array(BOTH).T))

    with pytest.raises(
        BagError, match="write the number and the direction at each head, as Run 1"
    ):
        read_any_runs(table("foo", "bar"))
    assert_runs(read_any_runs(table("up", "down")))


# Symbols and units.

NAMES, SYMBOLS, UNITS = ["Table angle", "X", "Y", "Z"], ["θ", "x", "y", "z"], ["deg", *["mm"] * 3]
WITH_UNITS = [f"{name} [{unit}]" for name, unit in zip(NAMES, UNITS, strict=True)]


@pytest.mark.parametrize("ending", ["csv", "xlsx"])
@pytest.mark.parametrize(
    "head",
    [[NAMES, SYMBOLS, UNITS], [SYMBOLS, NAMES, UNITS], [SYMBOLS, UNITS], [NAMES, UNITS, SYMBOLS],
     [WITH_UNITS, ["α_i", "x_i", "y_i", "z_i"]], [["theta_i", "P_x", "P_y", "P_z"], WITH_UNITS],
     [["Stellung A", "Ort längs", "Ort quer", "Höhe"], SYMBOLS, UNITS]],
)  # fmt: skip
def test_symbols_above_or_below_the_names_are_read_over(tmp_path, head, ending) -> None:
    path = file(tmp_path, below(head, ANGLES, X, Y, 0.0 * X + 80.0), ending)
    found = read_any(path, (("position", "x_m", "y_m", "z_m"),), SheetSettings())
    values = [[float(cell) for cell in cells[1:]] for _, cells in found.table.lines]
    np.testing.assert_allclose(values, np.c_[X, Y, 0.0 * X + 80.0] / 1000.0)
    np.testing.assert_allclose(found.angles_deg, ANGLES)


@pytest.mark.parametrize("symbols", [["α_i", "Δα_i"], ["theta", "delta"], ["P i", "x i"]])
@pytest.mark.parametrize("units", [True, False])
def test_symbols_of_deviations(tmp_path, symbols, units) -> None:
    head = [["Angle", "Deviation"], symbols, ["deg", "arcsec"]]
    if not units:
        head = [["Angle [deg]", "Deviation [arcsec]"], symbols]
    curve = read_deviations(file(tmp_path, below(head, ANGLES, OFF)), 1.0)
    np.testing.assert_allclose(curve.deviation / ARCSEC, OFF, atol=1e-9)


@pytest.mark.parametrize("head", [
    [f"{c}{ball} [mm]" for ball in "12" for c in "XYZ"],
    [f"{c} {ball} [mm]" for c in "XYZ" for ball in "12"],
    [f"Ball {ball} {c} [mm]" for ball in "12" for c in "XYZ"],
])  # fmt: skip
def test_letters_with_numbers_are_a_matrix_of_places(tmp_path, head) -> None:
    value = {"X": X, "Y": Y, "Z": 0.0 * X + 80.0}
    columns = [value[re.search("[XYZ]", h)[0]] + 10.0 * ("2" in h) for h in head]
    path = file(tmp_path, below([["C [deg]", *head]], ANGLES, *columns))
    found = read_any(path, (("position", "ball", "x_m", "y_m", "z_m"),), SheetSettings())
    first, second = (
        np.array([cells[2:] for _, cells in found.table.lines], float)
        .reshape(8, 2, 3)
        .swapaxes(0, 1)
    )
    np.testing.assert_allclose(first, np.c_[X, Y, value["Z"]] / 1000.0)
    np.testing.assert_allclose(second, first + 0.01)


@pytest.mark.parametrize(("head", "answers"), [
    (["Szög [°]", "Gömb", "X [mm]", "Y [mm]", "Z [mm]"], ["angle=Szög [°]", "ball=Gömb"]),
    (["Angle [deg]", "Feature", "X [mm]", "Y [mm]", "Z [mm]"], ["ball=Feature"]),
])  # fmt: skip
def test_of_a_missing_key_the_columns_that_may_be_it_are_offered(tmp_path, head, answers) -> None:
    body = [
        [f"{a:g}", f"SPHERE_{b}", *f"{x} {y} 80".split()]
        for a, x, y in zip(ANGLES, X, Y, strict=True)
        for b in "12"
    ]
    path, headers = file(tmp_path, [head, *body]), (("position", "ball", "x_m", "y_m", "z_m"),)
    given: list[str] = []
    for answer in answers:
        with pytest.raises(BagError, match="no column") as asked:
            read_any(path, headers, SheetSettings(columns=tuple(given)))
        assert answer in [offered for offered, _ in asked.value.question.answers]
        given.append(answer)
    found = read_any(path, headers, SheetSettings(columns=tuple(given)))
    assert [cells[1] for _, cells in found.table.lines[:2]] == ["1", "2"]


def test_without_a_column_that_may_be_the_key_it_is_said_to_add_one(tmp_path) -> None:
    path = file(tmp_path, below([WITH_UNITS], ANGLES, X, Y, X))
    with pytest.raises(BagError, match="add one that says of which ball a row is"):
        read_any(path, (("position", "ball", "x_m", "y_m", "z_m"),), SheetSettings())


# Tables side by side.


def side(*tables: list[list[str]]) -> list[list[str]]:
    width, height = [len(table[0]) for table in tables], max(map(len, tables))
    filled = [t + [[""] * w] * (height - len(t)) for t, w in zip(tables, width, strict=True)]
    return [[c for part in rows for c in (*part, "")][:-1] for rows in zip(*filled, strict=True)]


PLAIN = below([["Angle [deg]", "Deviation [arcsec]"]], ANGLES, OFF)
BELOW = below([["Angle", "Deviation"], ["deg", "arcsec"]], ANGLES, OFF + 5.0)
WARM = below([["Angle [deg]", "Temperature [°C]"]], [*ANGLES, 360.0], [20.0] * 9)


@pytest.mark.parametrize("ending", ["csv", "xlsx"])
@pytest.mark.parametrize("titles", [[], [["Lauf A", "", "", "Lauf B", ""]]])
def test_of_tables_side_by_side_it_is_asked_which(tmp_path, ending, titles) -> None:
    second = below([PLAIN[0]], ANGLES, OFF + 5.0)
    path = file(tmp_path, titles + side(PLAIN, second), ending)
    with pytest.raises(UndecidedError, match="2 tables stand side by side") as asked:
        read_deviations(path, 1.0)
    assert asked.value.question.setting == "sheet.table"
    assert "column 5 'Deviation [arcsec]': first" in asked.value.log
    assert not titles or [w[5] for _, w in asked.value.question.answers] == ["A", "B"]
    for (answer, _), off in zip(asked.value.question.answers, (OFF, OFF + 5.0), strict=True):
        curve = read_deviations(path, 1.0, SheetSettings(table=answer))
        np.testing.assert_allclose(curve.deviation / ARCSEC, off, atol=1e-9)
    with pytest.raises(ConfigurationError, match="no table '3' has such columns"):
        read_deviations(path, 1.0, SheetSettings(table="3"))
    said_of_it: list[Reading] = []
    read_deviations(path, 1.0, SheetSettings(table="2"), said_of_it.append)
    remember(path, said_of_it[0].form_head, said_of_it[0].stated)
    curve = read_deviations(path, 1.0)
    np.testing.assert_allclose(curve.deviation / ARCSEC, OFF + 5.0, atol=1e-9)


@pytest.mark.parametrize(("tables", "off"), [
    ((PLAIN, WARM), OFF), ((WARM, PLAIN), OFF), ((WARM, BELOW), OFF + 5.0),
])  # fmt: skip
def test_where_one_table_alone_can_be_it_it_is_read_and_said(tmp_path, tables, off) -> None:
    lines: list[Reading] = []
    path = file(tmp_path, side(*tables))
    curve = read_deviations(path, 1.0, announce=lines.append)
    np.testing.assert_allclose(curve.deviation / ARCSEC, off, atol=1e-9)
    assert f"columns {'1 to 2' if tables[0] is PLAIN else '4 to 5'}" in lines[0].line()


def test_an_empty_column_within_a_table_parts_nothing(tmp_path) -> None:
    rows = [[*row[:1], "", *row[1:]] for row in PLAIN]
    curve = read_deviations(file(tmp_path, rows), 1.0)
    np.testing.assert_allclose(curve.deviation / ARCSEC, OFF, atol=1e-9)


# Minutes and seconds.


def minutes(value: float, form: str = "{}{}:{:05.2f}") -> str:
    whole, rest = divmod(round(abs(value), 2), 60.0)
    return form.format("-" * int(value < 0), int(whole), rest)


@pytest.mark.parametrize("mark", [".", ","])
@pytest.mark.parametrize("unit", ["min:sec", "mm:ss", "arcmin:arcsec", "' \"", "m:s", "", "dms"])
def test_minutes_and_seconds_where_the_heading_says_so(tmp_path, unit, mark) -> None:
    text = "\n".join([f"Angle [deg];Deviation{f' [{unit}]' if unit else ''}", *(
        f"{a:g};{minutes(d).replace('.', mark)}" for a, d in zip(ANGLES, OFF, strict=True)
    )])  # fmt: skip
    (path := tmp_path / "t.csv").write_text(text, "utf-8")
    if not unit:
        with pytest.raises(UndecidedError) as asked:
            read_deviations(path, 1.0)
        assert [given for given, _ in asked.value.question.answers] == ["dms", "m:s"]
    curve = read_deviations(path, 1.0, SheetSettings(reading_unit="" if unit else "m:s"))
    np.testing.assert_allclose(
        curve.deviation / ARCSEC, OFF * (60.0 if unit == "dms" else 1.0), atol=1e-9
    )


def test_minutes_with_signs_need_no_heading(tmp_path) -> None:
    cells = [minutes(value, "{}{}'{:05.2f}''") for value in OFF]
    rows = [["Angle [deg]", "Deviation"], *map(list, zip(column(ANGLES), cells, strict=True))]
    curve = read_deviations(file(tmp_path, rows), 1.0)
    np.testing.assert_allclose(curve.deviation / ARCSEC, OFF, atol=1e-9)


@pytest.mark.parametrize(
    ("form", "part", "sure"), [("mm:ss", 86_400.0, True), ("h:mm", 1440.0, False)]
)
def test_times_of_a_workbook_below_minutes_and_seconds(tmp_path, form, part, sure) -> None:
    """Who types 1:23 into a workbook gets 1 h 23 min, unless the cell has the form mm:ss."""
    book = openpyxl.Workbook()
    book.active.append(["Angle [deg]", "Deviation [min:sec]"])
    for angle in ANGLES:
        book.active.append([angle, (61.0 + angle) / part])
        book.active.cell(book.active.max_row, 2).number_format = form
    book.save(path := tmp_path / "t.xlsx")
    if not sure:
        with pytest.raises(UndecidedError):
            read_deviations(path, 1.0)
    curve = read_deviations(path, 1.0, SheetSettings(reading_unit="" if sure else "m:s"))
    np.testing.assert_allclose(curve.deviation / ARCSEC, 61.0 + ANGLES, atol=1e-6)


# Merged cells.


@pytest.mark.parametrize("ending", ["csv", "xlsx"])
@pytest.mark.parametrize(
    "head",
    [[["Angle [deg]", "Deviation [arcsec]", ""], ["", "before", "after"]],
     [["Table", "Autocollimator", ""], ["Angle [deg]", "Reading [arcsec]", "Air [°C]"]],
     [["Table", "Autocollimator [arcsec]", ""], ["Angle [deg]", "horizontal", "vertical"]]],
)  # fmt: skip
def test_merged_heads_are_asked_about_in_the_texts_of_their_cells(tmp_path, head, ending) -> None:
    path = file(tmp_path, below(head, ANGLES, OFF, 0.0 * OFF + 20.0), ending)
    with pytest.raises(RotcalError) as asked:
        read_deviations(path, 1.0)
    assert asked.value.exit_code in (2, 3)
    cells = {cell for row in head for cell in row}
    for quoted in re.findall(
        r"'([^']*)'",
        f"{asked.value.log}\n{str(asked.value).split(': found')[1].split('. Exp')[0]}",
    ):
        assert quoted in cells
    answer, _ = asked.value.question.answers[0]
    curve = read_deviations(path, 1.0, SheetSettings(columns=(answer,)))
    np.testing.assert_allclose(curve.deviation / ARCSEC, OFF, atol=1e-9)


def test_twins_are_named_by_their_numbers(tmp_path) -> None:
    path = file(
        tmp_path, below([["Angle [deg]", "Foo [arcsec]", "Foo [arcsec]"]], ANGLES, OFF, -OFF)
    )
    with pytest.raises((BagError, DataError)) as asked:
        read_deviations(path, 1.0)
    assert [given for given, _ in asked.value.question.answers] == ["deviation=#2", "deviation=#3"]
    curve = read_deviations(path, 1.0, SheetSettings(columns=("deviation=#3",)))
    np.testing.assert_allclose(curve.deviation / ARCSEC, -OFF, atol=1e-9)
