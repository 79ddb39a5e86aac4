"""The demonstration's goal: its candidates, and the paper's plan beside what was measured."""

from math import sqrt
from pathlib import Path

import numpy as np
import pytest
import yaml
from coded import coded

from rotcal_ros.foundation.arrays import rms_about_mean
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods import changed, prepare, prepare_to_measure, read_configuration
from rotcal_ros.methods.goal import goal_standing
from rotcal_ros.methods.tracer.goal_policy import compare, papers_plan
from rotcal_ros.methods.tracer.method import problem
from rotcal_ros.methods.tracer.solver.prediction import predicted
from rotcal_ros.methods.tracer.solver.solve import IN_ONE_PLANE
from rotcal_ros.planning.choices import PolicyProgress, StepChoice

CONFIG = Path(__file__).parents[2] / "config"
DEMO, PAPER = (read_configuration(CONFIG / f"tracer_{name}.yaml") for name in ("demo", "paper"))
MOUNT = np.array([0.0569, -0.0318, 0.1225])


def stations_of(plan):
    c, s = np.cos(plan.table_angles), np.sin(plan.table_angles)
    x, y, z = MOUNT
    return np.column_stack([c * x - s * y, s * x + c * y, np.full(len(c), z)])


def solver_says(configuration, plan, length_std):
    """Return U (k = 2, rms about the mean, rad) of the solver's own covariance."""
    given = changed(configuration, [f"solver.length_std_m={length_std}"])
    exact = [step.observed((0.0,)) for step in plan.steps]
    stations = stations_of(plan)
    covariance = predicted(problem(given, plan, exact), stations).covariance
    m = len(covariance)
    mean_free = covariance - covariance.mean(axis=0) - covariance.mean(axis=1)[:, None]
    return 2.0 * sqrt(np.trace(mean_free + covariance.mean()) / m)


@pytest.fixture(scope="module")
def demo():
    return prepare(DEMO)


def test_the_candidates_are_low_all_around_and_seen(demo):
    stations = stations_of(demo.plan)
    places = np.array([step.position for step in demo.plan.steps])
    beams = places - stations[[step.table_position for step in demo.plan.steps]]
    distance = np.linalg.norm(beams, axis=1)
    assert distance.min() >= 0.25
    assert np.rad2deg(np.arcsin(beams[:, 2] / distance)).min() >= 10.0
    assert np.all((places >= [-0.6, -0.5, 0.17]) & (places <= np.array([0.6, 0.5, 1.02]) + 1e-12))
    low = places[places[:, 2] < 0.35]
    assert np.diff(np.sort(np.arctan2(low[:, 1], low[:, 0]))).max() < np.pi / 4.0


def test_only_pairs_that_are_not_seen_are_left_out(demo):
    whole = prepare(changed(DEMO, ["plan.min_distance_m=0", "plan.min_elevation_deg=-90"])).plan
    kept = {(step.table_position, step.target) for step in demo.plan.steps}
    stations = stations_of(whole)
    for step in whole.steps:
        beam = np.subtract(step.position, stations[step.table_position])
        distance = np.linalg.norm(beam)
        seen = distance >= 0.25 and beam[2] >= np.sin(np.radians(10.0)) * distance
        assert ((step.table_position, step.target) in kept) == seen
    assert [step.index for step in demo.plan.steps] == list(range(len(kept)))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (["plan.tracer_m=[]"], r"give tracer_m: \[x, y, z\]"),
        (["plan.pairs=[0, 0]"], "they do not go with explicit"),
        (["plan.min_elevation_deg=85"], "fewer than 4 targets with a free beam"),
    ],
)
def test_limits_that_cannot_be_obeyed_are_refused(changes, words):
    with pytest.raises(PlanError, match=words):
        prepare_to_measure(changed(DEMO, changes))


def test_both_demonstrations_are_of_one_cell():
    """Table, where the reflector begins, zero, what is hidden, and the pace of the air differ."""
    first, second = (
        yaml.safe_load(given.text)["/**"]["ros__parameters"] for given in (DEMO, PAPER)
    )
    for given in (first, second):
        given["simulation"]["probe"].pop("initial_position_m")
        given["simulation"]["tracer"].pop("dead_distance_m")
        given["simulation"].pop("table")
        given["simulation"]["temperature"].pop("swing_period_s")
        for name in ("blocked_targets", "blocked_from_deg", "blocked_to_deg"):
            given["simulation"]["faults"].pop(name)
    assert first["simulation"] == second["simulation"]
    assert first["capture"] == second["capture"]


