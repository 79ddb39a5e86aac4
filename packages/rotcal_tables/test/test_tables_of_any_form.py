"""Tables as people have them, from the file to the figures, and what a person answers."""

from __future__ import annotations

import csv
import json
import re
import shlex
import shutil
import zipfile
from pathlib import Path

import numpy as np
import openpyxl
import pytest
from click.testing import CliRunner

from rotcal_ros.cli.main import rotcal
from rotcal_ros.foundation.errors import BagError, UndecidedError
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.configuration import changed, parse_configuration
from rotcal_ros.methods.measurements import read_measurements
from rotcal_tables.sheets.files import read_sheets

CASES = Path(__file__).with_name("data")
EXAMPLES = Path(__file__).parents[3] / "examples" / "data"
pytestmark = pytest.mark.usefixtures("without_figures")


def run(*arguments: object, code: int = 0) -> str:
    done = CliRunner().invoke(rotcal, [str(a) for a in arguments], prog_name="rotcal")
    assert done.exit_code == code, done.output
    return done.stderr if code else done.stdout


def combined(path: Path, *more: object) -> tuple[np.ndarray, np.ndarray]:
    """Return angles (deg) and deviations (arcsec) from the first."""
    found = json.loads(run("combine", path, "--reference-u", "0.5", "--json", *more))
    deviation = np.array(found["deviations"]["ECC"]) / ARCSEC
    return np.rad2deg(found["angles_rad"]), deviation - deviation[0]


@pytest.mark.parametrize(
    ("name", "at_30", "at_180"),
    [
        ("target_actual_error.csv", (3.38744 - 2.77135) * 3600, (1.22865 - 2.77135) * 3600),
        ("deviation_in_time_cells.xlsx", 3.2, -61.0),
        ("dms_decimal_comma.csv", 3.2, -61.0),
    ],
)
def test_reference_tables(name: str, at_30: float, at_180: float) -> None:
    angles, deviation = combined(CASES / name)
    np.testing.assert_allclose(angles, np.arange(0.0, 360.0, 30.0), atol=1e-9)
    np.testing.assert_allclose(deviation[[1, 6]], [at_30, at_180], atol=2e-6)


@pytest.mark.parametrize(
    "name", ["actual_positions", "deviations_long", "deviations_matrix", "unknown_headings"]
)
def test_figures_of_iso_230(name: str) -> None:
    found = json.loads(run("iso230", CASES / f"iso230_{name}.csv", "--json"))
    expected = {
        "reversal": 184.46, "mean_reversal": 127.60, "repeatability": 853.74,
        "systematic": 228.75, "mean_range": 80.14, "accuracy": 876.13,
        "accuracy_forward": 509.00, "accuracy_reverse": 876.13,
    }  # fmt: skip
    for figure, arcsec in expected.items():
        assert found[figure] / ARCSEC == pytest.approx(arcsec, abs=0.006), figure


def test_positions_in_place_of_deviations_are_refused_with_advice_that_works(tmp_path) -> None:
    text = (CASES / "iso230_actual_positions.csv").read_text().replace("Actual position", "Error")
    (table := tmp_path / "runs.csv").write_text(text)
    said = run("iso230", table, code=2)
    assert "grows with the table angle by 1.00" in said
    _, option = shlex.split(re.search(r"--set \S+", said)[0])
    assert json.loads(run("iso230", table, "--set", option, "--json"))["reversal"] / ARCSEC == (
        pytest.approx(184.46, abs=0.006)
    )


def test_one_ball_with_its_nominal_places(tmp_path) -> None:
    (setup := tmp_path / "b.yaml").write_text(
        "method: table_balls\nmeasure: centre\nballs_m: [[0.15, 0, 0.08]]\n"
    )
    done = CliRunner().invoke(
        rotcal, ["solve", str(CASES / "balls_meas_nom.csv"), "--setup", str(setup), "--json"]
    )
    assert "not needed: Nom X [mm], Nom Y [mm], Nom Z [mm]" in done.stderr
    axes = json.loads(done.stdout)["axes"][0]
    place = dict(zip(axes["names"], axes["value"], strict=True))
    assert place["XOC"] == pytest.approx(50e-6, abs=1.5e-6)
    assert place["YOC"] == pytest.approx(-30e-6, abs=1.5e-6)


