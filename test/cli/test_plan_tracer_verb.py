"""The verb ``plan tracer``: what it prints and writes, and what it refuses."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from rotcal_ros.catalogue import prepare, read_configuration
from rotcal_ros.cli import main

SMALL = (
    "--set", "table_positions=6", "--set", "table_step_deg=60", "--set", "spacing_m=0.3",
    "--set", "exchanges=6", "--set", "starts=1",
)  # fmt: skip


def run(*arguments):
    return CliRunner().invoke(main.rotcal, ("plan", "tracer", *arguments), prog_name="rotcal")


def test_a_plan_is_printed_and_written_and_can_be_measured(tmp_path):
    result = run("--need", "ECC=2.5", *SMALL, "-o", str(tmp_path), "--json")
    assert result.exit_code == 0, result.stderr
    found = json.loads(result.stdout)
    assert found["expanded_rms_arcsec"] <= 2.5
    assert found["bound"] <= found["ideal"] <= found["lengths"]
    assert found["gap"] <= 0.1
    assert found["smallest_redundancy"] >= 0.25
    assert found["largest_undetected_in_u"] <= 1.0 + 1e-6
    plan = prepare(read_configuration(tmp_path / "plan.yaml")).plan
    assert len(plan.steps) == found["lengths"]
    assert len(plan.targets) == found["targets"]
    assert np.degrees(plan.table_angles) == pytest.approx(np.arange(6) * 60.0)
    assert np.abs(np.array(plan.targets)[:, 0]).max() <= 0.6
    assert len({(s.table_position, s.target) for s in plan.steps}) == found["lengths"]
    # every angle once, 10 s for a turn, 5 s for a length, moves of the machine besides
    assert found["time_s"] >= 5.0 * (found["lengths"] - 1) + 10.0 * 5


@pytest.mark.parametrize("wanted", ["12", "30"])
def test_a_loose_goal_has_a_plan_that_checks_itself(wanted):
    # whatever reaches 6 arcsec reaches 30 as well
    small = (*SMALL, "--set", "spacing_m=0.2", "--set", "exchanges=40")
    result = run("--need", f"ECC={wanted}", *small, "--json")
    assert result.exit_code == 0, result.stderr
    found = json.loads(result.stdout)
    assert found["smallest_redundancy"] >= 0.25
    assert found["largest_undetected_in_u"] <= 1.0 + 1e-6
    assert found["lengths"] < 100


def test_the_plain_minimum_warns():
    result = run("--need", "ECC=2.5", *SMALL, "--plain")
    assert result.exit_code == 0, result.stderr
    assert "do not check each other" in result.stderr
    assert "bound: no plan in this volume" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("--need", "EXC=1"), "expected ECC=ARCSEC"),
        (("--need", "ECC=0.0001", *SMALL), "wanted of them is 0.0001"),
        (("--set", "sigma=3"), "unknown setting 'sigma'"),
        (("--set", "error_motion_std_m=1.0e-6", *SMALL), "no number of lengths helps"),
        (("missing.yaml",), "cannot read the goal missing.yaml: No such file"),
        (("--set", "keep_out_m=[1, 2"), "keep_out_m=[1, 2: not valid YAML"),
        (("--set", "keep_out_m=[1, -1, 0, -1, 1, 2]"), "is no box"),
        (("--set", "keep_out_m=[-1, -1, 0, 1, 1, 2]"), "no target is left"),
        (("--set", "keep_out_m=[-0.1, -0.1, 0, 0.1, 0.1, 2]"), "the tracer itself may stand in"),
        (("--set", "spacing_m=0.005"), "give a larger spacing_m"),
        (("--set", "table_positions=2"), "a circle takes 3"),
        (("--set", "mount_m=[0.0, 0.0, 0.1]"), "stands on the table's axis"),
        (("--set", "length_std_m=-1.0e-7"), "out of range"),
        (("--set", "lenght_std_m=1.0e-7"), "did you mean 'length_std_m'"),
        (("--set", "target_std_m=[1.0e-6, 1.0e-6, 2.0e-6]", "-o", "nowhere"), "three equal ones"),
    ],
)
def test_refusals(arguments, text):
    result = run(*arguments)
    assert result.exit_code == 2
    assert text in result.stderr


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("/**: {ros__parameters: {method: tracer_multistation}}", "'rotcal plan tracer --like'"),
        ("- 1.2", "expected lines of NAME: VALUE"),
        ("need_arcsec: [1.2", "not valid YAML"),
    ],
)
def test_files_that_hold_no_goal_are_refused(tmp_path, text, message):
    goal = tmp_path / "goal.yaml"
    goal.write_text(text + "\n")
    result = run(str(goal))
    assert result.exit_code == 2
    assert message in result.stderr
