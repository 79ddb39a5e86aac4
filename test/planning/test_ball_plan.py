"""The measuring order: complete, little motion, one direction, duration from the kinematics."""

import numpy as np
import pytest

from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.methods.ball_plate.measuring_order import Kinematics, plan_measurement

PAPER_PLATE = [0, 8, 12, 18, 21, 28, 32, 37, 42, 50, 58, 62]


ORDERS = ["interleaved", "table_once", "probe_rests"]


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("backlash", [True, False])
@pytest.mark.parametrize("positions", [None, [0, 3, 7, 20, 41]])
def test_every_centre_is_measured_once(order, backlash, positions):
    plan = plan_measurement(
        72, PAPER_PLATE, positions=positions, order=order, backlash=backlash, closing=False
    )
    assert plan.closing == 0
    cells = set(zip(plan.cmm_index.tolist(), plan.ball_step.tolist(), strict=True))
    wanted = {(k, j) for k in (positions or range(72)) for j in PAPER_PLATE}
    assert cells == wanted
    assert len(plan.ball_step) == len(wanted)
    turn = (plan.table_angle / (2 * np.pi / 72)) % 72
    assert np.allclose(turn % 72, plan.position, atol=1e-9) or np.allclose(
        np.round(turn) % 72, plan.position
    )


@pytest.mark.parametrize("order", ORDERS)
def test_with_backlash_the_table_never_turns_back(order):
    plan = plan_measurement(72, PAPER_PLATE, order=order, backlash=True)
    assert plan.reversals == 0
    assert (np.diff(plan.table_angle) >= 0.0).all()
    assert plan.lead_in < plan.table_angle[0]


def test_table_turns_once_around_in_all():
    once = {"order": "table_once", "closing": False}
    plan = plan_measurement(72, PAPER_PLATE, **once)
    assert plan.table_travel == pytest.approx(2 * np.pi)  # with the lead-in of one step
    still = plan_measurement(72, PAPER_PLATE, **once, backlash=False)
    assert still.table_travel == pytest.approx(2 * np.pi * 71 / 72)


@pytest.mark.parametrize(("closing", "steps", "reversals"), [(False, 25, 1), (True, 27, 2)])
def test_up_and_back_with_an_overshoot_at_either_end(closing, steps, reversals):
    """One step to lead in, 11 up, one beyond and back, 11 down, and the same at the other end."""
    plan = plan_measurement(
        12, [0, 1, 4, 6], order="table_once", closing=closing, bidirectional=True
    )
    assert plan.table_travel == pytest.approx(2 * np.pi * steps / 12)
    assert plan.reversals == reversals
    up, down = plan.upward[:48], plan.upward[48:96]
    assert up.all()
    assert not down.any()
    np.testing.assert_array_equal(plan.position[48:96], plan.position[:48][::-1])
    np.testing.assert_array_equal(plan.ball_step[48:96], plan.ball_step[:48][::-1])
    assert np.all(plan.upward[96:])
    once = plan_measurement(12, [0, 1, 4, 6], order="table_once", closing=closing)
    assert 1.9 * once.duration < plan.duration < 2.1 * once.duration


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("backlash", [True, False])
def test_plans_close_with_the_first_table_position(order, backlash):
    whole = plan_measurement(72, PAPER_PLATE, order=order, backlash=backlash)
    open_plan = plan_measurement(72, PAPER_PLATE, order=order, backlash=backlash, closing=False)
    n = len(open_plan.ball_step)
    assert whole.closing == len(whole.ball_step) - n == 12
    np.testing.assert_array_equal(whole.position[:n], open_plan.position)
    assert set(whole.position[n:]) == {whole.position[0]}
    assert sorted(whole.ball_step[n:]) == PAPER_PLATE
    assert open_plan.duration < whole.duration < 1.02 * open_plan.duration
    assert (np.diff(whole.table_angle)[n - 1 :] >= 0.0).all() or not backlash


def test_a_position_with_few_balls_is_not_worth_closing():
    plan = plan_measurement(72, PAPER_PLATE, positions=[0, 3])
    assert plan.closing == 0


