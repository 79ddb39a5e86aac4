"""Tables of a result: what stands in them, and that files keep every bit."""

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import rotcal_ros as rc
from rotcal_ros.cli.main import rotcal
from rotcal_ros.foundation.results import Result
from rotcal_ros.methods import find_method
from rotcal_ros.methods.result_tables import ResultTable, deviations_table, steps_table

DATA = Path(__file__).parents[2] / "examples" / "data"


def tables_of(result: Result) -> dict[str, ResultTable]:
    return {table.name: table for table in find_method(result.method).tables(result)}


def column(table: ResultTable, name: str) -> np.ndarray:
    return np.array([row[table.head.index(name)] for row in table.rows])


@pytest.fixture(scope="module")
def stations():
    setup = rc.read_configuration(DATA / "paper/stations.yaml")
    return rc.read_table(DATA / "paper/stations.csv", setup).solve()


def test_the_papers_tables_are_those_of_a_tracer(stations):
    """Tables 1 to 3 of the paper, and its Eq. 34 to 36."""
    found = tables_of(stations)
    assert set(found) == {"stations", "circle"}
    table = found["stations"]
    assert column(table, "x_mm")[0] == pytest.approx(-64.9938, abs=1e-9)
    assert column(table, "projected_z_mm")[[0, 10]] == pytest.approx(
        [122.5133, 122.5118], abs=5e-5
    )
    assert column(table, "d_mm")[5] == pytest.approx(1128.5378, abs=1e-9)
    values = {row[0]: row[1] for row in found["circle"].rows}
    assert values["centre x"] == pytest.approx(-0.1434, abs=5e-5)
    assert values["sigma of the steps (Eq. 34, with their number)"] == pytest.approx(
        0.88, abs=0.005
    )
    (steps,) = steps_table(stations, stated=True)
    assert column(steps, "step_arcsec")[3] == pytest.approx(-9.9, abs=0.2)


@pytest.mark.parametrize(
    ("file", "names"),
    [
        ("result_tracer.json", {"stations", "targets", "target_corrections", "circle"}),
        ("result_ball_plate.json", {"balls", "machine", "residuals"}),
    ],
)
def test_a_result_that_was_read_has_its_tables(file, names):
    result = rc.read_result(DATA / file)
    found = tables_of(result)
    assert set(found) == names
    for table in found.values():
        assert {len(row) for row in table.rows} == {len(table.head)}
        assert len(table.shown()) == len(table.rows)


def test_small_numbers_are_shown_with_their_digits(stations):
    shown = {row[0]: row[1] for row in tables_of(stations)["circle"].shown()}
    assert shown["normal x"] == "1.952667e-05"
    assert shown["centre x"] == "-0.1433856"
    assert float(shown["largest algorithm error (Eq. 36)"]) == pytest.approx(3e-5, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("entry", ["axial", "radial", "tilt", "station_ids"])
def test_details_that_were_cut_cost_the_tables_and_not_the_report(tmp_path, entry):
    data = json.loads((DATA / "result_tracer.json").read_text())
    data["details"][entry] = None
    (tmp_path / "cut.json").write_text(json.dumps(data))
    asked = ["report", str(tmp_path / "cut.json"), "-o", str(tmp_path / "cut.html")]
    ran = CliRunner().invoke(rotcal, [*asked, "--tables", str(tmp_path / "tables")])
    assert ran.exit_code == 0, ran.output
    assert "deviations.csv" in {path.name for path in (tmp_path / "tables").iterdir()}


def test_a_mirror_lists_what_its_stations_share():
    setup = rc.read_configuration(DATA / "plane_mirror.yaml")
    found = tables_of(rc.read_table(DATA / "tracker.csv", setup).solve())
    assert {"stations", "normals"} <= set(found)
    normals = found["normals"]
    length = np.array([column(normals, axis) for axis in "xyz"])
    np.testing.assert_allclose((length**2).sum(axis=0), 1.0, atol=1e-12)
    angles = column(normals, "angle_deg")
    assert len(set(angles)) < len(angles)  # positions that two stations have seen


def test_numbers_in_a_file_keep_every_bit(stations):
    rows = list(csv.DictReader(io.StringIO(deviations_table(stations, stated=True).to_csv())))
    read = np.array([float(row["ECC_arcsec"]) for row in rows])
    np.testing.assert_array_equal(read, stations.deviations["ECC"] / rc.ARCSEC)
    assert "U_ECC_arcsec" not in deviations_table(stations, stated=False).head


@pytest.mark.parametrize(
    ("head", "words"),
    [
        ("x_mm", "x / mm"), ("projected_z_mm", "projected z / mm"), ("U_x_um", "U(x) / µm"),
        ("ECC_arcsec", "ECC / arcsec"), ("angle_deg", "angle / °"), ("test_value", "test value"),
        ("position", "position"), ("U_step_arcsec", "U(step) / arcsec"),
    ],
)  # fmt: skip
def test_heads_of_a_page_are_words_with_a_unit(head, words):
    assert ResultTable("t", "t", (head,), ()).heads() == [words]


@pytest.mark.slow
def test_the_verb_writes_files_and_overwrites_none(tmp_path):
    result, folder = DATA / "result_tracer.json", tmp_path / "tables"

    def report(name):
        asked = ["report", str(result), "-o", str(tmp_path / name), "--tables", str(folder)]
        return CliRunner().invoke(rotcal, asked)

    assert report("a.html").exit_code == 0
    names = {path.name for path in folder.iterdir()}
    assert names == {
        "deviations.csv", "steps.csv", "stations.csv", "targets.csv", "circle.csv",
        "target_corrections.csv",
    }  # fmt: skip
    page = (tmp_path / "a.html").read_text()
    assert "<summary>Stations of the tracer, and as projected on their plane</summary>" in page
    refused = report("b.html")
    assert refused.exit_code == 2
    assert "is not empty, and nothing is overwritten" in refused.output
    assert not (tmp_path / "b.html").exists()
