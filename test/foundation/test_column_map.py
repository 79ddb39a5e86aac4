"""Without a package for other forms: our columns in any unit and order, a map, or a refusal."""

from __future__ import annotations

import csv
import json
import shlex
import shutil
from collections.abc import Iterator
from math import pi
from pathlib import Path

import pytest
from click.testing import CliRunner

from rotcal_ros.cli.main import rotcal
from rotcal_ros.evaluation.iso230 import read_any_runs, read_runs
from rotcal_ros.evaluation.reference import read_deviations, read_reference
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.errors import (
    BagError,
    ConfigurationError,
    DataError,
    RotcalError,
    UndecidedError,
)
from rotcal_ros.foundation.table_columns import SheetSettings
from rotcal_ros.foundation.table_forms import FILE, form_reader, read_any
from rotcal_ros.foundation.table_reading import Known, Reading
from rotcal_ros.foundation.tables import as_path_or_table, read_table

DATA = Path(__file__).parents[2] / "examples" / "data"
LENGTHS = (("position", "target", "length_m"), ("position", "target", "length_m", "segment"))
KNOWN = {"position": Known((0, 1, 2)), "target": Known((0, 1))}
PACKAGE = plugins.provider("any", plugins.TABLES)


@pytest.fixture(autouse=True)
def alone(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let no package read tables, whatever is installed."""
    found = plugins._found
    monkeypatch.setattr(plugins, "_found", lambda g: {} if g == plugins.TABLES else found(g))
    form_reader.cache_clear()
    yield
    form_reader.cache_clear()


def read(folder: Path, text: str, headers=LENGTHS, known=KNOWN, **settings: object) -> Reading:
    (folder / "t.csv").write_text(text, encoding="utf-8")
    return read_any(folder / "t.csv", headers, SheetSettings(**settings), lambda: known)


def rows(reading: Reading) -> list[tuple[str, ...]]:
    return [cells for _, cells in reading.table.lines]


@pytest.mark.parametrize(
    ("text", "settings"),
    [
        ("length_mm,target,note,position\n312.5,1,x,0\n1,0,,0\n", {}),
        ("Length [mm],Target,,Position\n312.5,1,,0\n1,0,,0\n", {}),
        ("Pos,Ziel,Weg\n0,1,312.5\n0,0,1\n", {
            "columns": ("position=Pos", "target=Ziel", "length=Weg"), "length_unit": "mm"}),
        ("Pos,Ziel,Weg (mm)\n0,1,312.5\n0,0,1\n", {
            "columns": ("position=#1", "target=ziel", "length_m=Weg (mm)")}),
        ("position,target,length,length\n0,1,7,0.3125\n0,0,7,1\n", {
            "columns": ("length=#4",), "length_unit": "m"}),
    ],
)  # fmt: skip
def test_columns_are_found_by_our_names_or_by_the_map(tmp_path, text, settings):
    reading = read(tmp_path, text, **settings)
    assert reading.table.header == LENGTHS[0]
    (position, target, length), _ = rows(reading)
    assert (position, target, float(length)) == ("0", "1", 0.3125)  # to the last bit
    assert f"position = {reading.uses['position'].text!r}" in reading.line()


def test_columns_that_may_be_left_out_are_taken_where_they_are(tmp_path):
    reading = read(tmp_path, "segment,length_um,target,position\n2,312500,0,0\n")
    assert reading.table.header == LENGTHS[1]
    ((*keys, length, segment),) = rows(reading)
    assert (keys, float(length), segment) == (["0", "0"], 0.3125, "2")


@pytest.mark.parametrize(
    ("positions", "settings", "expected"),
    [
        ((1, 2, 3), {}, ["0", "1", "2"]),
        ((0, 1), {}, ["0", "1"]),
        ((1, 2), {"counted_from": "0"}, ["1", "2"]),
        ((1, 2), {"counted_from": "1"}, ["0", "1"]),
        ((7, 8), {}, ["7", "8"]),  # of no plan: refused by its reader
    ],
)
def test_numbers_count_from_0_or_from_1_as_the_plan_shows(tmp_path, positions, settings, expected):
    text = "Position,target,length_m\n" + "".join(f"{p},0,1.0\n" for p in positions)
    reading = read(tmp_path, text, **settings)
    assert [cells[0] for cells in rows(reading)] == expected
    assert ("position counts from 1" in reading.line()) is (expected[0] != str(positions[0]))


@pytest.mark.parametrize(
    ("text", "settings", "setting"),
    [
        ("Position,target,length_m\n1,0,1\n2,0,1\n", {}, "sheet.counted_from"),
        ("position,target,length\n0,0,1\n", {}, "sheet.length_unit"),
        ("position,target,length_mm,Length [um]\n0,0,1,1\n", {}, "sheet.columns"),
    ],
)
def test_what_can_be_read_in_two_ways_is_asked(tmp_path, text, settings, setting):
    with pytest.raises(UndecidedError) as asked:
        read(tmp_path, text, **settings)
    assert asked.value.exit_code == 2
    assert asked.value.question.setting == setting
    for value, _ in asked.value.question.answers:
        entry = (value,) if setting == "sheet.columns" else value
        read(tmp_path, text, **settings, **{setting.removeprefix("sheet."): entry})


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"PK\x03\x04 a workbook", "is a workbook"),
        ("Position;Ziel;Länge [m]\n0;0;0,3\n".encode(), "Save it with commas between"),
        ("position,target,L\u00e4nge\n0,0,1\n".encode("cp1252"), "not text in UTF-8"),
        (b"0,0,0.3\n1,0,0.4\n", "found '0', '0', '0.3'"),
        (b"angle_deg,target,length_m\n0,0,0.3\n", "no column position: found 'angle_deg'"),
        (b"position [deg],target,length_m\n0,0,0.3\n", "no column position"),
        ("position,target,Länge [Zoll]\n0,0,0.3\n".encode(), "no column length_m"),
        (b"position,target,length [Zoll]\n0,0,0.3\n", "is none of numbers of length"),
        (b"position,target,length_deg\n0,0,0.3\n", "is none of numbers of length"),
    ],
)
def test_another_form_is_refused_in_one_line_with_what_to_do(tmp_path, content, words):
    path = tmp_path / "t.csv"
    path.write_bytes(content)
    with pytest.raises(BagError) as refused:
        read_any(path, LENGTHS, SheetSettings(), lambda: KNOWN)
    assert words in str(refused.value)
    assert str(refused.value).startswith(("cannot read the table", str(path)))
    assert f"pip install {PACKAGE}" in str(refused.value)
    assert len(str(refused.value).splitlines()) == 1


def test_the_advice_of_a_refusal_reads_the_table(tmp_path):
    text = "position,target,Weg [mm]\n0,0,312.5\n"
    with pytest.raises(BagError) as refused:
        read(tmp_path, text)
    option = shlex.split(str(refused.value).split("name by ")[1].split(", or pip")[0])
    entry = json.loads(option[1].removeprefix("sheet.columns="))
    assert rows(read(tmp_path, text, columns=tuple(entry)))[0][:2] == ("0", "0")


@pytest.mark.parametrize(
    ("settings", "error", "words"),
    [
        ({"columns": ("lenght=Weg",)}, ConfigurationError, "did you mean 'length'?"),
        ({"columns": ("length=Wege",)}, BagError, "did you mean 'Weg'?"),
        ({"columns": ("length=Weg",), "length_unit": "ft", "up": "CW"}, ConfigurationError,
         "sheet.up is not for CSV in commas"),
        ({"columns": ("length=Weg",), "decimal": ","}, ConfigurationError, "sheet.decimal"),
    ],
)  # fmt: skip
def test_a_map_that_does_not_fit_is_refused(tmp_path, settings, error, words):
    with pytest.raises(error) as refused:
        read(tmp_path, "position,target,Weg\n0,1,312.5\n", **settings)
    assert words in str(refused.value)


@pytest.mark.parametrize("stated", ["length=length_m", "position=position", "length=Weg"])
def test_our_own_columns_are_what_they_are_called(tmp_path, stated):
    text = "position,target,length_m\n0,1,0.3125\n"
    assert rows(read(tmp_path, text, columns=(stated,))) == [("0", "1", "0.3125")]
    with pytest.raises(DataError, match="length_m is its length, but"):
        read(tmp_path, text, columns=(stated, "target=length_m"))


def test_a_column_of_another_table_is_left_to_it(tmp_path):
    reading = read(tmp_path, "position,target,Weg [m]\n0,0,1\n", columns=("length=Weg [m]", "x=X"))
    assert rows(reading) == [("0", "0", "1")]


@pytest.mark.parametrize("cell", ["x", "1e999999999", "sNaN", ""])
def test_what_is_no_number_is_refused_with_its_row(tmp_path, cell):
    reading = read(tmp_path, f"position,target,length_mm\n0,0,1\n0,1,{cell}\n")
    with pytest.raises(RotcalError, match=r"row 3: length_m must be a finite number"):
        [row.metres("length_m") for row in reading.table.rows()]


def test_a_table_in_memory_is_read_by_the_same_map():
    source = as_path_or_table({"Ziel": [0], "position": [0], "length_mm": [312.5]}, "mine")
    reading = read_any(source, LENGTHS, SheetSettings(columns=("target=Ziel",)), lambda: KNOWN)
    assert reading.table.in_memory
    assert rows(reading)[0][:2] == ("0", "0")


def run(*arguments: object, code: int = 0) -> str:
    done = CliRunner().invoke(rotcal, [str(a) for a in arguments], prog_name="rotcal")
    assert done.exit_code == code, done.output
    return done.stderr if code else done.stdout


@pytest.fixture
def mapped(tmp_path) -> Path:
    """Return the sample lengths with other names, in millimetres, targets from 1."""
    with (DATA / "lengths.csv").open() as file:
        given = [(r["target"], r["length_m"], r["position"]) for r in csv.DictReader(file)]
    lines = [f"{int(t) + 1},{float(m) * 1e3:.7f},{p}" for t, m, p in given]
    (tmp_path / "lengths.csv").write_text("\n".join(["Ziel,Weg,Pos", *lines]))
    shutil.copy(DATA / "targets.csv", tmp_path)
    return tmp_path / "lengths.csv"


COLUMNS = ["target=Ziel", "length=Weg", "position=Pos"]


@pytest.mark.parametrize("way", ["options", "set-up", "beside"])
def test_a_map_solves_to_the_last_bit(mapped, way, without_figures):
    own = run("solve", DATA / "lengths.csv", "--setup", DATA / "tracer.yaml", "--json")
    setup, more = Path(shutil.copy(DATA / "tracer.yaml", mapped.parent)), []
    settings = {"columns": COLUMNS, "length_unit": "mm"}
    if way == "options":
        more = [f"--set=sheet.{n}={json.dumps(v)}" for n, v in settings.items()]
    elif way == "set-up":
        group = f"    sheet: {json.dumps(settings)}\n"
        text = setup.read_text().replace("    plan:\n", f"{group}    plan:\n", 1)
        setup.write_text(text)
    else:
        head = ["Ziel", "Weg", "Pos"]
        (mapped.parent / FILE).write_text(json.dumps([{"head": head, "sheet": settings}]))
    found, expected = (
        json.loads(text) for text in (run("solve", mapped, "--setup", setup, "--json", *more), own)
    )
    assert found["deviations"] == expected["deviations"]
    assert found["verdict"] == expected["verdict"]


def test_what_a_person_states_is_remembered(mapped):
    more = [f"--set=sheet.columns={json.dumps(COLUMNS)}", "--set=sheet.length_unit=mm"]
    asked = ("solve", mapped, "--setup", DATA / "tracer.yaml", "--explain")
    assert "length_m         'Weg' in mm" in run(*asked, *more, "--remember")
    assert (mapped.parent / FILE).is_file()
    assert "answers of table_forms.yaml" in run(*asked)


def test_deviations_and_runs_are_read_by_the_same_map(tmp_path):
    own = tmp_path / "own.csv"
    own.write_text("angle_deg,deviation_arcsec,u_arcsec\n0,0,1\n90,2,1\n180,1,1\n")
    other = tmp_path / "other.csv"
    other.write_text("U,Fehler [urad],angle_deg\n2,0,0\n2,9.69627362219,90\n2,4.848136811,180\n")
    sheet = SheetSettings(columns=("expanded=U", "deviation=Fehler [urad]"), reading_unit="arcsec")
    expected, found = read_reference(read_table(own)), read_deviations(other, sheet=sheet)
    assert found.deviation == pytest.approx(expected.deviation, abs=1e-14)
    assert found.covariance == pytest.approx(expected.covariance)
    text = (DATA / "runs.csv").read_text().replace("angle_deg", "Winkel [deg]")
    (tmp_path / "runs.csv").write_text(text)
    runs = read_any_runs(tmp_path / "runs.csv", SheetSettings(columns=("angle=Winkel [deg]",)))
    assert runs.forward == pytest.approx(read_runs(read_table(DATA / "runs.csv")).forward)
    assert runs.targets[-1] < 2 * pi
