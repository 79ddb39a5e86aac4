"""The policy until_goal, on simulated tracers with a generator and an estimator of their own."""

from dataclasses import replace

import numpy as np
import pytest
from chances import LONG, share
from simulated import figures

from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.tracer.policy.experiment import Allowance
from rotcal_ros.methods.tracer.policy.until_goal import UntilGoal, first_sweep
from rotcal_ros.methods.tracer.solver.prediction import predicted
from rotcal_ros.methods.tracer.solver.problem import TracerProblem
from rotcal_ros.methods.tracer.solver.solve import solve
from rotcal_ros.planning.choices import ListedPolicy, StepOutcome

GOAL = figures.GOAL
LOW, HIGH = (0.90, 0.99) if LONG else (share(0.95, 33)[0], 1.0)


@pytest.fixture(scope="module")
def of():
    return figures.experiment(0.24)


@pytest.fixture(scope="module")
def joined():
    """Return the same lengths with one zero for each unbroken beam."""
    return figures.experiment(0.24, per_segment=True)


def cell_of(of, seed, factor=1.0, **options):
    rng = np.random.default_rng(seed)
    return figures.Cell(of, rng, factor * figures.PLANNED_STD, **options)


def measured(policy, cell, change=lambda outcome, number: outcome):
    """Follow a policy to its end and return its choices."""
    made = []
    while True:
        made.append(policy.choose())
        step = made[-1].step
        if step is None:
            return made
        policy.note(change(cell.measure(step), len(made) - 1))


def longer(outcome, by):
    observation = outcome.observation
    return StepOutcome(outcome.step, replace(observation, mean=(observation.mean[0] + by,)))


@pytest.mark.long  # statistics
def test_what_is_stated_holds_at_any_true_noise_and_costs_little_at_the_planned(of):
    runs = 24 if LONG else 3
    for factor in (0.5, 1.0, 2.0):
        found = [figures.by_policy(cell_of(of, seed, factor)) for seed in range(runs)]
        fixed = [figures.as_planned(cell_of(of, seed, factor)) for seed in range(runs)]
        assert all(run.met for run in found)
        assert all(run.kept for run in found)  # the result says the same
        assert LOW < np.mean([run.inside for run in found]) <= HIGH  # 33 angles, 264 in long
        ratio = np.mean([run.seconds for run in found]) / fixed[0].seconds
        if factor == 1.0:
            # no run takes a step more than its first sweep: 72 lengths in 41 turns, for the
            # reserve, where 60 in 31 reach the goal: 770 s, and 610 s
            assert ratio == pytest.approx(770 / 610, rel=0.02)
        if factor == 2.0:
            assert np.mean([run.inside for run in fixed]) < 0.85


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_goal_reached_is_what_the_result_states(of, factor):
    """The U of the end is the result's own, to the last bit, and its doubt is reported with it."""
    for seed in range(6 if LONG else 2):
        cell = cell_of(of, seed, factor)
        last = measured(UntilGoal(of, GOAL), cell)[-1]
        result = of.solved(cell.measured.observations)
        assert last.reason.startswith(f"goal reached: U {result.uncertainty / ARCSEC:.3f} arcsec")
        # the largest U of the curve, which pages call U, is another figure
        assert f"U {result.uncertainty / ARCSEC:.3f} arcsec rms <= U " in last.reason
        assert last.standing.uncertainty == result.uncertainty <= GOAL
        assert ("the verdict would not be ok: " in last.reason) == bool(result.doubt)


@pytest.mark.slow
def test_an_error_motion_that_the_solver_estimates_is_paid_for():
    """Nothing is stated of a round table: what the estimate adds is met by further lengths."""
    of = figures.experiment(0.24, error_motion=None)
    for seed in range(4):
        cell = cell_of(of, seed)
        last = measured(UntilGoal(of, GOAL), cell)[-1]
        result = of.solved(cell.measured.observations)
        reached = last.reason.startswith("goal reached")
        assert reached == (result.uncertainty <= GOAL), last.reason
        assert reached or last.reason.startswith(("the goal is out of reach", "no remaining step"))


@pytest.mark.slow
def test_an_error_motion_beyond_the_goal_ends_it_soon():
    """3 um at 65 mm are 9 arcsec: no length helps, and it says why."""
    of = figures.experiment(0.24, error_motion=None)
    cell = cell_of(of, 3)
    angles = np.linalg.norm(cell.stations[:, :2], axis=1)
    assert angles == pytest.approx(angles[0])
    cell.stations[:, :2] += 3e-6 * np.random.default_rng(1).standard_normal((len(angles), 2))
    made = measured(UntilGoal(of, GOAL), cell)
    assert "error motion alone, as its circle shows it, gives" in made[-1].reason
    assert len(made) < 100


def test_allowances_are_undone():
    for one in (Allowance(), Allowance(0.3, 1.7), Allowance.of(2.0, 0.8, 0.5)):
        assert one.planned(one.stated(0.9)) == pytest.approx(0.9)
    assert Allowance.of(2.0, 0.8, 0.5).stated(0.8) == pytest.approx(2.0)
    assert Allowance(0.5).planned(0.4) == 0.0
    assert Allowance.of(1.0, np.inf, 0.5) == Allowance(0.5)  # nothing is planned that could grow


