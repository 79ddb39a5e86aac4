"""``rotcal compare``, ``iso230`` and ``uncertainty``: output, JSON, pictures and exit codes."""

import json
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from rotcal_ros.cli.main import rotcal
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods import find_method
from rotcal_ros.methods.configuration import dump_configuration

pytestmark = pytest.mark.usefixtures("without_figures")


def truth(degrees):
    t = np.deg2rad(degrees)
    return 8.0 * np.sin(t + 0.4) + 2.0 * np.cos(3 * t + 0.5)


def run(*arguments):
    return CliRunner().invoke(rotcal, [str(argument) for argument in arguments])


def table(path, degrees, values, std=0.2):
    rows = [f"{a:g},{v:.6f},{std}" for a, v in zip(degrees, values, strict=True)]
    path.write_text("angle_deg,deviation_arcsec,u_arcsec\n" + "\n".join(rows) + "\n")
    return path


def result_file(path, degrees, values, std=0.2):
    n = len(degrees)
    spread = np.full(n, std * ARCSEC)
    result = Result(
        method="ball_plate",
        angles=np.deg2rad(degrees),
        deviations={"ECC": values * ARCSEC, "EXC": np.zeros(n)},
        std={"ECC": spread, "EXC": np.full(n, 1e-7)},
        covariance={"ECC": np.diag(spread**2), "EXC": 1e-14 * np.eye(n)},
        sigma0=1.0,
        dof=100,
        n_observations=200,
    )
    path.write_text(result.to_json())
    return path


@pytest.fixture
def rng():
    return np.random.default_rng(3)


@pytest.fixture
def pair(tmp_path, rng):
    fine, coarse = np.arange(24) * 15.0, np.arange(12) * 30.0
    first = result_file(tmp_path / "plate.json", coarse, truth(coarse) + rng.normal(0, 0.05, 12))
    second = table(tmp_path / "polygon.csv", fine, truth(fine) + 5.0 + rng.normal(0, 0.05, 24))
    return first, second


def test_compare_result_with_reference(pair):
    ran = run("compare", *pair, "--json")
    assert ran.exit_code == 0, ran.output
    data = json.loads(ran.stdout)
    (only,) = data["pairs"]
    assert data["all_within_one"]
    assert data["agree"]
    assert only["offset"] / ARCSEC == pytest.approx(-5.0, abs=0.3)
    assert np.rad2deg(only["angles"]) == pytest.approx(np.arange(12) * 30.0)
    assert not any(only["interpolated"])
    words = run("compare", *pair)
    assert words.stderr.splitlines()[-1].startswith(f"{pair[0]} - {pair[1]}: agree: rms 0.")


def test_compare_three_draws_a_page_and_a_figure(pair, tmp_path, rng):
    third = table(tmp_path / "third.csv", np.arange(16) * 22.5, truth(np.arange(16) * 22.5))
    page, figure = tmp_path / "page.html", tmp_path / "figure.svg"
    assert run("compare", *pair, third, "-o", page).exit_code == 0
    text = page.read_text()
    assert text.count("interpolated</td>") > 0
    assert "polygon.csv − " in text
    assert not re.search(r"""(src|href)=["']http|url\(http|<script""", text)
    assert run("compare", *pair, "-o", figure).exit_code == 0
    assert ElementTree.parse(figure).getroot().tag.endswith("svg")
    assert run("compare", *pair, "-o", tmp_path / "figure.png").exit_code == 2


def test_a_comparison_speaks_german(pair, tmp_path):
    page = tmp_path / "page.html"
    assert run("compare", *pair, "-o", page, "--language", "de").exit_code == 0
    text = page.read_text()
    assert '<html lang="de">' in text
    assert "<title>Vergleich von ECC</title>" in text
    assert "größter |E_n|" in text
    assert 'lang="en"' not in text
    assert run("compare", tmp_path, "--truth", "--language", "de").exit_code == 2


