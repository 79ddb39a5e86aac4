"""``rotcal combine``: its result is one like any other for the verbs that take results."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from two_groups import GRID, plate_problem

from rotcal_ros.cli.combine import command
from rotcal_ros.cli.main import rotcal
from rotcal_ros.evaluation.component_groups import ENLARGEMENTS
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.ball_plate.solver import solve

pytestmark = pytest.mark.usefixtures("without_figures")

DATA = Path(__file__).parents[2] / "examples" / "data"
TRACER, PLATE = DATA / "result_tracer.json", DATA / "result_ball_plate.json"


def run(*arguments):
    return CliRunner().invoke(rotcal, [str(argument) for argument in arguments])


@pytest.fixture
def combined(tmp_path):
    path = tmp_path / "combined.json"
    assert run("combine", TRACER, PLATE, "-o", path).exit_code == 0
    return path


def reference(path, shift=0.0):
    result = Result.from_dict(json.loads(TRACER.read_text()))
    rows = [
        f"{np.rad2deg(a)},{d / ARCSEC + shift * (k % 2) + 0.25 * (k % 3 - 1)},0.2"
        for k, (a, d) in enumerate(zip(result.angles, result.deviations["ECC"], strict=True))
    ]
    path.write_text("angle_deg,deviation_arcsec,u_arcsec\n" + "\n".join(rows) + "\n")
    return path


def test_it_reports_compares_and_exports(combined, tmp_path):
    assert run("compare", combined, reference(tmp_path / "reference.csv")).exit_code == 0
    itself = run("compare", combined, TRACER)
    assert itself.exit_code == 3
    assert "share 288 observations" in itself.output
    page = tmp_path / "page.html"
    ran = run("report", combined, "-o", page)
    assert ran.exit_code == 0, ran.output
    text = page.read_text()
    assert "combination" in text
    assert "consistency" in text
    assert "combined.json" in text
    tables = tmp_path / "tables"
    ran = run("export", combined, "--to", "csv", "--replace", "--out", tables)
    assert ran.exit_code == 0, ran.output
    assert list(tables.iterdir())
    ran = run("export", combined, "--to", "volumetric", "--out", tmp_path / "all")
    assert ran.exit_code == 0, ran.output


def test_json_and_words(tmp_path):
    ran = run("combine", TRACER, PLATE, "--json")
    data = json.loads(ran.stdout)
    assert (data["method"], data["verdict"]) == ("combination", "ok")
    assert set(data["details"]["inputs"]) == {str(TRACER), str(PLATE)}
    words = run("combine", TRACER, PLATE)
    assert "chi-square" in words.stderr
    assert "measurement: ok" in words.stderr


def test_sessions_bags_and_references_are_inputs(tmp_path):
    session = tmp_path / "session"
    session.mkdir()
    shutil.copy(TRACER, session / "result.json")
    unfinished = tmp_path / "unfinished"
    unfinished.mkdir()
    shutil.copytree(DATA / "ball_plate_bag", unfinished / "bag")
    table = reference(tmp_path / "polygon.csv")
    ran = run("combine", session, unfinished, table, "--json")
    assert ran.exit_code in (0, 1), ran.output
    methods = [i["method"] for i in json.loads(ran.stdout)["details"]["inputs"].values()]
    assert methods == ["tracer_multistation", "ball_plate", "reference"]


@pytest.mark.slow
def test_the_folder_of_a_session_stands_for_what_is_in_it(tmp_path):
    session = tmp_path / "session"
    session.mkdir()
    shutil.copytree(DATA / "ball_plate_bag", session / "bag")
    configuration = (DATA / "ball_plate.yaml").read_text()
    (session / "configuration.yaml").write_text(configuration.replace("axis: C", "axis: B"))
    page = tmp_path / "page.html"
    assert run("report", session, "-o", page).exit_code == 0
    shutil.copy(PLATE, session / "result.json")
    ran = run("export", session, "--to", "csv", "--replace", "--out", tmp_path / "t", "--json")
    assert ran.exit_code == 0, ran.output
    assert json.loads(ran.stdout)["provenance"]["axis"] == "B"
    assert run("compare", session, TRACER).exit_code == 0


def test_contradicting_inputs_end_with_one(tmp_path):
    table = reference(tmp_path / "polygon.csv", shift=5.0)
    ran = run("combine", PLATE, table, "-o", tmp_path / "c.json")
    assert ran.exit_code == 1
    assert "ECC: the inputs contradict each other" in ran.stderr
    assert "(Birge)" in ran.stderr
    ran = run(
        "export", tmp_path / "c.json", "--to", "linuxcnc", "--replace", "--out", tmp_path / "t"
    )
    assert ran.exit_code == 3
    assert "the verdict of the combination result is 'suspect'" in ran.stderr
    ran = run("combine", PLATE, table, "--enlarge", "mandel-paule")
    assert "(Mandel-Paule)" in ran.stderr


def test_polygon_faces_are_taken_off_references(tmp_path):
    table = reference(tmp_path / "a.csv", shift=5.0)
    faces = tmp_path / "faces.csv"
    angles = [line.split(",")[0] for line in table.read_text().splitlines()[1:]]
    faces.write_text(
        "angle_deg,deviation_arcsec,u_arcsec\n"
        + "".join(f"{a},{5.0 * (k % 2)},0.05\n" for k, a in enumerate(angles))
    )
    assert run("combine", TRACER, table, "--polygon", faces).exit_code == 0
    bare = tmp_path / "bare_faces.csv"
    bare.write_text(re.sub(r",[^,\n]*$", "", faces.read_text(), flags=re.MULTILINE))
    refused = run("combine", TRACER, table, "--polygon", bare)
    assert refused.exit_code == 3
    assert "state one for all rows with --reference-u" in refused.stderr
    assert run("compare", TRACER, table, "--polygon", bare, "--reference-u", "0.1").exit_code < 2
    assert run("combine", TRACER, PLATE, "--polygon", faces).exit_code == 2


def test_what_cannot_be_combined(tmp_path):
    failed = json.loads(TRACER.read_text()) | {"verdict": "failed", "warnings": ["it moved"]}
    path = tmp_path / "failed.json"
    path.write_text(json.dumps(failed))
    ran = run("combine", PLATE, path)
    assert (ran.exit_code, ran.stdout) == (3, "")
    assert "failed.json: the verdict is failed (it moved)" in ran.stderr
    assert run("combine", PLATE, PLATE).exit_code == 3
    assert run("combine", PLATE, tmp_path / "missing.json").exit_code == 2
    assert run("combine").exit_code == 2


def test_the_choice_offers_every_enlargement():
    (option,) = [p for p in command.params if p.name == "enlarge"]
    assert tuple(option.type.choices) == ENLARGEMENTS


def test_two_groups_are_exported_only_when_a_second_result_joins_them(tmp_path):
    """Six balls leave 4 arcsec between odd and even positions open; twelve determine them."""
    six, other, best = (tmp_path / name for name in ("six.json", "other.json", "best.json"))
    six.write_text(solve(plate_problem()).to_json())
    other.write_text(solve(plate_problem(range(GRID), seed=2)).to_json())
    for form in (("--to", "csv", "--replace"), ("--to", "volumetric")):
        refused = run("export", six, *form, "--out", tmp_path / "six")
        assert refused.exit_code == 3
        assert "the offset between the odd and even table positions is not" in refused.output
        assert "rotcal combine" in refused.output
        assert not (tmp_path / "six").exists()
    found = run("combine", six, other, "-o", best)
    assert found.exit_code == 0
    assert "comes from" in found.output
    assert run("export", best, "--to", "csv", "--replace", "--out", tmp_path / "b").exit_code == 0
    assert (tmp_path / "b" / "c_csv.csv").exists()
