"""The verb ``plan``, and ``solve`` with the ball plate's options."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from rotcal_ros.cli import main

CONFIG = Path(__file__).parents[2] / "config"


def run(*arguments):
    return CliRunner().invoke(main.rotcal, arguments, prog_name="rotcal")


def plan(*arguments):
    result = run("plan", *arguments, "--json")
    assert result.exit_code == 0, result.stderr
    return json.loads(result.stdout)


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
    assert found["residuals"]["std"] == pytest.approx([1e-7] * 144, rel=0.15)
    # closed form of the complete grid: variance of ECC (1 - 1/N) / N per unit sigma^2
    expected = 1e-7 / 0.185 * np.sqrt((1 - 1 / 12) / 12)
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
    assert "--balls, --coarser and --groups are for the data of a ball plate" in result.stderr


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
    assert len(found["details"]["closed"][0]["error"]) == 6
    assert "drift" in {p["effect"] for p in found["protections"]}
    table.write_text("\n".join([*rows, *first, first[3]]) + "\n")
    again = run("solve", str(table), "--setup", setup)
    assert again.exit_code == 3
    assert "was measured already" in again.stderr
    assert "measures it 2 times" in again.stderr


POWER_PLAN = str(CONFIG.parent / "research" / "power_plans" / "angle_comparison.yaml")


@pytest.mark.slow
def test_power_tells_what_each_effect_does_before_the_verdict_turns():
    """Angles feel no shift of the axis; noise of 50 times the stated one nobody overlooks."""
    wanted = ("--effect", "error motion", "--runs", "10")
    told = plan("power", POWER_PLAN, *wanted, "--effect", "axis noise")
    assert told["runs"] == 10
    assert told["false_alarms"] <= 3  # at 5 % each: more, once in 1000
    noise, motion = told["effects"]
    assert (noise["effect"], noise["noticed"], noise["misleads"]) == ("axis noise", True, False)
    assert 1.0 < noise["size"] < 50.0
    assert (motion["effect"], motion["treatment"]) == ("error motion", "harmless")
    assert (motion["noticed"], motion["error_std"]) == (False, 0.0)
    done = run("plan", "power", POWER_PLAN, *wanted)
    assert done.stdout.splitlines() == [
        "effect,treatment,size,error/std,named", "error motion,harmless,not up to 1 arcsec,0,no",
    ]  # fmt: skip


def test_an_effect_that_a_method_does_not_know_is_refused_with_those_it_knows():
    done = run("plan", "power", POWER_PLAN, "--effect", "growth")
    assert done.exit_code == 2
    assert "has no effect growth; it has axis noise, drift, error motion" in done.stderr