@pytest.mark.parametrize("word", ["setting", "Mounting", "Reading", "Foo"])
def test_any_word_with_a_number_is_a_matrix(tmp_path, word: str) -> None:
    text = (CASES / "polygon_settings.csv").read_text().replace("setting", word)
    (table := tmp_path / "p.csv").write_text(text)
    found = json.loads(run("solve", table, "--setup", CASES / "polygon_settings.yaml", "--json"))
    deviation = np.array(found["deviations"]["ECC"]) / ARCSEC
    with (CASES / "polygon_settings.truth.csv").open() as file:
        truth = [float(row["deviation_arcsec"]) for row in csv.DictReader(file)]
    expanded = 2.0 * np.array(found["std"]["ECC"])[:12] / ARCSEC
    assert np.all(np.abs(deviation[:12] - truth) <= expanded + 1e-9)


@pytest.mark.parametrize("unit", [" [mm]", " / mm", " (mm)"])
def test_points_of_lengths_are_a_matrix_too(tmp_path, unit: str) -> None:
    rows = list(csv.reader((EXAMPLES / "lengths.csv").open()))[1:]
    by_position: dict[str, dict[int, float]] = {}
    for position, target, length in rows:
        by_position.setdefault(position, {})[int(target)] = float(length) * 1000.0
    targets = sorted(by_position["0"])
    head = ["position", *(f"Point {t + 1}{unit}" for t in targets)]
    body = [[p, *(f"{of[t]:.7f}" for t in targets)] for p, of in by_position.items()]
    text = "\n".join(";".join(row) for row in [head, *body])
    (tmp_path / "matrix.csv").write_text(text)
    shutil.copy(EXAMPLES / "targets.csv", tmp_path)
    one, other = (
        json.loads(run("solve", path, "--setup", EXAMPLES / "tracer.yaml", "--json"))
        for path in (EXAMPLES / "lengths.csv", tmp_path / "matrix.csv")
    )
    np.testing.assert_allclose(one["deviations"]["ECC"], other["deviations"]["ECC"], atol=1e-10)


# Angles of the table and of the plan.


@pytest.fixture
def five_degrees_on(tmp_path) -> Path:
    shutil.copy(EXAMPLES / "targets.csv", tmp_path)
    return Path(shutil.copy(CASES / "lengths_5_degrees_on.csv", tmp_path))


def test_angles_of_a_table_are_not_moved_to_those_of_a_plan(five_degrees_on, tmp_path) -> None:
    own, planned = np.arange(5.0, 360.0, 30.0), np.arange(0.0, 360.0, 30.0)
    with_plan = ("solve", five_degrees_on, "--setup", EXAMPLES / "tracer.yaml")
    said = run(*with_plan, code=2)
    assert "the table angle 5 degrees is not in the plan; the nearest there is 0 degrees" in said
    for answer, expected in (("table", own), ("plan", planned)):
        found = json.loads(run(*with_plan, "--set", f"sheet.angles={answer}", "--json"))
        np.testing.assert_allclose(np.rad2deg(found["angles_rad"]), expected, atol=1e-9)
    run("new", "-y", "--method", "tracer_multistation", "-o", tmp_path / "new.yaml")
    found = json.loads(run("solve", five_degrees_on, "--setup", tmp_path / "new.yaml", "--json"))
    np.testing.assert_allclose(np.rad2deg(found["angles_rad"]), own, atol=1e-9)


SETUP = "method: angle_comparison\nshifts_deg: [0, 30, 60]\nsigma_arcsec: 0.05\n"
UNEVEN = [0.0, 31.0, 59.0, 92.0, 120.0, 149.0, 181.0, 243.0, 300.0]


def readings(path: Path, angles: list[float]) -> Path:
    rows = [f"{a},{s},{0.1 * s}" for a in angles for s in range(3)]
    path.write_text("\n".join(["Angle [deg],setting,reading [arcsec]", *rows]))
    return path


