"""What a table says is taken; what it leaves open is asked; what is no measurement is left out."""

from __future__ import annotations

import shlex
from decimal import Decimal
from math import pi
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError
from rotcal_ros.foundation.escapes import printable
from rotcal_ros.foundation.table_columns import ANGLE, TIME, SheetSettings
from rotcal_ros.foundation.table_forms import read_any
from rotcal_ros.foundation.table_reading import Known, Reading
from rotcal_tables.sheets.numerals import Measure, decimal_marks, parse_measure, to_si
from rotcal_tables.sheets.words import Heading, column_option, heading_columns, units_of

HEADERS = (("position", "target", "length_m"),)
BALLS = (("position", "ball_step", "x_m", "y_m", "z_m"),)
KNOWN = {"position": Known(tuple(range(3)), angles=(0.0, pi / 2, pi)), "target": Known((0, 1))}


def read(path: Path, text: str, headers=HEADERS, known=KNOWN, **settings: object) -> Reading:
    path = path / "table.csv"
    path.write_text(text, encoding="utf-8")
    return read_any(path, headers, SheetSettings(**settings), lambda: known)


def rows(reading: Reading) -> list[tuple[str, ...]]:
    return [cells for _, cells in reading.table.lines]


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("", "no row names the columns: expected 'position,target,length_m'"),
        ("0,0,0.25\n", "no row names the columns"),
        ("position,target,speed\n0,0,1\n", "no column length_m: .* not known: 'speed'"),
        ("position;length_m\n0;1\n", "no column target"),
    ],
)
def test_a_head_that_says_too_little(tmp_path, text, error):
    with pytest.raises(BagError, match=error):
        read(tmp_path, text)


@pytest.mark.parametrize(
    ("text", "mark", "value"),
    [
        ("312.5", ".", "312.5"),
        ("312,5", ",", "312.5"),
        ("1.234,5", ",", "1234.5"),
        ("1,234,567.25", ".", "1234567.25"),
        ("1\u202f234,5", ",", "1234.5"),
        ("1'234.5", ".", "1234.5"),
        ("0,313 166 907 9", ",", "0.3131669079"),
        ("\u22125", ".", "-5"),
        ("１２．５", ".", "12.5"),
        ("1.5e-3", ".", "0.0015"),
        ("1.5D-3", ".", "0.0015"),
    ],
)
def test_numbers_as_people_write_them(text: str, mark: str, value: str) -> None:
    assert parse_measure(text, mark) == Measure(Decimal(value))


@pytest.mark.parametrize("text", ["", "x", "1,2,3", "12,34,567", "1 23", "--5", "1.2.3", "0,123"])
def test_no_numbers_with_a_decimal_point(text: str) -> None:
    assert parse_measure(text, ".") is None


@pytest.mark.parametrize(
    ("text", "degrees"),
    [
        ("12°30'15\"", 12 + 30 / 60 + 15 / 3600),
        ("12° 30′ 15.5″", 12 + 30 / 60 + 15.5 / 3600),
        ("-0°0'36\"", -0.01),
        ("12:30:15", 12 + 30 / 60 + 15 / 3600),
        ("90°", 90.0),
        ("45 deg", 45.0),
        ("100 gon", 90.0),
        ("1.5 rad", 1.5 * 180 / pi),
    ],
)
def test_angles_as_people_write_them(text: str, degrees: float) -> None:
    measure = parse_measure(text, ".", ANGLE)
    assert measure is not None
    assert float(to_si(measure, "")) == pytest.approx(degrees * pi / 180, rel=1e-15)


def test_sixty_minutes_are_no_angle() -> None:
    assert parse_measure("12°60'00\"", ".", ANGLE) is None


def test_moments_are_seconds() -> None:
    assert parse_measure("1970-01-02T00:00:30", ".", TIME) == Measure(Decimal("86430.0"), "s")


@given(
    st.decimals(min_value=-10, max_value=10, places=9), st.sampled_from(["mm", "um", "in", "m"])
)
def test_a_length_in_another_unit_is_the_same_double(metres: Decimal, unit: str) -> None:
    size = {"m": 0, "mm": 3, "um": 6}.get(unit)
    value = metres.scaleb(size) if size is not None else metres
    expected = metres if size is not None else metres * Decimal("0.0254")
    measure = parse_measure(f"{value:f}", ".")
    assert measure is not None
    assert float(to_si(measure, unit)) == float(expected)


def test_what_tells_the_decimal_mark() -> None:
    assert decimal_marks(["1,234"]) == {".", ","}
    assert decimal_marks(["1,234", "0,5"]) == {","}
    assert decimal_marks(["1,234.5"]) == {"."}
    assert decimal_marks(["1.234,5", "1,234.5"]) == set()


