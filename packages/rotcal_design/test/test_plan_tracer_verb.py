"""The verb ``plan tracer``: what it prints and writes, and what it refuses."""

import importlib.util
import json
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml
from click.testing import CliRunner
from few_runs import few_runs

from rotcal_design.tracer import ordering
from rotcal_ros.cli import main
from rotcal_ros.methods import prepare, read_configuration

SCRIPT = Path(__file__).parents[3] / "research" / "plan_promise.py"
spec = importlib.util.spec_from_file_location("plan_promise", SCRIPT)
promise = importlib.util.module_from_spec(spec)
spec.loader.exec_module(promise)

SMALL = (
    "--set", "table_positions=6", "--set", "table_step_deg=60", "--set", "spacing_m=0.3",
    "--set", "exchanges=6", "--set", "starts=1",
)  # fmt: skip
HALF = ("--confidence", "0.5")
"""A promise that few simulated runs test, for tests that are about something else."""


@pytest.fixture(autouse=True)
def _twenty_runs(monkeypatch):
    few_runs(monkeypatch, 20)


def run(*arguments):
    return CliRunner().invoke(main.rotcal, ("plan", "tracer", *arguments), prog_name="rotcal")


def test_a_plan_is_printed_and_written_and_can_be_measured(tmp_path):
    result = run("--need", "ECC=2.5", *SMALL, *HALF, "-o", str(tmp_path), "--json")
    assert result.exit_code == 0, result.stderr
    found = json.loads(result.stdout)
    assert found["promised_rms_arcsec"] <= 2.5
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


def solver_of(folder):
    return yaml.safe_load((folder / "plan.yaml").read_text())["/**"]["ros__parameters"]["solver"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("motion", "confidence"),
    [
        pytest.param(None, 0.95, marks=pytest.mark.long),
        (0.0, 0.8),
        pytest.param(None, 0.8, marks=pytest.mark.long),
        pytest.param(0.0, 0.95, marks=pytest.mark.long),
        pytest.param(1e-7, 0.95, marks=pytest.mark.long),
    ],
)
def test_results_of_a_plan_state_what_it_promises(tmp_path, motion, confidence, monkeypatch):
    """The goal is met as often as is promised, and what that assumes is said and written down."""
    few_runs(monkeypatch, 150 if confidence < 0.9 else 400)
    stated = () if motion is None else ("--set", f"error_motion_std_m={motion:.1e}")
    command = ("--need", "ECC=2.5", *SMALL, *stated, "--confidence", str(confidence))
    data = run(*command, "--json", "-o", str(tmp_path))
    assert data.exit_code == 0, data.stderr
    found = json.loads(data.stdout)
    assert found["confidence"] == confidence
    assert found["promised_rms_arcsec"] <= 2.5
    assert found["expanded_rms_arcsec"] <= found["promised_rms_arcsec"]
    assert solver_of(tmp_path).get("error_motion_std_m") == motion == found["error_motion_std_m"]
    runs = 150
    own = list(promise.results(tmp_path, runs))
    rms, largest = np.array([(np.sqrt((u**2).mean()), u.max()) for _, u in own]).T
    met = (np.array([ok for ok, _ in own]) & (rms <= 2.5) & (largest <= 2.75)).mean()
    assert met >= confidence - 3 * np.sqrt(confidence * (1 - confidence) / runs)
    assert np.median(rms) == pytest.approx(found["expanded_rms_arcsec"], rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ((), "which is not stated, so that the solver estimates it"),
        (("error_motion_std_m=0.0",), "a table without error motion, stated as 0"),
        (("error_motion_std_m=1.0e-7",), "error motion of the table 0.1 um (k = 1)"),
        (
            ("circle_std_m=7.0e-8", "zero=one"),
            "error motion of the table 0.07 um (k = 1), stations on a circle to 0.07 um",
        ),
    ],
)
def test_what_a_promise_assumes_is_printed(setting, words):
    changes = [part for one in setting for part in ("--set", one)]
    result = run("--need", "ECC=4", *SMALL, *HALF, *changes)
    assert result.exit_code == 0, result.stderr
    assert "assumed: a length 0.2 um (k = 1, readings and all), a target 1 um" in result.stdout
    assert words in result.stdout
    assert "that results state: with a probability of 50 % at most" in result.stdout
    assert "% are sound but not called ok, which more lengths do not change" in result.stdout