def planned(*angles: float):
    text = f"{SETUP}table_angles_deg: {list(angles)}\n" if angles else SETUP
    return parse_configuration(text, "setup.yaml")


def test_uneven_angles_are_asked_about_too(tmp_path) -> None:
    table = readings(tmp_path / "t.csv", UNEVEN)
    near = planned(*(30.0 * round(angle / 30.0) for angle in UNEVEN))
    with pytest.raises(UndecidedError, match="31 degrees is not in the plan"):
        read_measurements(table, near)
    for setup in (changed(near, ["sheet.angles=table"]), planned()):
        measured = read_measurements(table, setup)
        assert measured.configuration.plan.table_angles_deg == tuple(UNEVEN)
        assert measured.configuration.plan.shifts_deg == (0.0, 30.0, 60.0)


@pytest.mark.parametrize(("noise", "asked"), [(0.009, False), (0.012, True)])
def test_the_noise_of_a_read_out_is_no_other_angle(tmp_path, noise: float, asked: bool) -> None:
    table = readings(tmp_path / "t.csv", [a + noise for a in UNEVEN])
    said: list = []
    if asked:
        with pytest.raises(UndecidedError):
            read_measurements(table, planned(*UNEVEN))
        return
    measured = read_measurements(table, planned(*UNEVEN), announce=said.append)
    assert measured.configuration.plan.table_angles_deg == tuple(UNEVEN)
    assert f"table angles are off by up to {noise} degrees" in said[0].line()
    assert "table angles of the plan in setup.yaml" in said[0].line()


@pytest.mark.parametrize("answer", ["table", "plan"])
def test_angles_that_scatter_beyond_a_read_out_are_asked_about(tmp_path, answer) -> None:
    rows = [f"{a + 0.02 * (s == 1)},{s},{0.1 * s}" for a in UNEVEN for s in range(3)]
    (table := tmp_path / "t.csv").write_text(
        "\n".join(["Angle [deg],setting,reading [arcsec]", *rows])
    )
    with pytest.raises(UndecidedError, match=r"0 and 0\.02 degrees differ by more than the noise"):
        read_measurements(table, planned())
    measured = read_measurements(table, changed(planned(), [f"sheet.angles={answer}"]))
    angles = measured.configuration.plan.table_angles_deg
    apart = [UNEVEN, [a + 0.02 for a in UNEVEN]] if answer == "table" else [UNEVEN, UNEVEN]
    np.testing.assert_allclose(angles, sorted({*apart[0], *apart[1]}), atol=1e-9)
    seen = [
        (angles[o.table_position], o.station, o.mean[0] / ARCSEC) for o in measured.observations
    ]
    expected = [(apart[s == 1][k], s, 0.1 * s) for k in range(len(UNEVEN)) for s in range(3)]
    np.testing.assert_allclose(seen, expected, atol=1e-9)


def test_close_angles_of_a_fine_curve_are_not_asked_about(tmp_path) -> None:
    fine = [round(0.05 * k, 2) for k in range(40)]
    measured = read_measurements(readings(tmp_path / "t.csv", fine), planned())
    assert measured.configuration.plan.table_angles_deg == tuple(fine)


@pytest.mark.parametrize("second", ["Foo [arcsec]", "Foo [deg]", "Foo"])
def test_unknown_headings_are_asked_in_turn_and_each_option_adds_up(tmp_path, second) -> None:
    rows = [f"{a},{a * (second == 'Foo [deg]') + (a % 7) / 4000:.5f}" for a in range(0, 360, 30)]
    (table := tmp_path / "t.csv").write_text("\n".join([f"Bar [deg],{second}", *rows]))
    given: list[str] = []
    for _ in range(4):
        done = CliRunner().invoke(
            rotcal, ["combine", str(table), "--reference-u", "1", "--json", *given]
        )
        if done.exit_code < 2:
            break
        assert done.exit_code == 2
        assert f"column 2 {second!r}: first" in done.stderr
        given += shlex.split(re.search(r"--set ('[^']+'|\S+)", done.stderr)[0])
    found = np.array(json.loads(done.stdout)["deviations"]["ECC"])
    assert len(found) == 12
    unit = {"Foo [arcsec]": ARCSEC}.get(second, np.deg2rad(1) if "deg" in second else ARCSEC)
    assert found[1] - found[0] == pytest.approx(2 / 4000 * unit, rel=1e-4)