@pytest.mark.parametrize(
    ("text", "columns", "units"),
    [
        ("Gemessene Länge [mm]", ("length",), ("mm",)),
        ("Nominal length [mm]", (), ("mm",)),
        ("Soll-Winkel [°]", ("angle",), ("deg",)),
        ("Position (deg)", ("angle",), ("deg",)),
        ("靶标编号", ("target",), ()),
        ("長さ［mm］", ("length",), ("mm",)),
        ("N° de position de table", ("position",), ()),
        ("Temperature [C]", (), ()),
    ],
)
def test_headings(text: str, columns: tuple[str, ...], units: tuple[str, ...]) -> None:
    head = Heading.of(text)
    assert head.units == units
    assert heading_columns(head)[: len(columns)] == columns
    assert bool(heading_columns(head)) == bool(columns)


@given(st.text(min_size=1))
@pytest.mark.parametrize("text", [None, "Weg [mm]", "d, gemessen", "it's", "Länge: {x}", "# 1"])
def test_an_answer_can_be_pasted_as_an_error_shows_it(text: str | None, any_text: str) -> None:
    text = text or any_text
    option, change = shlex.split(printable(column_option("length", text)))
    assert option == "--set"
    assert yaml.safe_load(change.removeprefix("sheet.columns=")) == [f"length={text}"]


WEG = "position;target;Weg [mm]\n0;0;312.5\n"


def test_an_answer_with_brackets_is_understood_and_one_that_names_nothing_is_not(tmp_path) -> None:
    assert rows(read(tmp_path, WEG, columns=("length=Weg [mm]",))) == [("0", "0", "0.3125")]
    assert rows(read(tmp_path, WEG, columns=("length_m=weg MM",))) == [("0", "0", "0.3125")]
    with pytest.raises(
        BagError, match=r"table.csv: .* called 'Weg mn'; did you mean 'Weg \[mm\]'\?"
    ):
        read(tmp_path, WEG, columns=("length=Weg mn",))
    with pytest.raises(BagError, match="no column is called 'Lauf'; known: position, target"):
        read(tmp_path, WEG, columns=("length=Weg [mm]", "run=Lauf"))
    with pytest.raises(ConfigurationError, match="no column 'lenght'; did you mean 'length'"):
        read(tmp_path, WEG, columns=("lenght=Weg [mm]",))


@pytest.mark.parametrize(
    ("heads", "text"),
    [
        ("position;target;Length [furlong]", "'furlong' in the heading 'Length [furlong]' is an "
         "unknown unit: known for length are m, cm, mm, um, nm, in, ft: write"),
        ("Winkel (Strich);target;Länge [mm]", "'Strich' .* known for angle are rad, mrad"),
        ("position;target;Length [deg]", "'deg' .* is an unknown unit: known for length"),
    ],
)  # fmt: skip
def test_an_unknown_unit_is_no_unknown_column(tmp_path, heads: str, text: str) -> None:
    with pytest.raises(BagError, match=text.replace("[", r"\[")):
        read(tmp_path, f"{heads}\n0;0;312.5\n")


def test_grad_is_degrees_in_german_and_gons_elsewhere() -> None:
    assert set(units_of("Grad")) == {"deg", "gon"}


@pytest.mark.parametrize(
    ("text", "settings", "asked"),
    [
        ("position,target,length\n0,0,312.5\n", {}, "312.5 m = 312.5 m, 312.5 mm = 0.3125 m"),
        ("position;target;length [um]\n0;0;1,234\n", {}, "1234 with a decimal point, and 1.234"),
        ("pos,target,length [m]\n1,0,1.5\n2,0,1.5\n", {}, "counted from 0.*counted from 1"),
        (
            "Winkel [Grad],target,length [m]\n90,0,1.5\n",
            {},
            "90 deg = 1.5708 rad, 90 gon = 1.41372",
        ),
        ("pos,target,length [m],L [mm]\n0,0,1.5,1.5\n", {}, "may both be the column length"),
        ("pos,target,length [m]\n0,zero,1.5\n", {}, "row 2: target must be a number, or a name"),
        ("pos,target,length [m]\n0,0,x1\n", {}, "row 2: length must be a number, found 'x1'"),
        ("angle [deg],target,length [m]\n45,0,1.5\n", {}, "45 degrees is not in the plan"),
        (
            "pos,C [deg],target,length [m]\n1,45,0,1.5\n",
            {"counted_from": "0"},
            "1 is planned at 90",
        ),
        ("pos;target;length [m]\n0;0;1,5\n0;1;2.5\n", {}, "some decimal commas"),
        (
            "pos,target,length [m]\n0,0,1.5\nposition,Ziel,L [mm]\n1,0,15\n",
            {},
            "row 3: a table with the same columns begins here",
        ),
    ],
)
def test_what_can_be_read_in_two_ways_is_asked(
    tmp_path: Path, text: str, settings: dict[str, object], asked: str
) -> None:
    with pytest.raises(DataError, match=asked):
        read(tmp_path, text, **settings)


