"""The verb ``plan``, and ``solve`` with the ball plate's options."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from rotcal_ros.cli import main
from rotcal_ros.foundation.units import ARCSEC

CONFIG = Path(__file__).parents[2] / "config"
PAPER = "0,8,12,18,21,28,32,37,42,50,58,62"


def run(*arguments):
    return CliRunner().invoke(main.rotcal, arguments, prog_name="rotcal")


def plan(*arguments):
    result = run("plan", *arguments, "--json")
    assert result.exit_code == 0, result.stderr
    return json.loads(result.stdout)


def test_best_six_of_the_papers_plate():
    found = plan("plate", "--grid", "72", "--balls", "6", "--subset-of", PAPER)
    assert found["ball_steps"] == [0, 12, 28, 37, 50, 58]
    assert found["evaluated"] == 924
    assert found["optimal"]
    # mean variances by Eq. 21, dense: 0.2120, 0.2039, 0.4561, 0.2309 per unit sigma^2
    std = found["predicted_std"]
    assert std["ECC"] == pytest.approx(0.05e-6 / 0.185 * np.sqrt(0.2120), rel=0.003)
    assert std["EXC"] == pytest.approx(0.05e-6 * np.sqrt(0.2039), rel=0.003)
    assert std["EAC"] == pytest.approx(0.05e-6 / 0.185 * np.sqrt(0.4561), rel=0.003)
    assert std["EZC"] == pytest.approx(0.05e-6 * np.sqrt(0.2309), rel=0.003)
    assert 0.0 < found["gap"] < 0.2
    assert found["orders"]["table_once"]["reversals"] == 0


def test_weights_choose_and_a_gap_is_kept():
    text = run("plan", "plate", "--grid", "24", "--balls", "5", "--weights", "1,0,0,0").stdout
    assert "proven optimal" in text
    assert "ECC  0.0" in text
    found = plan("plate", "--grid", "24", "--balls", "5", "--min-gap", "4", "--weights", "1,0,0,0")
    steps = np.array(found["ball_steps"])
    assert np.diff(steps, append=steps[0] + 24).min() >= 4


def test_effort_reaches_the_limit_with_the_least_work_first():
    found = plan("effort", "--grid", "12", "--need", "ECC=0.06", "--most-balls", "7")
    ways = found["ways"]
    assert [w["centres"] for w in ways] == sorted(w["centres"] for w in ways)
    for way in ways:
        assert way["expanded"] <= 0.06 * ARCSEC
        assert way["centres"] == way["balls"] * way["cmm_positions"]
        assert way["duration_s"] > 0
    words = run("plan", "effort", "--grid", "12", "--need", "ECC=0.06", "--most-balls", "6")
    assert "for U(ECC) <= 0.06 arcsec" in words.stderr
    assert words.stdout.splitlines()[0] == "balls,CMM positions,centres,hours,U/arcsec,ball steps"


def test_effort_that_no_layout_reaches_is_told_in_the_unit_of_the_question():
    refused = run("plan", "effort", "--grid", "12", "--need", "ECC=0.0001", "--most-balls", "6")
    assert refused.exit_code == 2
    assert "U(ECC) <= 0.0001 arcsec with 0.05 um per centre" in refused.stderr


def test_order_lists_every_ball_with_its_duration():
    result = run("plan", "order", str(CONFIG / "ball_plate.yaml"))
    lines = result.stdout.splitlines()
    assert lines[0] == "step,table_deg,ball_step"
    assert len(lines) == 1 + 12 * 72 + 12  # the first table position again
    assert "876 balls" in result.stderr
    found = plan("order", str(CONFIG / "ball_plate_demo.yaml"), "--touch-s", "0.5")
    assert found["centres"] == 444
    assert found["duration_s"] > 432 * 15 * 0.5
    turned = [step["table_deg"] for step in found["steps"]]
    assert turned == sorted(turned)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["plate", "--grid", "12", "--balls", "5", "--weights", "1,x"], "expected numbers"),
        (["plate", "--grid", "12", "--balls", "5", "--weights", "1,1"], "four weights"),
        (["plate", "--grid", "12", "--balls", "5", "--min-gap", "3"], "do not fit"),
        (["plate", "--grid", "12", "--balls", "5", "--subset-of", "0.5"], "whole numbers"),
        (["effort", "--grid", "12", "--need", "ECC"], "COMPONENT=LIMIT"),
        (["effort", "--grid", "12", "--need", "EQC=1"], "unknown component"),
        (["effort", "--grid", "12", "--need", "ECC=1e-6", "--most-balls", "6"], "reaches"),
    ],
)
def test_impossible_wishes_are_explained(arguments, text):
    result = run("plan", *arguments)
    assert result.exit_code == 2
    assert text in result.stderr
    assert "Traceback" not in result.output


def centres_table(path, grid=12, balls=range(12), noise=1e-7, factor=1.0):
    """Write a table of scattered centres of the plain 12-ball plate."""
    rng = np.random.default_rng(3)
    lines = ["position,ball_step,x_m,y_m,z_m"]
    for i in range(grid):
        for j in balls:
            angle = 2 * np.pi * (i + j) / grid
            place = np.array([0.185 * np.cos(angle), 0.185 * np.sin(angle), 0.0])
            x, y, z = (factor * (place + noise * rng.normal(size=3))).tolist()
            lines.append(f"{i},{j},{x!r},{y!r},{z!r}")
    path.write_text("\n".join(lines) + "\n")
    return str(path)


def test_a_table_of_centres_is_solved_with_the_file_of_its_plate(tmp_path):
    table = centres_table(tmp_path / "centres.csv")
    setup = str(CONFIG / "plates" / "ball_plate_12.yaml")
    result = run("solve", table, "--setup", setup, "--json")
    assert result.exit_code == 0, result.stderr
    found = json.loads(result.stdout)
    assert found["method"] == "ball_plate"
    assert set(found["deviations"]) == {"EXC", "EYC", "EZC", "EAC", "EBC", "ECC"}
    assert found["details"]["sigma_centre"] == pytest.approx(1e-7, rel=0.15)
    # closed form of the complete grid: variance of ECC (1 - 1/N) / N per unit sigma^2
    expected = found["details"]["sigma_centre"] / 0.185 * np.sqrt((1 - 1 / 12) / 12)
    assert np.allclose(found["std"]["ECC"], expected, rtol=1e-9)


def test_one_command_evaluates_balls_and_grids_side_by_side(tmp_path):
    table = centres_table(tmp_path / "centres.csv")
    setup = str(CONFIG / "plates" / "ball_plate_12.yaml")
    options = ["--balls", "all", "--balls", "0,1,3,5,8,9", "--coarser", "1"]
    result = run("solve", table, "--setup", setup, *options, "--json")
    assert result.exit_code == 0, result.stderr
    whole, six = json.loads(result.stdout)["evaluations"]
    assert (whole["result"]["n_observations"], six["result"]["n_observations"]) == (144, 72)
    assert six["changes"] == ["solver.balls=[0,1,3,5,8,9]"]
    for name, difference in six["largest_differences"].items():
        assert 0.0 < difference < 5 * max(six["result"]["std"][name])
    both = run("solve", table, "--setup", setup, "--coarser", "1", "--coarser", "2")
    assert both.exit_code == 0, both.stderr
    assert "coarser=2" in both.stdout


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"factor": 1000.0}, "millimetres"),
        ({"balls": [0, 1, 2, 20]}, "is not in the plan"),
        ({"grid": 13, "balls": [0, 1, 2]}, "does the set-up belong to this table"),
    ],
)
def test_bad_tables_are_explained(tmp_path, change, text):
    table = centres_table(tmp_path / "centres.csv", **change)
    result = run("solve", table, "--setup", str(CONFIG / "plates" / "ball_plate_12.yaml"))
    assert result.exit_code == 3
    assert text in result.stderr


@pytest.mark.parametrize(
    ("table", "setup"), [("lengths.csv", "tracer.yaml"), ("tracker.csv", "plane_mirror.yaml")]
)
def test_other_methods_have_no_balls_to_choose(table, setup):
    data = CONFIG.parent / "examples" / "data"
    further = ["--targets", str(data / "targets.csv")] if table == "lengths.csv" else []
    setup = str(data / setup)
    result = run("solve", str(data / table), "--setup", setup, *further, "--coarser", "2")
    assert result.exit_code == 3
    assert "--balls and --coarser are for the data of a ball plate" in result.stderr


@pytest.mark.slow
def test_each_order_is_told_what_drift_and_knocks_would_do():
    found = plan("plate", "--grid", "36", "--balls", "12", "--min-gap", "2", "--starts", "2")
    orders = found["orders"]
    assert set(orders) == {"interleaved", "table_once", "probe_rests"}
    assert orders["table_once"]["duration_s"] < orders["interleaved"]["duration_s"]
    assert max(orders["interleaved"]["unseen_std"].values()) < 2.0
    assert min(orders["table_once"]["unseen_std"].values()) > 2.0
    effects = {(e["kind"], e["axis"]): e for e in orders["table_once"]["effects"]}
    assert len(effects) == 9
    lift = effects["shift", "z"]
    # one turn: from the knock on, every position keeps the lift, less the mean of the curve
    assert 0.5 < lift["error_per_unit"]["EZC"] < 1.0
    assert lift["error_per_unit"]["ECC"] == pytest.approx(0.0, abs=1e-9)
    assert 5e-8 < lift["found_from"] < 3e-7
    coarse = plan(
        "plate", "--grid", "36", "--balls", "12", "--min-gap", "2", "--starts", "2",
        "--sigma-um", "0.1",
    )  # fmt: skip
    again = coarse["orders"]["table_once"]["effects"][5]
    assert again["found_from"] == pytest.approx(2.0 * lift["found_from"], rel=1e-9)
    words = run("plan", "plate", "--grid", "24", "--balls", "5", "--starts", "2").stdout
    assert words.count("CMM drifts in x, 1 um") == 3
    assert "unseen at worst: drift" in words
    assert "(not protected)" in words


def test_a_table_may_hold_the_closing_rows_of_its_plan(tmp_path):
    """The first position again at the end: taken once more, refused the third time."""
    table = Path(centres_table(tmp_path / "centres.csv"))
    rows = table.read_text().splitlines()
    first = [row for row in rows[1:] if row.startswith("0,")]
    setup = str(CONFIG / "plates" / "ball_plate_12.yaml")
    table.write_text("\n".join([*rows, *first]) + "\n")
    result = run("solve", str(table), "--setup", setup, "--json")
    assert result.exit_code == 0, result.stderr
    found = json.loads(result.stdout)
    assert (found["n_observations"], found["n_rejected"]) == (156, 0)
    assert found["details"]["closure"][0]["n_balls"] == 12
    assert "drift" in {p["effect"] for p in found["protections"]}
    table.write_text("\n".join([*rows, *first, first[3]]) + "\n")
    again = run("solve", str(table), "--setup", setup)
    assert again.exit_code == 3
    assert "was measured already" in again.stderr
    assert "2 are in the plan" in again.stderr