# Targets, of one source.


@pytest.mark.parametrize("moved", [0.0, 1e-4])
def test_targets_of_two_sources(tmp_path, moved: float) -> None:
    book = openpyxl.Workbook()
    for name, sheet in (("lengths", book.active), ("targets", book.create_sheet())):
        sheet.title = name
        for row in csv.reader((EXAMPLES / f"{name}.csv").open()):
            sheet.append([float(c) if re.fullmatch(r"[-\d.e]+", c) else c for c in row])
    book["targets"]["B2"].value += moved
    book.save(table := tmp_path / "measured.xlsx")
    arguments = ("solve", table, "--setup", EXAMPLES / "tracer.yaml", "--explain")
    assert f"targets of {table}, sheet targets" in run(*arguments)
    beside = shutil.copy(EXAMPLES / "targets.csv", tmp_path)
    if not moved:
        assert f"targets of {beside}" in run(*arguments)
        return
    said = run(*arguments, code=3)
    assert f"targets stand in {beside} and in {table}, sheet targets, and they differ" in said
    assert f"targets of {beside}" in run(*arguments, "--targets", beside)


def test_two_sheets_of_targets_that_no_one_chose_are_refused(tmp_path) -> None:
    book = openpyxl.Workbook()
    for name, source in (("lengths", "lengths"), ("targets", "targets"), ("old", "targets")):
        sheet = book.create_sheet(name)
        for row in csv.reader((EXAMPLES / f"{source}.csv").open()):
            sheet.append([float(c) if re.fullmatch(r"[-\d.e]+", c) else c for c in row])
    book.remove(book.worksheets[0])
    book.save(table := tmp_path / "measured.xlsx")
    said = run("solve", table, "--setup", EXAMPLES / "tracer.yaml", code=3)
    assert "the sheets targets and old have the same columns: which targets count?" in said
    run("solve", table, "--setup", EXAMPLES / "tracer.yaml", "--explain",
        "--targets", EXAMPLES / "targets.csv")  # fmt: skip


# What a person says is kept, and belongs to the tables that it is of.


def test_an_answer_is_remembered_for_tables_of_the_form(tmp_path) -> None:
    rows = "".join(f"{a};{a / 100}\n" for a in range(0, 360, 30))
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text(f"Winkel [°];Soll-Ist [arcsec]\n{rows}", encoding="utf-8")
    (tmp_path / "other.csv").write_text(f"Winkel [°];Nennwert-Ist [arcsec]\n{rows}", "utf-8")
    combine = ("--reference-u", "0.5")
    run("combine", tmp_path / "a.csv", *combine, code=2)
    answer = ("--set", 'sheet.columns=["reversed=Soll-Ist [arcsec]"]')
    run("combine", tmp_path / "a.csv", *combine, *answer)
    run("combine", tmp_path / "b.csv", *combine, code=2)
    _, told = combined(tmp_path / "a.csv", *answer, "--remember")
    _, again = combined(tmp_path / "b.csv")
    read = CliRunner().invoke(rotcal, ["combine", str(tmp_path / "b.csv"), *combine]).stderr
    assert "answers of table_forms.yaml" in read
    np.testing.assert_allclose(again, told)
    assert told[3] == pytest.approx(-0.9)
    run("combine", tmp_path / "other.csv", *combine, code=2)


def test_a_column_of_one_of_two_tables(tmp_path) -> None:
    for name, head in (("a", "Angle [deg],Deviation [arcsec]"), ("b", "Angle [deg],Foo [arcsec]")):
        rows = "".join(f"{a},{a % 7}\n" for a in range(0, 360, 30))
        (tmp_path / f"{name}.csv").write_text(f"{head}\n{rows}")
    tables = ("compare", tmp_path / "a.csv", tmp_path / "b.csv", "--reference-u", "1")
    said = run(*tables, code=2)
    _, option = shlex.split(re.search(r"--set '[^']+'", said)[0])
    run(*tables, "--set", option)
    assert "in any of them" in run(*tables, "--set", "sheet.columns=[deviation=Bar]", code=2)


