"""Plain tables wherever a bag is taken: known by their content, with set-up and changes."""

import csv
import io
import json
import shutil
import zipfile
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner

from rotcal_ros.cli.main import rotcal

pytestmark = pytest.mark.usefixtures("without_figures")

DATA = Path(__file__).parents[2] / "examples" / "data"
TRACER, PLATE = DATA / "tracer.yaml", DATA / "ball_plate.yaml"


def run(*arguments):
    return CliRunner().invoke(rotcal, [str(a) for a in arguments], prog_name="rotcal")


@pytest.fixture
def lengths(tmp_path):
    """The sample lengths with their targets in a folder of their own."""
    shutil.copy(DATA / "targets.csv", tmp_path)
    return Path(shutil.copy(DATA / "lengths.csv", tmp_path))


def solved(*arguments):
    done = run("solve", *arguments, "--json")
    assert done.exit_code == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("name", ["lengths.txt", "lengths.CSV", "lengths", "lengths.dat"])
def test_a_table_is_known_by_its_content(lengths, name):
    expected = solved(lengths, "--setup", TRACER)["deviations"]
    other = lengths.rename(lengths.with_name(name))
    assert solved(other, "--setup", TRACER)["deviations"] == expected


@pytest.mark.parametrize(
    ("method", "place"), [("tracer_multistation", ""), ("tracer_six", "place,")]
)
def test_targets_without_places_are_asked_for_by_their_option(tmp_path, method, place):
    """They counted as the block of the default plan, in which nothing fitted."""
    (setup := tmp_path / "setup.yaml").write_text(f"{{method: {method}, table_positions: 12}}\n")
    (table := tmp_path / "table.csv").write_text(
        f"{place}position,target,length_m\n{place and '0,'}0,0,0.3\n"
    )
    done = run("solve", table, "--setup", setup)
    assert done.exit_code == 2
    assert "give --targets TARGETS.csv with the columns target,x_m,y_m,z_m" in done.stderr
    assert str(setup) in done.stderr


@pytest.mark.parametrize("name", ["lengths.xlsx", "lengths.csv", "lengths.ods"])
@pytest.mark.parametrize("verb", ["solve", "report", "uncertainty"])
def test_a_damaged_workbook_is_told_how_to_be_saved(tmp_path, verb, name):
    with zipfile.ZipFile(tmp_path / name, "w") as file:
        file.writestr("xl/workbook.xml", "")
    done = run(verb, tmp_path / name, "--setup", TRACER)
    assert done.exit_code == 2
    assert "save it as CSV" in done.stderr


def test_explain_says_how_a_table_is_read_and_solves_nothing(lengths):
    text = lengths.read_text().replace("position,target,length_m", "Position,Target,Length [m],By")
    first, *rows = text.splitlines()
    lengths.write_text("\n".join([first, *(f"{row},me" for row in rows)]))
    done = run("solve", lengths, "--setup", TRACER, "--explain")
    assert (done.exit_code, done.stderr) == (0, "")
    for words in ("'Length [m]'", "not needed: By", f"{len(rows)} rows"):
        assert words in done.stdout
    assert "deviations" not in done.stdout


@pytest.mark.parametrize(
    "arguments",
    [
        ("solve", DATA / "runs.csv", "--setup", TRACER),
        ("solve", DATA / "balls.csv", "--setup", TRACER),
        ("report", DATA / "runs.csv", "--setup", TRACER, "-o", "never.html"),
        ("uncertainty", DATA / "runs.csv", "--setup", TRACER),
        ("export", DATA / "runs.csv", "--setup", TRACER, "--to", "csv", "-o", "never"),
        ("iso230", DATA / "lengths.csv"),
        ("compare", DATA / "lengths.csv", DATA / "result_tracer.json"),
        ("combine", DATA / "lengths.csv", DATA / "result_tracer.json"),
        ("check", DATA / "lengths.csv", DATA / "result_tracer.json", "--within", "1"),
        ("solve", DATA / "lengths.csv"),
    ],
    ids=lambda a: f"{a[0]} {a[1].name} {len(a)}",
)
def test_other_columns_are_unreadable_input_for_every_verb(arguments):
    done = run(*arguments)
    assert (done.exit_code, done.stdout) == (2, ""), done.stderr
    assert arguments[1].name in done.stderr


