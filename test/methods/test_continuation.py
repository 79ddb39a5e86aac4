"""What is left of an interrupted plan."""

import math
from dataclasses import replace

import pytest

from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.observations import ATTEMPTS_PER_RUN, Observation, PointKind
from rotcal_ros.methods import last_accepted
from rotcal_ros.methods.continuation import Continuation, continued
from rotcal_ros.methods.tracer.plan import tracer_plan
from rotcal_ros.methods.tracer.settings import TracerPlanSettings


def plan(order):
    return tracer_plan(
        TracerPlanSettings(table_positions=4, box_points=(3, 1, 1), order=order)
    )  # 12 steps


def observed(step, attempt=0, accepted=True, table_position=0, run=0):
    return Observation(
        step=step, attempt=attempt, table_position=table_position, table_angle=0.1, target=0,
        station=0,
        kind=PointKind.REFLECTOR, mean=(1 / 3,), std=(1e-7,), scatter=(math.pi,),
        probe_position=(0.1, 0.2, 0.3), n_samples=5, n_used=5, accepted=accepted, reason="",
        table_angle_measured=0.1, temperature_c=None, window_start_ns=1, window_end_ns=2, run=run,
    )  # fmt: skip


def go_on(observations, order="stations_per_target", join_steps=3):
    return continued(plan(order), "id", 2, observations, max_attempts=3, join_steps=join_steps)


def test_it_goes_on_at_the_first_missing_step_after_a_spread_of_done_ones():
    left = go_on([observed(step) for step in range(7)])
    assert left.start_index == 7
    assert left.again == (0, 3, 6)
    assert left.steps == (0, 3, 6, 7, 8, 9, 10, 11)


def test_a_step_that_was_given_up_is_not_missing_but_an_undecided_one_is():
    tried = [observed(1, attempt, accepted=False) for attempt in range(3)]
    once = [observed(2, 0, accepted=False)]
    left = go_on([observed(0), *tried, *once, observed(3)])
    assert left.start_index == 2
    assert left.steps == (0, 3, 2, 4, 5, 6, 7, 8, 9, 10, 11)


def test_attempts_of_several_runs_do_not_add_up_to_giving_up():
    tried = [observed(1, run * ATTEMPTS_PER_RUN, accepted=False, run=run) for run in range(3)]
    assert 1 in go_on([observed(0), *tried]).steps


def test_with_all_targets_at_each_station_the_open_station_is_measured_again():
    left = go_on([observed(step) for step in range(5)], "targets_per_station")
    assert left.again == (3, 4)  # of station 1: step 5 is missing there
    whole = go_on([observed(step) for step in range(6)], "targets_per_station")
    assert whole.again == (0, 2, 5)  # no station is open: any done step tests the join


def test_nothing_measured_and_everything_measured():
    assert go_on([]).steps == tuple(range(12))
    done = go_on([observed(step) for step in range(12)])
    assert done.steps == ()
    assert done.start_index == 12


def test_the_file_round_trips_to_the_last_bit():
    left = go_on([observed(step) for step in range(7)])
    assert Continuation.from_json(left.to_json()) == left
    with pytest.raises(DataError, match="not a continuation"):
        Continuation.from_json("[1, 2")


def test_the_last_accepted_attempt_of_each_run_counts():
    first, second = observed(3, 0), observed(3, 1)
    later = observed(3, ATTEMPTS_PER_RUN, run=1)
    refused = observed(4, 2 * ATTEMPTS_PER_RUN, accepted=False, run=2)
    assert last_accepted([later, first, second, refused]) == {(0, 3): second, (1, 3): later}


def test_an_angle_that_nobody_measured_survives_the_file():
    one = replace(observed(0), table_angle_measured=math.nan)
    left = Continuation("0" * 64, 1, 0, (), (0,), (one,))
    (again,) = Continuation.from_json(left.to_json()).observations
    assert math.isnan(again.table_angle_measured)


def test_steps_with_which_the_planner_gave_up_are_missing_and_others_were_given_up():
    """Step 1 was hidden; from step 3 on something was wrong with the set-up."""
    failed = {s: [observed(s, attempt, accepted=False) for attempt in range(3)] for s in (1, 3, 4)}
    seen = [observed(0), *failed[1], observed(2), *failed[3], *failed[4]]
    args = (plan("stations_per_target"), "id", 1, seen)
    found = continued(*args, max_attempts=3, join_steps=0, max_failed_steps=2)
    assert found.steps[:3] == (3, 4, 5)
    found = continued(*args, max_attempts=3, join_steps=0, max_failed_steps=3)
    assert found.steps[0] == 5


def test_a_turn_that_is_not_whole_is_made_again_from_rest_at_its_target():
    """Two targets, forward and back: a step at rest, then four that the table passes."""
    turns = tracer_plan(
        TracerPlanSettings(
            table_positions=4, table_step_deg=90.0, turning_deg_s=(20.0, -20.0),
            targets_m=(0.5, 0.0, 0.3, 0.0, 0.5, 0.6),
        )
    )  # fmt: skip
    assert [turns.passed_from(k) for k in (5, 6)] == [range(5, 6), range(6, 10)]
    assert turns.counting == frozenset(range(20)) - {0, 5, 10, 15}
    lost = (3, 8, *range(13, 20))
    left = continued(
        turns, "id", 1, [observed(k) for k in range(20) if k not in lost],
        max_attempts=3, join_steps=4,
    )  # fmt: skip
    assert left.start_index == 3
    # what the table passes behind a step that is missing comes by itself
    assert left.steps == (0, 1, 2, 3, 5, 6, 7, 8, *range(10, 20))
    assert left.again == (0, 1, 2, 5, 6, 7, 10, 11, 12)
