"""The records of a plan: what a step orders, what it observes, what a plan refuses."""

from dataclasses import asdict, fields, replace

import numpy as np
import pytest

from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.foundation.observations import Approach, PointKind, Turn
from rotcal_ros.planning.plan import Pause, Plan, Step
from rotcal_ros.planning.table_angles import (
    Arrival,
    TableAngleSettings,
    planned_arrivals,
    table_angles,
)

STEP = Step(
    index=1,
    table_position=2,
    table_angle=0.75,
    approach=Approach.NEGATIVE,
    kind=PointKind.MIRRORED,
    target=5,
    position=(0.1, 0.2, 0.3),
    station=3,
    n_points=7,
    ball_diameter=0.025,
)
PLAIN = Step(0, 1, 0.5, Approach.POSITIVE, PointKind.REFLECTOR, 4, (1.0, 2.0, 3.0))


def test_a_step_orders_one_attempt_with_all_that_it_knows():
    command = STEP.command(2)
    assert command.attempt == 2
    assert command.step == STEP.index
    for field in fields(command):
        if field.name not in ("step", "attempt"):
            assert getattr(command, field.name) == getattr(STEP, field.name), field.name


def test_a_turn_goes_on_from_one_of_its_angles_to_the_next():
    turn = Turn(-0.2, 1.2, 0.3)
    steps = [replace(PLAIN, index=k, table_angle=0.5 * k, turn=turn) for k in range(3)]
    assert steps[1].follows(steps[0])
    assert steps[1].command(0) == replace(steps[1].command(4), attempt=0)
    plan = Plan("test", (0.0, 0.5), (PLAIN.position,) * 5, tuple(steps))
    assert [plan.passed_from(k) for k in (0, 1)] == [range(3), range(1, 3)]
    for before in (
        steps[1],  # another attempt
        steps[2],
        replace(steps[0], station=1),  # another run at the same speed
        replace(steps[0], target=1),
        replace(steps[0], turn=Turn(-0.2, 1.2, -0.3)),
    ):
        assert not steps[1].follows(before)


def test_a_plain_step_needs_one_point_and_no_station():
    assert (PLAIN.station, PLAIN.n_points, PLAIN.ball_diameter) == (0, 1, 0.0)


def test_an_observation_without_scatter():
    assert asdict(STEP.observed((1.5, -2.5))) == {
        "step": 1, "attempt": 0, "table_position": 2, "table_angle": 0.75, "target": 5,
        "station": 3, "kind": PointKind.MIRRORED, "mean": (1.5, -2.5), "std": (0.0, 0.0),
        "scatter": (0.0, 0.0), "probe_position": (0.1, 0.2, 0.3), "n_samples": 1, "n_used": 1,
        "accepted": True, "reason": "", "table_angle_measured": 0.75, "temperature_c": None,
        "window_start_ns": 0, "window_end_ns": 0, "run": 0, "segment": 0, "pressure_pa": None,
        "humidity": None,
    }  # fmt: skip
    assert STEP.observed((1.0,), PointKind.CENTRE).kind is PointKind.CENTRE


def plan(*steps, angles=(0.0, 0.5, 0.75), pauses=()):
    return Plan("own", angles, ((1.0, 2.0, 3.0),), steps, pauses)


def test_a_plan_finds_its_steps_and_pauses():
    pauses = (Pause(0, -1, "first"), Pause(1, 1, "then"))
    made = plan(PLAIN, STEP, pauses=pauses)
    assert made.step(0) is PLAIN
    assert made.step(1) is STEP
    assert [made.pause_before(index) for index in (0, 1, 2)] == [*pauses, None]
    assert plan(PLAIN).pauses == ()


@pytest.mark.parametrize("index", [-1, 2])
def test_a_step_that_is_not_there_is_named(index):
    with pytest.raises(PlanError, match=rf"step {index} is not in the plan: .* 0 to 1"):
        plan(PLAIN, STEP).step(index)


def test_a_plan_without_steps_or_with_wrong_ones_is_refused():
    with pytest.raises(PlanError, match="method own has no steps"):
        plan()
    with pytest.raises(PlanError, match="step 0 of the plan carries the index 1"):
        plan(STEP)
    with pytest.raises(PlanError, match=r"step 1: table position 2 outside 0\.\.1"):
        plan(PLAIN, STEP, angles=(0.0, 0.5))
    below = Step(0, -1, 0.5, Approach.POSITIVE, PointKind.REFLECTOR, 4, (1.0, 2.0, 3.0))
    with pytest.raises(PlanError, match="table position -1 outside"):
        plan(below)


def test_arrivals_of_two_runs_from_both_sides():
    up, down = Approach.POSITIVE, Approach.NEGATIVE
    assert planned_arrivals(2, 2, True) == tuple(
        Arrival(target, run, side)
        for run in (0, 1)
        for target, side in ((0, up), (1, up), (1, down), (0, down))
    )
    assert planned_arrivals(3, 1, False) == tuple(Arrival(target, 0, up) for target in range(3))


def test_table_angles_in_radians():
    even = TableAngleSettings(table_start_deg=-30.0, table_step_deg=45.0, table_positions=4)
    np.testing.assert_allclose(table_angles(even), np.radians([-30.0, 15.0, 60.0, 105.0]))
    named = TableAngleSettings(table_angles_deg=(10.0, 10.5, 90.0), table_positions=7)
    np.testing.assert_allclose(table_angles(named), np.radians([10.0, 10.5, 90.0]))
    assert len(table_angles(TableAngleSettings())) == 12


@pytest.mark.parametrize("degrees", [(0.0, 5.0, 5.0), (0.0, -1.0)])
def test_table_angles_must_grow(degrees):
    with pytest.raises(PlanError, match="must ascend"):
        table_angles(TableAngleSettings(table_angles_deg=degrees))
    with pytest.raises(PlanError, match="must ascend"):
        table_angles(TableAngleSettings(table_step_deg=0.0))