def test_polygon_is_taken_off(tmp_path, rng):
    degrees = np.arange(24) * 15.0
    faces = rng.normal(0.0, 3.0, 24)
    plate = result_file(tmp_path / "a.json", degrees, truth(degrees))
    reading = table(tmp_path / "b.csv", degrees, truth(degrees) + faces)
    polygon = table(tmp_path / "faces.csv", degrees, faces, 0.05)
    assert run("compare", plate, reading).exit_code == 1
    assert run("compare", plate, reading, "--polygon", polygon).exit_code == 0
    assert run("compare", plate, plate.rename(tmp_path / "c.json"), "--polygon", polygon).exit_code


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda a, v: (a, v / 3600.0), "degrees taken for arcseconds"),
        (lambda a, v: (a, v / 60.0), "arcminutes taken for arcseconds"),
        (lambda a, v: (a, -v), "its sign is reversed"),
        (lambda a, v: (a, -truth(-a)), "counted clockwise"),
    ],
)
def test_reference_in_the_wrong_unit_or_sense_is_named(tmp_path, change, reason):
    degrees = np.arange(24) * 15.0
    plate = result_file(tmp_path / "a.json", degrees, truth(degrees))
    wrong = table(tmp_path / "b.csv", *change(degrees, truth(degrees)))
    ran = run("compare", plate, wrong)
    assert ran.exit_code == 1
    assert reason in ran.stderr
    assert "DISAGREE" in ran.stderr


@pytest.mark.parametrize(
    ("text", "code", "found"),
    [
        ("angle,weather\n0,1\n", 2, "no column deviation_rad"),
        ("angle_deg,deviation_arcsec\n0,1\n10,x\n20,1\n", 3, "row 3"),
        ("angle_deg,deviation_arcsec\n0,1\n0,1\n20,1\n", 3, "occurs twice"),
        ("angle_deg,deviation_arcsec\n0,1\n180,2\n270,2\n360,9\n", 3, "same table position"),
        ("angle_deg,deviation_arcsec\n0,1\n120,1\n240,1\n", 3, "states no uncertainty"),
    ],
)
def test_damaged_reference(pair, tmp_path, text, code, found):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    ran = run("compare", pair[0], path)
    assert (ran.exit_code, ran.stdout) == (code, "")
    assert found in ran.stderr
    assert "bad.csv" in ran.stderr


def test_a_truth_is_pointed_to_its_own_option(pair, tmp_path):
    (tmp_path / "truth.json").write_text('{"angles_rad": [0.0], "deviations": {"ECC": [0.0]}}')
    ran = run("compare", pair[0], tmp_path / "truth.json")
    assert ran.exit_code == 3
    assert f"rotcal compare --truth {tmp_path}" in ran.stderr


def test_compare_refuses_what_it_cannot_compare(pair, tmp_path):
    assert run("compare", pair[0]).exit_code == 2
    assert run("compare", pair[0], pair[0]).exit_code == 2
    assert run("compare", pair[0], tmp_path / "missing.json").exit_code == 2
    no_such = run("compare", *pair, "--component", "EXC")
    assert no_such.exit_code == 3
    assert "ECC only" in no_such.stderr
    broken = tmp_path / "broken.json"
    broken.write_text('{"schema": 1}')
    assert run("compare", pair[1], broken).exit_code == 3
    broken.write_text("not json")
    assert run("compare", pair[1], broken).exit_code == 2


UP = ([0, 3, 5, 2, -1, -4, -3, -1], [0.2, 0.2, 0.4, 0.2, 0.2, 0.3, 0.2, 0.2])
DOWN = ([-2, 0, 2, 0, -4, -6, -6, -2], [0.2, 0.3, 0.2, 0.2, 0.5, 0.2, 0.2, 0.2])


def runs_file(path, skip=-1):
    rows = [
        f"{45 * i},{j + 1},{name},{mean[i] + spread[i] * (j - 2)}"
        for name, (mean, spread) in (("up", UP), ("down", DOWN))
        for i in range(8)
        for j in range(5)
    ]
    del rows[skip : skip + 1 if skip >= 0 else skip]
    path.write_text("angle_deg,run,direction,deviation_arcsec\n" + "\n".join(rows) + "\n")
    return path


