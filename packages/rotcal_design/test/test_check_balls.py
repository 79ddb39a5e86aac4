"""The quick check by ball plate: the fewest CMM positions, and what their measurement decides."""

import json
from pathlib import Path

import numpy as np
import pytest
from chances import share
from click.testing import CliRunner

from rotcal_design.check_balls import plan_ball_check
from rotcal_ros.cli.main import rotcal
from rotcal_ros.evaluation.quick_check import quick_check
from rotcal_ros.foundation.curves.measured import MeasuredCurve, measured_curve
from rotcal_ros.foundation.errors import ConfigurationError, PlanError
from rotcal_ros.foundation.units import ARCSEC, TURN
from rotcal_ros.methods import prepare_to_measure, read_configuration
from rotcal_ros.methods.ball_plate.solver import BallPlateProblem, solve
from rotcal_ros.methods.configuration import changed
from rotcal_ros.planning.check_rule import CheckRule

ROOT = Path(__file__).parents[3]
SETUP = ROOT / "config" / "ball_plate.yaml"
SMALL = (
    "plan.plate.grid=12", "plan.plate.ball_steps=[0, 1, 3, 5, 8, 9]",
    "solver.sigma_centre_m=1e-7", "plan.rounds=0",
)  # fmt: skip
ANGLES = np.arange(12) * TURN / 12
CURVE = 2.0 * ARCSEC * np.cos(ANGLES - 0.3)
U = 0.05 * ARCSEC


def configured(*changes):
    return changed(read_configuration(SETUP), [*SMALL, *changes])


def earlier(period=TURN):
    return MeasuredCurve(ANGLES, CURVE, U**2 * np.eye(12), period, "ok")


def measured(configuration, deviation, rng):
    """Return the solver's result of a plan on a table that turns by so much more."""
    plate, sigma = configuration.plan.plate, configuration.solver.sigma_centre_m
    steps = prepare_to_measure(configuration).plan.steps
    position = np.array([step.table_position for step in steps])
    ball = np.array([step.target for step in steps])
    angle = TURN * (position + ball) / plate.grid + deviation[position]
    centres = plate.circle_radius_m * np.column_stack(
        [np.cos(angle), np.sin(angle), np.zeros(len(angle))]
    )
    noise = sigma * rng.standard_normal(centres.shape)
    return solve(
        BallPlateProblem(
            plate.grid, plate.circle_radius_m, position, ball, centres + noise, sigma=sigma
        )
    )


def test_the_predicted_uncertainty_is_that_of_the_solver_for_what_the_plan_measures():
    plan = plan_ball_check(configured(), earlier(), CheckRule(0.5 * ARCSEC))
    assert 4 < len(plan.positions) < 12
    assert plan.at_each_angle.min() >= 4
    assert plan.at_each_angle.sum() == 6 * len(plan.positions)
    found = measured(plan.configuration, CURVE, np.random.default_rng(1))
    assert found.std["ECC"] == pytest.approx(plan.std, rel=0.02)
    assert (found.std["ECC"] <= plan.std).all()  # the first position once more tells a little
    assert found.angles == pytest.approx(plan.angles)


def test_of_good_tables_as_many_are_found_valid_as_the_plan_says_and_of_bad_ones_few():
    rule, rng, runs = CheckRule(0.5 * ARCSEC), np.random.default_rng(2), 30
    plan = plan_ball_check(configured(), earlier(), rule)
    valid, missed = 0, 0
    for _ in range(runs):
        error = U * rng.standard_normal(12)
        for beyond in (False, True):
            off = 1.1 * rule.limit * np.eye(12)[3] * 12.0 / 11.0 if beyond else error
            new = measured_curve(measured(plan.configuration, CURVE + off, rng))
            found = quick_check(earlier(), new, rule).verdict == "still valid"
            missed, valid = missed + (beyond and found), valid + (not beyond and found)
    assert valid / runs >= share(1.0 - rule.false_alarm, runs)[0]
    assert missed / runs <= share(0.05, runs)[1]


def test_a_wider_limit_takes_fewer_balls_and_too_narrow_a_one_is_refused():
    plans = [
        plan_ball_check(configured(), earlier(), CheckRule(x * ARCSEC)) for x in (0.27, 0.29, 3.0)
    ]
    counts = [len(plan.positions) for plan in plans]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > counts[1] > counts[2]
    with pytest.raises(PlanError, match="even 6 balls at all 12 CMM positions"):
        plan_ball_check(configured(), earlier(), CheckRule(0.1 * ARCSEC))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("solver.sigma_centre_m=0.0", "sigma_centre_m is absent"),
        ("solver.drift=linear", "solver.drift is linear"),
        ("plan.bidirectional=true", "plan.bidirectional is True"),
    ],
)
def test_settings_that_promise_something_else_are_refused(change, words):
    with pytest.raises(ConfigurationError, match=words):
        plan_ball_check(configured(change), earlier(), CheckRule(ARCSEC))


def test_the_curve_of_an_arc_is_refused():
    with pytest.raises(PlanError, match="that of an arc"):
        plan_ball_check(configured(), earlier(period=0.0), CheckRule(ARCSEC))


def test_the_verb_writes_a_plan_that_measures_what_it_says(tmp_path):
    asked = ("--setup", SETUP, "--set", "solver.sigma_centre_m=1e-7", "--within", "2")
    result = ROOT / "examples" / "data" / "result_ball_plate.json"
    ran = run("plan", "check", result, *asked, "-o", tmp_path, "--json")
    assert ran.exit_code == 0, ran.output
    told = json.loads(ran.stdout)
    steps = prepare_to_measure(read_configuration(tmp_path / "check.yaml")).plan.steps
    measured_once = {(step.table_position, step.target) for step in steps}
    assert len(measured_once) == told["centres"] < told["offered"] / 2
    refused = run("plan", "check", result, *asked, "--every", "2")
    assert (refused.exit_code, "are for a laser tracer" in refused.stderr) == (2, True)


def run(*arguments):
    return CliRunner().invoke(rotcal, [str(argument) for argument in arguments])
