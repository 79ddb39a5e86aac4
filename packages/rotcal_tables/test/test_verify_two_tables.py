"""``rotcal verify BEFORE --after AFTER``: tables of deviations and results, without a cell."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from rotcal_ros.cli.main import rotcal

ANGLES = np.arange(0, 360, 15)
TRUE = 10.0 * np.cos(np.deg2rad(ANGLES)) + 3.0 * np.sin(np.deg2rad(4 * ANGLES))


def run(*arguments):
    return CliRunner().invoke(rotcal, [str(a) for a in arguments], prog_name="rotcal")


@pytest.fixture
def table(tmp_path):
    def write(name, values, head="deviation_arcsec"):
        rows = "".join(f"{a},{v:.4f}\n" for a, v in zip(ANGLES, values, strict=True))
        (tmp_path / name).write_text(f"angle [deg],{head}\n{rows}")
        return tmp_path / name

    return write


def test_before_and_after_stand_side_by_side_and_the_exit_code_is_that_of_a_cell(table, tmp_path):
    before = table("before.csv", TRUE)
    noise = np.random.default_rng(4).normal(0.0, 0.1, len(ANGLES))
    stated = ("--reference-u", 0.1)
    good = run("verify", before, "--after", table("after.csv", noise), *stated)
    assert good.exit_code == 0, good.stderr
    assert good.stdout.splitlines()[0].startswith("angle/deg,before/arcsec,U(before)")
    assert "that the table was loaded is shown by its effect alone" in good.stderr
    for name, values, words in (
        ("none.csv", TRUE + noise, "it is inactive"),
        ("turned.csv", 2.0 * TRUE + noise, "its sign is wrong"),
    ):
        out = tmp_path / name[:-4]
        args = ("--after", table(name, values), *stated, "--json", "-o", out)
        failed = run("verify", before, *args)
        assert failed.exit_code == 1
        data = json.loads(failed.stdout)
        assert (data["verdict"], words in data["effect"]["words"]) == ("failed", True)
        assert [*data["sources_sha256"][1]] == [name]
        assert json.loads((out / "verification.json").read_text()) == data
        assert (out / "verification.svg").read_text().count("<svg") == 1


def test_results_take_the_place_of_tables_and_a_second_table_may_be_of_the_other_sign(
    table, tmp_path
):
    before = table("before.csv", TRUE)
    noise = np.random.default_rng(5).normal(0.0, 0.1, len(ANGLES))
    result = tmp_path / "before.json"
    assert run("solve", before, "-o", result, "--set", "solver.u_arcsec=0.1").exit_code == 0
    after = table("after.csv", -2.0 * TRUE + noise, "error [arcsec]")
    asked = run("verify", result, "--after", after, "--reference-u", 0.1)
    assert asked.exit_code == 2
    assert "sheet.values=corrections" in asked.stderr
    said = ("--check", "sheet.values=corrections", "--reference-u", 0.1)
    found = run("verify", result, "--after", after, *said)
    assert found.exit_code == 1
    assert "its sign is wrong" in found.stderr


def test_the_files_of_the_table_say_what_it_corrects_and_leaves(table, tmp_path):
    before, stated = table("before.csv", TRUE), ("--reference-u", 0.1)
    for name, source in (("own", before), ("other", table("other.csv", TRUE[::-1]))):
        written = ("--to", "csv", "--axis", "C", "--replace", "-o", tmp_path / name)
        assert run("export", source, *written, *stated).exit_code == 0
    noise = np.random.default_rng(6).normal(0.0, 0.1, len(ANGLES))
    args = ("verify", before, "--after", table("after.csv", noise), *stated, "--json")
    own = json.loads(run(*args, "--table", tmp_path / "own").stdout)
    side = json.loads((tmp_path / "own" / "c_csv.provenance.json").read_text())
    assert own["stated_residual_arcsec"] == pytest.approx(side["residual_arcsec"]["stated"])
    assert own["verdict"] == "ok"
    assert abs(own["effect"]["factor"]) < 0.02
    assert not any("not made of the first" in note for note in own["notes"])
    other = json.loads(run(*args, "--table", tmp_path / "other", "--to", "csv").stdout)
    assert any("not made of the first measurement" in note for note in other["notes"])
    nowhere = run(*args, "--table", tmp_path / "own", "--to", "fanuc")
    assert nowhere.exit_code == 2
    assert "(csv, C)" in nowhere.stderr


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("x.yaml", "--table", "t"), "--table: only with --after TABLE"),
        (("--after", "a.csv"), "--after needs what was measured before"),
        (("b.csv", "--after", "a.csv", "--again", "--loaded"), "--again, --loaded: only with"),
        (("b.csv", "--after", "a.csv", "--to", "csv"), "give both"),
    ],
)
def test_options_of_the_other_way_are_refused(args, words):
    refused = run("verify", *args)
    assert refused.exit_code == 2
    assert words in refused.stderr