def test_iso230_gives_the_figures_that_the_hand_gives(tmp_path):
    path, figure = runs_file(tmp_path / "runs.csv"), tmp_path / "iso.svg"
    ran = run("iso230", path, "--json", "-o", figure)
    assert ran.exit_code == 0, ran.output
    data = json.loads(ran.stdout)
    s = np.sqrt(2.5) * ARCSEC
    # R at 180 degrees: 2 s_up + 2 s_down + |B|; A: 5 + 2 s (90) against -6 - 2 s (225, 270)
    assert data["repeatability"] == pytest.approx(2 * 0.2 * s + 2 * 0.5 * s + 3 * ARCSEC)
    assert data["accuracy"] == pytest.approx(11 * ARCSEC + 2 * 0.4 * s + 2 * 0.2 * s)
    assert data["systematic"] == pytest.approx(11 * ARCSEC)
    assert data["reversal"] == pytest.approx(3 * ARCSEC)
    assert data["mean_range"] == pytest.approx(8.5 * ARCSEC)
    assert data["warnings"] == []
    assert ElementTree.parse(figure).getroot().tag.endswith("svg")
    words = run("iso230", path).stderr
    assert "Accuracy A" in words
    assert "Accuracy A: 12.9 arcsec" in words


def test_iso230_names_a_missing_target(tmp_path):
    ran = run("iso230", runs_file(tmp_path / "runs.csv", skip=7))
    assert ran.exit_code == 3
    assert "missing 45 deg in run 3 up" in ran.stderr


def test_iso230_explains_a_table_of_our_own_and_stops(tmp_path):
    own = run("iso230", runs_file(tmp_path / "runs.csv"), "--explain")
    assert (own.exit_code, own.stderr) == (0, "")
    assert "read as it stands" in own.stdout


def test_iso230_needs_runs(pair):
    ran = run("iso230", pair[0])
    assert ran.exit_code == 3
    assert "bidirectional" in ran.stderr


@pytest.fixture
def configuration(tmp_path):
    text = dump_configuration(
        "tracer_multistation",
        {
            "plan": {
                "table_step_deg": 60.0,
                "table_positions": 6,
                "box_points": [3, 3, 2],
                "box_size_m": [0.9, 0.9, 0.4],
            },
            "solver": {"length_std_m": 2e-7, "target_std_m": 1e-6},
        },
    )
    path = tmp_path / "cell.yaml"
    path.write_text(text)
    return path


@pytest.mark.slow
def test_uncertainty_is_the_same_whatever_the_number_of_workers(configuration):
    """Blocks of 2000: three of them, on one worker and on two."""
    one = run("uncertainty", configuration, "--trials", 6000, "--workers", 1, "--json")
    two = run("uncertainty", configuration, "--trials", 6000, "--workers", 2, "--json")
    assert (one.exit_code, two.exit_code) == (0, 0), one.output
    assert one.stdout == two.stdout
    data = json.loads(one.stdout)
    part = data["components"]["ECC"]
    assert data["warnings"] == []
    assert part["std"] == pytest.approx(part["linear_std"], rel=0.05)
    other = run("uncertainty", configuration, "--trials", 100, "--seed", 2, "--json")
    assert json.loads(other.stdout)["components"]["ECC"]["std"] != part["std"]


def test_uncertainty_in_words(configuration):
    ran = run("uncertainty", configuration, "--trials", 400, "--workers", 1)
    assert ran.exit_code == 0
    assert "400 trials confirm the solver's uncertainty; not yet stable" in ran.stderr


def test_uncertainty_of_a_method_without_trials(configuration, monkeypatch):
    bare = replace(find_method("tracer_multistation"), trials=None)
    monkeypatch.setattr("rotcal_ros.methods.configuration.find_method", lambda _name: bare)
    ran = run("uncertainty", configuration, "--trials", 10)
    assert ran.exit_code == 2
    assert "no Monte Carlo trials" in ran.stderr


@pytest.mark.parametrize(
    ("table", "setup"),
    [("lengths", "tracer"), ("balls", "ball_plate"), ("tracker", "plane_mirror")],
)
def test_uncertainty_of_a_plain_table(table, setup):
    data = Path(__file__).parents[2] / "examples" / "data"
    source, given = data / f"{table}.csv", data / f"{setup}.yaml"
    ran = run("uncertainty", source, "--setup", given, "--trials", 2000, "--json", "--workers", 1)
    assert ran.exit_code == 0, ran.output
    for part in json.loads(ran.stdout)["components"].values():
        measured = np.array(part["linear_std"]) > 0.0
        ratio = np.array(part["std"])[measured] / np.array(part["linear_std"])[measured]
        assert ratio == pytest.approx(np.ones(len(ratio)), abs=0.08)
    assert run("uncertainty", source).exit_code == 2
    assert run("uncertainty", given, "--setup", given).exit_code == 2