def test_the_papers_plan_is_that_of_its_configuration():
    theirs = prepare(PAPER).plan
    plan = papers_plan(theirs.table_angles, MOUNT[2])
    np.testing.assert_allclose(plan.table_angles, theirs.table_angles)
    np.testing.assert_allclose(plan.targets, theirs.targets, atol=1e-12)
    assert [(s.table_position, s.target) for s in plan.steps] == [
        (s.table_position, s.target) for s in theirs.steps
    ]


def test_its_figures_are_those_of_the_solver_and_of_arithmetic(demo):
    steps = list(range(0, len(demo.plan.steps), 20))
    found = compare(DEMO, demo.plan, steps, {steps[3]})
    std = DEMO.planner.expected_std_m
    around = changed(PAPER, ["plan.table_start_deg=0.0", "plan.table_positions=12"])
    papers = solver_says(around, prepare(around).plan, std)
    assert found.papers.lengths == 12 * 64
    assert found.papers.uncertainty == pytest.approx(papers, rel=1e-6)
    assert found.papers.seconds == pytest.approx(767 * (5.0 + 10.0), abs=0.01)
    assert found.own.lengths == len(steps) - 1
    assert found.own.seconds == pytest.approx((len(steps) - 1) * 5.0 + 11 * 10.0, abs=0.01)
    # what the paper's lengths reach is what the demonstration is to reach
    assert papers / ARCSEC == pytest.approx(DEMO.planner.goal_arcsec, rel=0.03)


def test_the_solver_begins_where_the_tracer_stands():
    """Targets in one plane leave a mirror image, unless somebody says where the tracer is."""
    flat = [
        "plan.box_points=[4, 4, 1]",
        "plan.box_centre_m=[0, 0, 0.3]",
        "solver.zero=per_station",
    ]
    placed, silent = (
        prepare(
            changed(DEMO, [*flat, "plan.min_distance_m=0", "plan.min_elevation_deg=null", *more])
        )
        for more in ([], ["plan.tracer_m=[]"])
    )
    warnings = [
        coded(*c.solve(c.measured({}, seed=1).observations).warnings) for c in (placed, silent)
    ]
    assert IN_ONE_PLANE not in warnings[0]
    assert IN_ONE_PLANE in warnings[1]


def test_the_standing_counts_and_tells_why_it_stopped(demo):
    steps = list(range(0, len(demo.plan.steps), 16))
    measured = demo.measured({}, seed=2).observations
    observed = [o for o in measured if o.step in set(steps[1:])]
    goal = 0.79 * ARCSEC
    choices = [StepChoice(step, "first sweep", PolicyProgress(9, 1e-5, goal)) for step in steps]
    choices.append(StepChoice(None, "goal reached", PolicyProgress(0, 0.7 * ARCSEC, goal)))
    result = demo.solve(observed)
    standing = goal_standing(demo, result, choices, observed)
    assert (standing.goal, standing.reason) == (goal, "goal reached")
    assert (standing.measured, standing.candidates) == (len(steps) - 1, len(demo.plan.steps))
    assert standing.compared.own.lengths == len(steps) - 1
    variance = result.covariance["ECC"]
    m = len(variance)
    about = np.trace(variance) - variance.sum() / m
    assert standing.reached == pytest.approx(2.0 * sqrt(about / m))
    assert f"{len(steps) - 1} of {len(demo.plan.steps)} lengths" in standing.describe()
    stopped = goal_standing(demo, result, choices[:-1], observed)
    assert "interrupted" in stopped.reason
    assert (
        goal_standing(
            demo, result, [StepChoice(0, "next of the list", PolicyProgress(1))], observed
        )
        is None
    )


def test_equal_and_independent_values_about_their_mean():
    assert rms_about_mean(9.0 * np.eye(4)) == pytest.approx(3.0 * sqrt(3.0 / 4.0))
    # a common error of all is none
    assert rms_about_mean(np.full((5, 5), 7.0)) == pytest.approx(0.0, abs=1e-7)