@pytest.mark.parametrize("balls", [PAPER_PLATE, [0, 3, 22, 31, 48, 52], list(range(0, 72, 6))])
def test_interleaved_rounds_share_balls_and_positions_evenly(balls):
    """Each round meets every table position, and all balls and CMM positions about as often."""
    plan = plan_measurement(72, balls, rounds=3, closing=False)
    turn = np.round(plan.table_angle / (2 * np.pi / 72)).astype(int)
    for number in range(3):
        rows = turn // 72 == number
        stops = np.bincount(plan.position[rows], minlength=72)
        assert (stops == len(balls) // 3).all()
        each = np.bincount(plan.ball_step[rows], minlength=72)[np.sort(balls)]
        assert each.max() - each.min() <= 2
        if len(balls) == 12:
            cmm = np.bincount(plan.cmm_index[rows], minlength=72)
            assert cmm.min() >= 1
            assert cmm.max() <= 9


def test_probe_rests_turns_less_to_and_fro():
    onward = plan_measurement(72, PAPER_PLATE, order="probe_rests")
    fro = plan_measurement(72, PAPER_PLATE, order="probe_rests", backlash=False)
    assert fro.table_travel < onward.table_travel
    assert fro.reversals > 0
    # every sweep leaves out the largest gap (10 steps), plus one step to the next position
    assert fro.table_travel == pytest.approx(2 * np.pi * (72 * 62 + 71) / 72, rel=0.02)


def test_duration_is_that_of_the_moves():
    kinematics = Kinematics(
        table_velocity=1.0, table_acceleration=1.0, probe_velocity=1.0, probe_acceleration=1.0,
        settle=10.0, touch=100.0, touches_per_ball=2, clearance=4.0,
    )  # fmt: skip
    plan = plan_measurement(
        4,
        [0],
        positions=[0, 1, 2, 3],
        order="table_once",
        backlash=False,
        radius=2.0,
        kinematics=kinematics,
    )
    quarter = np.pi / 2
    table = 3 * (quarter + 1.0 + 10.0)  # longer than the ramps: s/v + v/a, and settling
    crossing = 3 * (2.0 * np.sqrt(2.0) + 1.0)
    lifts = 4 * 2 * (4.0 + 1.0)
    assert plan.duration == pytest.approx(table + crossing + lifts + 4 * 2 * 100.0)
    short = plan_measurement(
        400, [0], positions=[0, 1], backlash=False, radius=1e-9, kinematics=kinematics
    )
    step = 2 * np.sqrt(2 * np.pi / 400)  # a triangle: never at full speed
    assert short.duration == pytest.approx(step + 10.0 + 2 * 2 * 5.0 + 400.0, abs=1e-3)


@pytest.mark.parametrize(
    ("balls", "positions", "order"),
    [
        ([0, 72], None, "table_once"),
        ([-1, 5], None, "table_once"),
        ([], None, "table_once"),
        ([0, 5], [80], "table_once"),
        ([0, 5], [-1], "probe_rests"),
        ([0, 5], [], "probe_rests"),
        ([0, 5], None, "random"),
    ],
)
def test_impossible_plans_are_refused(balls, positions, order):
    with pytest.raises(PlanError):
        plan_measurement(72, balls, positions=positions, order=order)


def test_the_probe_sweeps_to_and_fro_and_never_crosses_the_largest_gap():
    once = {"order": "table_once", "closing": False}
    plan = plan_measurement(12, [0, 2, 11], **once)
    assert plan.ball_step.tolist() == [11, 0, 2, 2, 0, 11] * 6
    assert plan.position.tolist() == np.repeat(np.arange(12), 3).tolist()
    few = plan_measurement(12, [0, 2, 11], positions=[3], **once)
    # the probe rests at position 3, the table brings the balls: 11 at 4, 0 at 3, 2 at 1
    assert few.ball_step.tolist() == [2, 0, 11]
    assert few.position.tolist() == [1, 3, 4]