@pytest.mark.slow
def test_what_protection_costs_is_told(tmp_path, monkeypatch):
    """Of 2.5 arcsec in 6 angles: the time is that of the lengths, 5 s each, and of 10 s turns."""
    monkeypatch.setattr(ordering, "ordered_design", cache(ordering.ordered_design))
    command = ("--need", "ECC=2.5", *SMALL, *HALF, "--set", "error_motion_std_m=0.0")
    found = json.loads(run(*command, "--json", "-o", str(tmp_path)).stdout)
    assert solver_of(tmp_path)["error_motion_std_m"] == 0.0 == found["error_motion_std_m"]
    assert found["lengths_s"] == 5.0 * (found["lengths"] - 1)
    assert found["turns_s"] == pytest.approx(found["time_s"] - found["lengths_s"])
    assert found["turns_s"] == pytest.approx(10.0 * round(found["turns_s"] / 10.0), abs=0.01)
    # once round takes five turns, and hides any drift; that the order does not is what it takes
    assert found["quickest_s"] == pytest.approx(found["lengths_s"] + 50.0, abs=0.01)
    assert found["quickest_s"] <= found["time_s"]
    worst = max(value or np.inf for value in found["unseen_std"].values())
    assert max(value or np.inf for value in found["quickest_unseen_std"].values()) > worst
    words = run(*command).stdout
    assert f"{found['lengths_s']:.0f} s for the lengths and {found['turns_s']:.0f} s for" in words
    more = found["lengths"] - found["bound"]
    assert f"what protection costs: {more} lengths more than the bound, so that each" in words
    assert f"{found['time_s'] - found['quickest_s']:.0f} s more than the quickest order" in words


@pytest.mark.slow
def test_a_goal_that_only_an_estimate_misses_says_what_would_help():
    result = run("--need", "ECC=1.0", *SMALL)
    assert result.exit_code == 2
    assert "state error_motion_std_m, which the solver would else estimate" in result.stderr


@pytest.mark.slow
def test_a_pattern_tells_what_its_solver_will_do(tmp_path):
    pattern = tmp_path / "like.yaml"
    pattern.write_text(
        "/**:\n  ros__parameters:\n    method: tracer_multistation\n"
        "    planner: {expected_std_m: 3.0e-7}\n"
        "    solver: {length_std_m: 1.0e-7, circle_std_m: 9.0e-8, variant: station}\n".replace(
            ", variant: station", ""
        )
    )
    out = tmp_path / "out"
    result = run(
        "--like", str(pattern), "--need", "ECC=8", *SMALL, *HALF, "--set", "circle_std_m=null",
        "--set", "error_motion_std_m=1.0e-7", "-o", str(out),
    )  # fmt: skip
    assert result.exit_code == 0, result.stderr
    assert "a length 0.3 um" in result.stdout  # what the readings add is in the plan
    solver = solver_of(out)
    assert solver["length_std_m"] == 1e-7  # and joins it once more from the bag alone
    assert solver["error_motion_std_m"] == 1e-7
    assert "circle_std_m" not in solver


@pytest.mark.slow
@pytest.mark.parametrize("wanted", ["30"])
def test_a_loose_goal_has_a_plan_that_checks_itself(wanted):
    # whatever reaches 6 arcsec reaches 30 as well
    small = (*SMALL, "--set", "spacing_m=0.2", "--set", "exchanges=40")
    result = run("--need", f"ECC={wanted}", *small, *HALF, "--json")
    assert result.exit_code == 0, result.stderr
    found = json.loads(result.stdout)
    assert found["smallest_redundancy"] >= 0.25
    assert found["largest_undetected_in_u"] <= 1.0 + 1e-6
    assert found["lengths"] < 100


@pytest.mark.slow
def test_the_plain_minimum_warns():
    result = run("--need", "ECC=2.5", *SMALL, "--plain")
    assert result.exit_code == 0, result.stderr
    assert "do not check each other: an error of any size stays unseen in" in result.stderr
    assert "% of simulated results have a verdict ok and meet the goal" in result.stderr
    assert re.search(r"of \d+ simulated runs \d+\.\d % end ok and meet the goal", result.stdout)
    assert "bound: no plan in this volume" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("--need", "EXC=1"), "expected ECC=ARCSEC"),
        (("--need", "ECC=0.0001", *SMALL), "the goal is 0.0001"),
        (("--set", "sigma=3"), "unknown setting 'sigma'"),
        (("--set", "error_motion_std_m=1.0e-6", *SMALL), "more lengths do not help"),
        (("--need", "ECC"), "--need ECC: expected ECC=ARCSEC, e.g. ECC=1.2"),
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