def test_a_table_alone_says_that_nothing_checked_it() -> None:
    said = CliRunner().invoke(
        rotcal, ["combine", str(CASES / "target_actual_error.csv"), "--reference-u", "5"]
    )
    assert "nothing checked its values" in said.stderr
    assert "Not tested for: drift, knock," in said.stderr


# Workbooks beyond all bounds.

PARTS = {
    "[Content_Types].xml": '<Types xmlns="http://schemas.openxmlformats.org/package/2006/'
    'content-types"><Default Extension="rels" ContentType="application/vnd.openxmlformats-'
    'package.relationships+xml"/><Default Extension="xml" ContentType="application/xml"/></Types>',
    "_rels/.rels": '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/'
    'relationships"><Relationship Id="r1" Type="http://schemas.openxmlformats.org/officeDocument/'
    '2006/relationships/officeDocument" Target="xl/workbook.xml"/></Relationships>',
    "xl/workbook.xml": '<workbook xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/'
    'main" xmlns:r="http://schemas.openxmlformats.org/officeDocument/2006/relationships"><sheets>'
    '<sheet name="S" sheetId="1" r:id="r1"/></sheets></workbook>',
    "xl/_rels/workbook.xml.rels": '<Relationships xmlns="http://schemas.openxmlformats.org/'
    'package/2006/relationships"><Relationship Id="r1" Type="http://schemas.openxmlformats.org/'
    'officeDocument/2006/relationships/worksheet" Target="worksheets/sheet1.xml"/><Relationship '
    'Id="r2" Type="http://schemas.openxmlformats.org/officeDocument/2006/relationships/'
    'sharedStrings" Target="sharedStrings.xml"/></Relationships>',
}


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        (['<row r="1"><c r="A1"><v>1</v></c></row>',
          '<row r="20000"><c r="XFD20000"><v>2</v></c></row>'], "x"),
        ([f'<row r="{k}"><c r="A{k}" t="s"><v>0</v></c></row>' for k in range(1, 20_001)],
         "x" * 100_000),
    ],
    ids=["a cell far away", "a long text in many cells"],
)  # fmt: skip
def test_a_small_workbook_that_unpacks_without_end_is_refused(tmp_path, rows, text) -> None:
    main = 'xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"'
    with zipfile.ZipFile(path := tmp_path / "t.xlsx", "w", zipfile.ZIP_DEFLATED) as file:
        for name, part in PARTS.items():
            file.writestr(name, part)
        file.writestr(
            "xl/worksheets/sheet1.xml",
            f"<worksheet {main}><sheetData>{''.join(rows)}</sheetData></worksheet>",
        )
        file.writestr("xl/sharedStrings.xml", f"<sst {main}><si><t>{text}</t></si></sst>")
    assert path.stat().st_size < 200_000
    with pytest.raises(BagError, match=r"more than .* cells or .* copy the table into a new"):
        read_sheets(path)


@pytest.mark.parametrize("form", ["[h]:mm:ss", "h:mm:ss"])
@pytest.mark.parametrize(("heading", "sure"), [("Deviation [dms]", True), ("Deviation", False)])
def test_times_of_a_workbook_are_sixtieths_where_the_heading_says_so(
    tmp_path, form: str, heading: str, sure: bool
) -> None:
    book = openpyxl.Workbook()
    book.active.append(["Angle [dms]", heading])
    for angle in range(0, 360, 30):
        book.active.append([angle / 24.0, angle / 100.0 / 86_400.0])
        for cell in book.active[book.active.max_row]:
            cell.number_format = form
    book.save(path := tmp_path / "t.xlsx")
    if not sure:
        assert "sheet.reading_unit=dms" in run("combine", path, "--reference-u", "1", code=2)
    more = () if sure else ("--set", "sheet.reading_unit=dms")
    angles, deviation = combined(path, *more)
    np.testing.assert_allclose(angles, np.arange(0.0, 360.0, 30.0), atol=1e-9)
    np.testing.assert_allclose(deviation, np.arange(0.0, 3.6, 0.3), atol=1e-3)