def test_rows_of_balls_are_told_in_words_of_balls(tmp_path):
    path = tmp_path / "balls.csv"
    path.write_text("position,ball_step,x_m,y_m,z_m\n0,7,0.1,0.1,0.0\n")
    done = run("solve", path, "--setup", PLATE)
    assert done.exit_code == 3
    assert "position 0, ball step 7 is not in the plan" in done.stderr
    assert "ball steps 0, 1, 3, 5, 8, 9" in done.stderr


def test_a_set_up_without_a_plan_is_refused(lengths, tmp_path):
    document = yaml.safe_load(TRACER.read_text())
    del document["/**"]["ros__parameters"]["plan"]
    setup = tmp_path / "setup.yaml"
    setup.write_text(yaml.safe_dump(document))
    done = run("solve", lengths, "--setup", setup)
    assert done.exit_code == 2
    assert "no group 'plan'" in done.stderr


def test_changes_reach_tables_and_bags(lengths):
    quiet = solved(lengths, "--setup", TRACER)
    loud = solved(lengths, "--setup", TRACER, "--set", "solver.length_std_m=2.4e-7")
    assert loud["sigma0"] < quiet["sigma0"]
    bag = DATA / "ball_plate_bag"
    as_recorded, changed = solved(bag), solved(bag, "--set", "solver.sigma_centre_m=2e-7")
    assert changed["sigma0"] == pytest.approx(as_recorded["sigma0"] / 2.0)
    assert run("solve", bag, "--set", "solver.sigma_center_m=2e-7").exit_code == 2


@pytest.mark.parametrize(
    ("table", "setup"),
    [("lengths", "tracer"), ("balls", "ball_plate"), ("tracker", "plane_mirror")],
)
def test_a_report_of_a_table(tmp_path, table, setup):
    page = tmp_path / "report.html"
    done = run("report", DATA / f"{table}.csv", "--setup", DATA / f"{setup}.yaml", "-o", page)
    assert done.exit_code == 0, done.stderr
    text = page.read_text()
    assert f"{table}.csv" in text
    assert "ros__parameters" in text  # the configuration that it was solved with


def test_an_export_of_a_table_takes_settings_of_both_sides(lengths, tmp_path):
    done = run(
        "export", lengths, "--setup", TRACER, "--set", "cell.axis=A", "--to", "linuxcnc",
        "--set", "joint=4", "--set", "backlash_deg=0", "--replace", "-o", tmp_path / "files",
        "--accept-unverified",
    )  # fmt: skip
    assert done.exit_code == 0, done.stderr
    assert any("a_" in path.name.lower() for path in (tmp_path / "files").iterdir())


def test_a_result_takes_no_set_up():
    done = run("export", DATA / "result_tracer.json", "--setup", TRACER, "--to", "csv", "-o", "x")
    assert done.exit_code == 2
    assert "is already a result" in done.stderr


def test_a_reference_without_uncertainty_has_to_be_stated(tmp_path):
    path = tmp_path / "reference.csv"
    rows = "\n".join(f"{30 * i},{i % 2}" for i in range(12))
    path.write_text(f"angle_deg,deviation_arcsec\n{rows}\n")
    result = DATA / "result_ball_plate.json"
    refused = run("compare", result, path)
    assert refused.exit_code == 3
    assert "--reference-u" in refused.stderr

    def widths(u):
        done = run("compare", result, path, "--reference-u", u)
        table = csv.DictReader(io.StringIO(done.stdout))
        return [float(row["U (k = 2)/arcsec"]) for row in table]

    # U^2 = U(result)^2 + (2 u)^2 less what the common offset takes of it: 11 of 12 parts of 400
    wider = [a**2 - b**2 for a, b in zip(widths(10), widths(0), strict=True)]
    assert wider == pytest.approx([400.0 * 11 / 12] * 12, rel=0.02)