@pytest.mark.slow
def test_a_blocked_sector_is_planned_around(of):
    away = -of.directions
    azimuth = np.arctan2(away[:, 1], away[:, 0])
    for number, centre in enumerate(np.radians([-120.0, 10.0, 95.0])):
        cell, fixed = cell_of(of, number), cell_of(of, number)
        off = np.abs((azimuth - centre + np.pi) % (2 * np.pi) - np.pi)
        cell.blocked = fixed.blocked = off <= np.radians(40.0)
        assert not figures.as_planned(fixed).met
        run = figures.by_policy(cell)
        assert run.met
        assert any("failed in every attempt" in reason for reason in run.reasons)


@pytest.mark.slow
def test_the_same_outcomes_give_the_same_choices(of):
    first = measured(UntilGoal(of, GOAL), cell_of(of, 5, 2.0))
    fresh = figures.experiment(0.24)
    second = measured(UntilGoal(fresh, GOAL), cell_of(fresh, 5, 2.0))
    assert len(first) == len(second)
    assert all(a.same_as(b) for a, b in zip(first, second, strict=True))
    assert first[-1].reason.startswith("goal reached: U ")
    assert first[-1].standing.uncertainty <= GOAL
    assert not first[0].same_as(first[1])


@pytest.mark.parametrize("when", [6, 30, 48])
def test_a_wrong_length_is_found_and_measured_again(of, when):
    def slip(outcome, number):
        return longer(outcome, 20e-6) if number == when else outcome

    made = measured(UntilGoal(of, GOAL), cell_of(of, 6 + when), slip)
    again = [choice.step for choice in made if "suspect" in choice.reason]
    assert made[when].step in again
    assert len(again) < 10  # those of one station at most, where they check each other little
    assert made[-1].reason.startswith("goal reached")
    assert made[-1].reason.has("goal reached: {0} <= {1}, {2}")


def test_errors_of_many_lengths_are_noise_and_not_single_errors(of):
    rng = np.random.default_rng(1)

    def rough(outcome, _number):
        return longer(outcome, 4e-6 * rng.standard_t(1.5))

    made = measured(UntilGoal(of, GOAL), cell_of(of, 11), rough)
    suspects = {choice.step for choice in made if "suspect" in choice.reason}
    assert len(suspects) <= 0.1 * len(made) + 4


def test_a_target_that_stays_suspect_gives_way_to_another(of):
    wrong = UntilGoal(of, GOAL).choose().step

    def slip(outcome, _number):
        return longer(outcome, 20e-6) if outcome.step == wrong else outcome

    made = measured(UntilGoal(of, GOAL), cell_of(of, 7), slip)
    suspects = [choice for choice in made if "suspect" in choice.reason]
    assert suspects[0].step == wrong
    *others, last = suspects[1:]
    assert all("its whole station" in choice.reason for choice in others)
    assert "another target" in last.reason
    assert last.step not in {wrong, *(choice.step for choice in others)}
    assert {of.position[choice.step] for choice in suspects} == {of.position[wrong]}