@pytest.mark.parametrize(
    ("text", "readings"),
    [
        (
            "position,target,length\n0,0,312.5\n",
            [("0", "0", "312.5"), ("0", "0", "0.3125"), ("0", "0", "0.0003125"),
             ("0", "0", "7.93750")],
        ),
        (
            "position;target;length [um]\n0;0;1,234\n",
            [("0", "0", "0.001234"), ("0", "0", "0.000001234")],
        ),
        ("pos,target,length [m]\n1,1,1.5\n", [("1", "1", "1.5"), ("0", "0", "1.5")]),
        ("pos,target,length [m],L [mm]\n0,0,1.5,2\n", [("0", "0", "1.5"), ("0", "0", "0.002")]),
    ],
)  # fmt: skip
def test_every_answer_to_a_question_decides_it(
    tmp_path: Path, text: str, readings: list[tuple[str, ...]]
) -> None:
    with pytest.raises(DataError) as asked:
        read(tmp_path, text)
    question = asked.value.question
    assert question is not None
    name = question.setting.removeprefix("sheet.")
    values = [(value,) if name == "columns" else value for value, _ in question.answers]
    found = [rows(read(tmp_path, text, **{name: value})) for value in values]
    assert found == [[reading] for reading in readings]


@pytest.mark.parametrize(
    ("text", "settings", "expected"),
    [
        ("position,target,length\n0,0,312.5\n", {"length_unit": "mm"}, ("0", "0", "0.3125")),
        ("pos;target;length [um]\n0;0;1,234\n", {"decimal": ","}, ("0", "0", "0.000001234")),
        ("pos;target;length [um]\n0;0;1,234\n", {"decimal": "."}, ("0", "0", "0.001234")),
        ("pos,target,length [m]\n1,1,1.5\n", {"counted_from": "1"}, ("0", "0", "1.5")),
        ("pos,target,length [m]\n1,1,1.5\n", {"counted_from": "0"}, ("1", "1", "1.5")),
        ("pos,target,Wert\n0,0,1.5\n", {"columns": ("length=Wert",), "length_unit": "m"},
         ("0", "0", "1.5")),
        ("angle,target,length [m]\n90,0,1.5\n", {"angle_unit": "deg"}, ("1", "0", "1.5")),
        ("pos,C [deg],target,length [m]\n0,360,0,1.5\n", {}, ("0", "0", "1.5")),
        ("angle [deg],target,length [m]\n-270,0,1.5\n", {}, ("1", "0", "1.5")),
    ],
)  # fmt: skip
def test_an_answer_is_taken(
    tmp_path: Path, text: str, settings: dict[str, object], expected: tuple[str, ...]
) -> None:
    (cells,) = rows(read(tmp_path, text, **settings))
    assert (*cells[:2], float(cells[2])) == (*expected[:2], float(expected[2]))


def test_rows_that_hold_no_measurement_are_left_out_with_why(tmp_path: Path) -> None:
    text = (
        "Protocol\npos,target,length [m]\n0,0,1.5\n,,\npos,target,length [m]\n0,1,n/a\n"
        "2,1,2.5\nMean,,2.0\nprinted by hand,,\n,,4.0\n"
    )
    reading = read(tmp_path, text)
    assert rows(reading) == [("0", "0", "1.5"), ("2", "1", "2.5")]
    assert [line for line, _ in reading.table.lines] == [3, 7]
    assert dict(reading.left_out) == {
        5: "the head of the table again",
        6: "nothing was measured",
        8: "a line about others (Mean)",
        9: "a line of text (printed by hand)",
        10: "values that belong to nothing",
    }


def test_a_row_whose_length_looks_like_its_position_is_not_left_out(tmp_path: Path) -> None:
    """Its missing target is for the method's reader to refuse."""
    reading = read(tmp_path, "pos,target,length [m]\n0,0,1.5\n1,,1\n")
    assert rows(reading) == [("0", "0", "1.5"), ("1", "", "1")]
    assert reading.left_out == ()