@pytest.mark.slow
@pytest.mark.parametrize("name", ["plane_mirror_demo", "ball_plate_demo", "tracer_paper"])
def test_uncertainty_of_every_method_before_anything_is_measured(name, tmp_path):
    path = Path(__file__).parents[2] / "config" / f"{name}.yaml"
    text = path.read_text()
    if name == "ball_plate_demo":
        refused = run("uncertainty", path, "--trials", 100)
        assert refused.exit_code == 2
        assert "sigma_centre_m" in refused.stderr
        document = yaml.safe_load(text)
        document["/**"]["ros__parameters"].setdefault("solver", {})["sigma_centre_m"] = 1e-7
        text = yaml.safe_dump(document)
    given = tmp_path / "cell.yaml"
    given.write_text(text)
    ran = run("uncertainty", given, "--trials", 2000, "--workers", 1, "--json")
    assert ran.exit_code == 0, ran.output
    for part in json.loads(ran.stdout)["components"].values():
        assert part["std"] == pytest.approx(part["linear_std"], rel=0.1)
        assert part["value"] == pytest.approx(np.zeros(len(part["value"])), abs=1e-10)


def test_the_uncertainty_of_a_simulation_says_that_nothing_was_measured():
    data = Path(__file__).parents[2] / "examples" / "data"
    found = CliRunner().invoke(
        rotcal, ["uncertainty", str(data / "lengths.csv"), "--setup", str(data / "tracer.yaml"),
                 "--trials", "50", "--workers", "1"],
    )  # fmt: skip
    assert "SIMULATED: no instrument measured this" in found.stderr


@pytest.fixture
def case(tmp_path):
    """Return the folder of a measurement with its truth, and results that are right and wrong."""
    degrees = np.arange(0, 360, 45)
    deviations = {"ECC": (ARCSEC * truth(degrees)).tolist(), "EXC": [0.0] * 8}
    true = {"schema": 1, "angles_rad": np.deg2rad(degrees).tolist(), "deviations": deviations}
    (tmp_path / "truth.json").write_text(json.dumps({**true, "effect": "drift"}))
    result_file(tmp_path / "result.json", degrees, truth(degrees))
    result_file(tmp_path / "result_bad.json", degrees, truth(degrees) + 3.0 * np.cos(degrees))
    return tmp_path


def test_results_are_scored_against_the_truth(case):
    done = run("compare", case, "--truth", "--json")
    assert done.exit_code == 1
    told = json.loads(done.stdout)
    right = {(s["entry"], s["component"]): s["agree"] for s in told["scores"]}
    assert right == {
        ("result", "ECC"): True, ("result", "EXC"): True, ("bad", "ECC"): False,
        ("bad", "EXC"): True,
    }  # fmt: skip
    assert {(row["entry"], row["quantity"], row["misleading"]) for row in told["leaderboard"]} == {
        ("result", "rotations", 0), ("result", "translations", 0), ("bad", "rotations", 1),
        ("bad", "translations", 0),
    }  # fmt: skip


def test_the_leaderboard_is_one_table_and_what_misleads_a_sentence(case):
    done = run("compare", case, "--truth")
    head, *rows = done.stdout.splitlines()
    assert head.startswith("method,entry,errors of,curves,plain rms,rms,largest,say ok,")
    assert len(rows) == 4
    assert "bad: ECC is off by up to" in done.stderr
    (case / "result_bad.json").unlink()
    assert run("compare", case, "--truth").exit_code == 0


def test_truth_takes_one_folder_and_no_other_option(case, tmp_path):
    for also in ([case / "result.json"], ["--align-order", "1"], ["--reference-u", "1"]):
        done = run("compare", case, *also, "--truth")
        assert done.exit_code == 2
        assert "--truth takes one FOLDER" in done.stderr
    (case / "truth.json").unlink()
    done = run("compare", case, "--truth")
    assert done.exit_code == 2
    assert "there is no truth.json in it or below" in done.stderr
