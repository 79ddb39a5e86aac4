"""The policy until_goal, on simulated tracers with a generator and an estimator of their own."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import figures

from rotcal_ros.planning.policy.as_listed import AsListed
from rotcal_ros.planning.policy.choices import Outcome
from rotcal_ros.planning.policy.until_goal import Limits, UntilGoal

GOAL = figures.GOAL


@pytest.fixture(scope="module")
def of():
    return figures.experiment(0.24)


def cell_of(of, seed, factor=1.0):
    return figures.Cell(of, np.random.default_rng(seed), factor * figures.PLANNED_STD)


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
    return Outcome(
        outcome.step, replace(observation, mean=(observation.mean[0] + by,), window_end_ns=0)
    )


def test_what_is_stated_holds_at_any_true_noise_and_costs_little_at_the_planned(of):
    runs = 24
    for factor in (0.5, 1.0, 2.0):
        found = [figures.by_policy(cell_of(of, seed, factor)) for seed in range(runs)]
        fixed = [figures.as_planned(cell_of(of, seed, factor)) for seed in range(runs)]
        assert all(run.met for run in found)
        assert 0.90 < np.mean([run.inside for run in found]) < 0.99  # 264 angles
        ratio = np.mean([run.seconds for run in found]) / fixed[0].seconds
        if factor == 1.0:
            assert 1.0 <= ratio < 1.2
        if factor == 2.0:
            assert np.mean([run.inside for run in fixed]) < 0.85


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
        assert any("given up" in reason for reason in run.reasons)


def test_choosing_takes_less_than_50_ms_of_processor_time(of):
    run = figures.by_policy(cell_of(of, 3, 2.0))
    assert run.slowest_choice_s < 0.05


def test_the_same_outcomes_give_the_same_choices(of):
    first = measured(UntilGoal(of, Limits(GOAL)), cell_of(of, 5, 2.0))
    fresh = figures.experiment(0.24)
    second = measured(UntilGoal(fresh, Limits(GOAL)), cell_of(fresh, 5, 2.0))
    assert len(first) == len(second)
    assert all(a.same_as(b) for a, b in zip(first, second, strict=True))
    assert first[-1].reason.startswith("goal reached: U ")
    assert first[-1].standing.uncertainty <= GOAL
    assert not first[0].same_as(first[1])


def test_a_suspect_length_is_measured_again(of):
    def slip(outcome, number):
        return longer(outcome, 20e-6) if number == 30 else outcome

    made = measured(UntilGoal(of, Limits(GOAL)), cell_of(of, 6), slip)
    again = [choice for choice in made if "suspect" in choice.reason]
    assert [choice.step for choice in again] == [made[30].step]
    assert made[-1].standing.uncertainty <= GOAL


def test_a_target_that_stays_suspect_gives_way_to_another(of):
    wrong = UntilGoal(of, Limits(GOAL)).choose().step

    def slip(outcome, _number):
        return longer(outcome, 20e-6) if outcome.step == wrong else outcome

    made = measured(UntilGoal(of, Limits(GOAL)), cell_of(of, 7), slip)
    suspects = [choice for choice in made if "suspect" in choice.reason]
    assert suspects[0].step == wrong
    assert "once more" in suspects[1].reason
    assert suspects[1].step != wrong
    assert of.position[suspects[1].step] == of.position[wrong]


def test_a_drift_is_closed(of):
    def drifting(outcome, number):
        observation = outcome.observation
        mean = (observation.mean[0] + 0.05e-6 * number,)
        stamped = replace(observation, mean=mean, window_end_ns=number * 10**9)
        return Outcome(outcome.step, stamped)

    made = measured(UntilGoal(of, Limits(GOAL)), cell_of(of, 8), drifting)
    closing = [choice for choice in made if "to close the sweep" in choice.reason]
    first, middle = closing
    assert of.position[first.step] == 0  # the first length that is not measured again already
    assert 3 <= of.position[middle.step] <= 8
    assert f"closed: step {first.step} by +" in made[-1].reason


def test_a_resumed_plan_measures_what_is_missing_only(of):
    cell = cell_of(of, 9)
    policy = UntilGoal(of, Limits(GOAL))
    earlier = []
    for _ in range(40):
        outcome = cell.measure(policy.choose().step)
        policy.note(outcome)
        earlier.append(outcome.observation)
    done = [o.step for o in earlier]
    made = measured(UntilGoal(of, Limits(GOAL), again=done[:3], earlier=earlier), cell)
    steps = [choice.step for choice in made]
    assert steps[:3] == done[:3]
    assert not set(steps[3:]) & set(done)
    assert made[-1].reason.startswith("goal reached")


def test_a_station_without_a_free_beam_ends_the_plan_by_its_name(of):
    cell = cell_of(of, 10)
    cell.blocked = of.position == 5
    made = measured(UntilGoal(of, Limits(GOAL)), cell)
    assert "table position 5 has 0 lengths" in made[-1].reason
    assert np.isnan(made[-1].standing.uncertainty)


def test_as_listed_is_the_order_of_the_list():
    policy = AsListed((4, 2, 7))
    policy.note(Outcome(9, None))  # what a pause measured again
    steps = []
    while (choice := policy.choose()).step is not None:
        assert choice.standing.left == 3 - len(steps)
        steps.append(choice.step)
        policy.note(Outcome(choice.step, None))
    assert steps == [4, 2, 7]
    assert choice.reason == "all steps of the list are done"