def test_balls_in_merged_cells(tmp_path: Path) -> None:
    text = "Pos,Ball 1,,,Ball 2,,\n,X,Y,Z,X,Y,Z\n0,1,2,3,4,5,6\n1,7,8,9,10,11,12\n"
    known = {"position": Known((0, 1)), "ball_step": Known((0, 5))}
    reading = read(tmp_path, text, BALLS, known, length_unit="mm", counted_from="")
    assert [tuple(map(float, cells)) for cells in rows(reading)] == [
        (0, 0, 0.001, 0.002, 0.003),
        (0, 5, 0.004, 0.005, 0.006),
        (1, 0, 0.007, 0.008, 0.009),
        (1, 5, 0.010, 0.011, 0.012),
    ]


def test_angles_of_a_table_without_a_plan_are_its_own(tmp_path: Path) -> None:
    text = "angle [deg],target,length [m]\n120,0,1.5\n0,0,1.5\n240,0,1.5\n"
    reading = read(tmp_path, text, known={"target": Known((0, 1))})
    assert reading.angles_deg == (0.0, 120.0, 240.0)
    assert [cells[0] for cells in rows(reading)] == ["1", "0", "2"]


def test_a_column_and_a_sheet_that_are_not_there(tmp_path: Path) -> None:
    with pytest.raises(BagError, match=r"no column target: found position .* not known: 'Wer'"):
        read(tmp_path, "pos,Wer,length [m]\n0,0,1.5\n")
    with pytest.raises(ConfigurationError, match="no sheet 'Two'"):
        read(tmp_path, "pos,target,length [m]\n0,0,1.5\n", name="Two")
    with pytest.raises(ConfigurationError, match="expected COLUMN=TEXT"):
        read(tmp_path, "pos,target,length [m]\n0,0,1.5\n", columns=("length",))


ANGLES = [0, 90, 180]


@pytest.mark.parametrize(
    ("angles", "runs", "both"),
    [
        ([*ANGLES, *ANGLES[::-1]], 1, True),
        ([*ANGLES, *ANGLES[-2::-1]], 1, True),  # the last one is not measured twice
        ([*ANGLES, *ANGLES], 2, False),
        ([*ANGLES, 0], 2, False),  # the first one once more
        ([*ANGLES[::-1], *ANGLES[::-1]], 2, False),
        ([*ANGLES, *ANGLES[::-1]] * 2, 2, True),
        ([350, 0, 10, 10, 0, 350], 1, True),
    ],
)
def test_the_order_of_rows_tells_passes(
    tmp_path: Path, angles: list[int], runs: int, both: bool
) -> None:
    rows = [f"{angle},{target},1.5" for angle in angles for target in (0, 1)]
    text = "\n".join(["angle [deg],target,length [m]", *rows])
    reading = read(tmp_path, text, known={"target": Known((0, 1))})
    assert (reading.runs, reading.both_directions) == (runs, both)
    assert f"; runs: {runs}{', up and down' * both};" in reading.line()
    assert len(reading.angles_deg) == 3


@pytest.mark.parametrize("angles", [[0, 0, 90, 90, 180, 180], [*ANGLES, 90, 180, 0]])
def test_an_order_that_tells_no_passes_is_asked_about(tmp_path: Path, angles: list[int]) -> None:
    rows = "\n".join(f"{angle},0,1.5" for angle in angles)
    with pytest.raises(DataError, match="Add a column 'direction'"):
        read(tmp_path, f"angle [deg],target,length [m]\n{rows}\n", known={"target": Known((0,))})


def test_an_unknown_direction_is_named(tmp_path: Path) -> None:
    text = "angle [deg],direction,target,length [m]\n0,left,0,1.5\n"
    assert [cells[0] for cells in rows(read(tmp_path, text))] == ["0"]  # which needs no direction
    text += "0,right,0,1.5\n"
    with pytest.raises(DataError, match="'left' and 'right' do not say"):
        read(tmp_path, text, known={"target": Known((0,))})
    with pytest.raises(DataError, match="row 2: the direction must be up or down, found 'left'"):
        read(tmp_path, text + "0,across,0,1.5\n", known={"target": Known((0,))})


def test_columns_of_direction_and_run_go_with_numbers_of_positions(tmp_path: Path) -> None:
    known = {
        "position": Known((0, 1, 2, 3), angles=(0.0, 1.0, 1.0, 0.0), downward=frozenset((2, 3))),
        "target": Known((0,)),
    }
    text = "position,Richtung,target,length [m]\n0,hin,0,1\n0,rück,0,2\n1,hin,0,3\n1,rück,0,4\n"
    assert [cells[0] for cells in rows(read(tmp_path, text, known=known))] == ["0", "3", "1", "2"]