@pytest.mark.slow
def test_a_drift_is_closed(joined):
    def drifting(outcome, number):
        observation = outcome.observation
        mean = (observation.mean[0] + 0.1e-6 * number,)
        stamped = replace(observation, mean=mean, window_end_ns=number * 10**9)
        return StepOutcome(outcome.step, stamped)

    made = measured(UntilGoal(joined, GOAL), cell_of(joined, 8), drifting)
    closing = [choice for choice in made if "to close the sweep" in choice.reason]
    first, middle = closing
    sweep = [choice.step for choice in made if choice.reason == "first sweep"]
    assert first.step == sweep[0]
    assert middle.step == sweep[len(sweep) // 2]
    assert f"closed: step {first.step} by +" in made[-1].reason


@pytest.mark.slow
@pytest.mark.parametrize(
    ("zero", "taken"), [("of", 20), ("joined", 20), ("of", 68), ("joined", 75)]
)
def test_a_resumed_policy_is_where_the_interrupted_one_was(request, zero, taken):
    of = request.getfixturevalue(zero)
    cell = cell_of(of, 9, 2.0)  # noise of a second stage
    cell.blocked = of.target == 3
    policy, seen, gone = UntilGoal(of, GOAL), [], []
    for number in range(taken):
        outcome = cell.measure(policy.choose().step)
        if outcome.observation is not None:
            observation = replace(outcome.observation, window_end_ns=number)
            outcome = StepOutcome(outcome.step, observation)
            seen.append(observation)
        else:
            gone.append(outcome.step)
        policy.note(outcome)
    again = [seen[4].step, seen[9].step]
    resumed = UntilGoal(of, GOAL, again=again, earlier=seen[::-1], given_up=gone)
    assert resumed.noise_factor == policy.noise_factor
    for step in again:
        assert resumed.choose().step == step
        resumed.note(StepOutcome(step, next(o for o in seen if o.step == step)))
    assert resumed.choose().same_as(policy.choose())
    made = measured(resumed, cell)
    assert made[-1].reason.startswith("goal reached")


def test_a_broken_beam_costs_a_zero_and_the_solver_states_the_same(of, joined):
    sweep = first_sweep(of, GOAL)
    half = len(sweep) // 2
    stated = {}
    for name, case, broken in (("one", joined, None), ("two", joined, half), ("own", of, None)):
        cell = cell_of(case, 1, break_after=broken)
        for step in sweep:
            cell.measure(step)
        seen = cell.measured.observations
        segments = cell.measured.segments() if case is joined else None
        stated[name] = case.uncertainty(cell.measured, 1.0)
        targets = np.array(case.plan.targets)
        problem = TracerProblem(
            position=np.array([o.table_position for o in seen]),
            target=np.array([o.target for o in seen]),
            order=np.array([sweep.index(o.step) for o in seen]),
            length=np.zeros(len(sweep)), length_std=figures.PLANNED_STD, targets=targets,
            target_std=figures.TARGET_STD, table_angles=figures.ANGLES, segment=segments,
            error_motion_std=0.0,
        )  # fmt: skip
        covariance = predicted(problem, case.scene.stations).covariance
        centred = np.eye(len(covariance)) - 1.0 / len(covariance)
        variance = np.trace(centred @ covariance @ centred.T) / len(covariance)
        assert 2.0 * np.sqrt(variance) == pytest.approx(stated[name], rel=1e-6)
    assert stated["one"] < stated["two"] < stated["own"]


@pytest.mark.slow
def test_what_is_stated_holds_with_breaks_of_the_beam(joined):
    found = [
        figures.by_policy(cell_of(joined, seed, factor, break_after=seed))
        for factor in (1.0, 2.0) for seed in range(1, 21 if LONG else 4)
    ]  # fmt: skip
    assert all(run.met for run in found)
    assert LOW < np.mean([run.inside for run in found]) <= HIGH  # 66 angles, 440 in long


@pytest.mark.slow
def test_the_first_sweep_is_short_and_every_length_of_it_is_checked(of, joined):
    for case, most in ((of, 64), (joined, 50)):  # greedy: 70 and more
        sweep = first_sweep(case, GOAL)
        known = case.information(case.nothing, 1.0, sweep)
        assert len(sweep) <= most
        assert case.uncertainty(case.nothing, 1.0, sweep) <= GOAL
        assert (known.redundancy >= 0.02).all()
        assert np.bincount(case.position[sweep]).min() >= case.minimum


def test_the_first_sweep_shows_a_drift_and_a_knock_in_time(of):
    """As the solver says of lengths that a cell measured in this order."""
    cell = cell_of(of, 12)
    for step in first_sweep(of, 0.75 * GOAL):
        cell.measure(step)
    seen = cell.measured.observations
    posed = TracerProblem(
        position=np.array([o.table_position for o in seen]),
        target=np.array([o.target for o in seen]),
        order=np.array([o.window_end_ns for o in seen]),
        length=np.array([o.mean[0] for o in seen]), length_std=figures.PLANNED_STD,
        targets=np.array(of.plan.targets), target_std=figures.TARGET_STD,
        table_angles=figures.ANGLES, error_motion_std=0.0, start_stations=of.scene.stations,
    )  # fmt: skip
    hidden = {p.effect: p for p in solve(posed).protections}
    for effect in ("drift", "knock"):
        assert hidden[effect].treatment == "tested"


def test_a_station_without_a_free_beam_ends_the_plan_by_its_name(of):
    cell = cell_of(of, 10)
    cell.blocked = of.position == 5
    made = measured(UntilGoal(of, GOAL), cell)
    assert "table position 5 has 0 lengths" in made[-1].reason
    assert np.isnan(made[-1].standing.uncertainty)


def test_a_goal_out_of_reach_of_all_steps_ends_the_plan_at_once(of):
    factor = 20.0
    made = measured(UntilGoal(of, GOAL), cell_of(of, 13, factor))
    assert "out of reach: all remaining steps would give U" in made[-1].reason
    assert len(made) < 90


def test_a_drift_that_looks_like_noise_does_not_measure_for_ever(of):
    def drifting(outcome, number):
        return longer(outcome, 0.1e-6 * number)

    made = measured(UntilGoal(of, GOAL), cell_of(of, 5), drifting)
    assert any("to close the sweep" in choice.reason for choice in made)
    assert "but the verdict would not be ok: it looks as if" in made[-1].reason
    assert "drift" in made[-1].reason
    assert len(made) < 160  # one round of lengths for what the drift makes uncertain


def test_as_listed_is_the_order_of_the_list():
    policy = ListedPolicy((4, 2, 7))
    policy.note(StepOutcome(9, None))  # what a pause measured again
    steps = []
    while (choice := policy.choose()).step is not None:
        assert choice.standing.left == 3 - len(steps)
        steps.append(choice.step)
        policy.note(StepOutcome(choice.step, None))
    assert steps == [4, 2, 7]
    assert choice.reason == "all planned steps are done"
