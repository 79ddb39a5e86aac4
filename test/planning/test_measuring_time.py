"""Travel, reversals and duration of a measuring order, added up move by move."""

import re
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest

from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.methods.ball_plate.measuring_order import Kinematics, plan_measurement, spread_out

DOCS = Path(__file__).parents[2] / "docs"
PAPER_PLATE = [0, 8, 12, 18, 21, 28, 32, 37, 42, 50, 58, 62]


def seconds(distance, velocity, acceleration):
    """A move from rest to rest: the area under a trapezium or a triangle of speed."""
    if distance * acceleration <= velocity**2:
        return 2.0 * np.sqrt(distance / acceleration)
    return distance / velocity + velocity / acceleration


def by_hand(plan, radius, k):
    """Go through the rows: turn and settle, lift and cross, touch."""
    total, turned, turns_back, side = 0.0, 0.0, 0, 0.0
    now, place = plan.lead_in, None
    for angle, ball in zip(plan.table_angle, plan.ball_step, strict=True):
        move = angle - now
        if move != 0.0:
            total += seconds(abs(move), k.table_velocity, k.table_acceleration) + k.settle
            turned += abs(move)
            turns_back += side * move < 0.0
            side = move
        at = angle + 2 * np.pi * ball / plan.grid
        here = radius * np.array([np.cos(at), np.sin(at)])
        across = 0.0 if place is None else np.linalg.norm(here - place)
        if place is None or move != 0.0 or across > 1e-6 * radius:
            total += 2.0 * seconds(k.clearance, k.probe_velocity, k.probe_acceleration)
        if across > 1e-6 * radius:
            total += seconds(across, k.probe_velocity, k.probe_acceleration)
        total += k.touches_per_ball * k.touch
        now, place = angle, here
    return total, turned, turns_back


OTHER = Kinematics(0.31, 0.07, 0.23, 0.11, 1.7, 0.9, 7, 0.031)


@pytest.mark.parametrize("kinematics", [None, OTHER], ids=["usual", "other"])
@pytest.mark.parametrize("radius", [None, 0.3])
@pytest.mark.parametrize(
    "choice",
    [
        {},
        {"backlash": False},
        {"rounds": 3},
        {"order": "probe_rests"},
        {"order": "probe_rests", "backlash": False},
        {"positions": [1, 4, 5, 17, 22]},
    ],
)
def test_an_order_takes_as_long_as_its_moves(choice, radius, kinematics):
    where = {} if radius is None else {"radius": radius}
    plan = plan_measurement(24, [0, 3, 8, 12, 18], kinematics=kinematics, **choice, **where)
    usual = kinematics or Kinematics()
    # the probe that rests does not cross: rounding must not count as a way
    duration, travel, reversals = by_hand(plan, where.get("radius", 0.185), usual)
    assert plan.duration == pytest.approx(duration, rel=1e-6)
    assert plan.table_travel == pytest.approx(travel, rel=1e-12)
    assert plan.reversals == reversals
    step = 2 * np.pi / 24 if choice.get("backlash", True) else 0.0
    assert plan.lead_in == pytest.approx(plan.table_angle[0] - step, abs=1e-15)


def test_usual_kinematics_are_those_of_the_documentation():
    text = " ".join((DOCS / "ball_plate.md").read_text().split())
    numbers = re.search(
        r"Usual are ([\d.]+) rad/s and ([\d.]+) rad/s\^2 for the table, ([\d.]+) m/s and ([\d.]+) "
        r"m/s\^2 for the probe. Settling takes ([\d.]+) s and a touch ([\d.]+) s, with (\d+) "
        r"touches per ball. The probe crosses the balls with a clearance of ([\d.]+) m",
        text,
    )
    assert numbers is not None
    usual = Kinematics(*map(float, numbers.groups()))
    assert astuple(Kinematics()) == astuple(usual)
    plan = plan_measurement(24, [0, 3, 8, 12, 18])
    assert plan.duration == pytest.approx(by_hand(plan, 0.185, usual)[0], rel=1e-9)


@pytest.mark.parametrize("rounds", [1, 2, 3, 5, 72])
def test_every_round_takes_an_even_share_of_positions_all_around(rounds):
    plan = plan_measurement(72, PAPER_PLATE, order="table_once", rounds=rounds, closing=False)
    number = np.floor(plan.table_angle / (2 * np.pi) + 1e-9).astype(int)
    shares = [np.unique(plan.cmm_index[number == n]) for n in range(rounds)]
    assert sorted(np.concatenate(shares)) == list(range(72))
    assert max(map(len, shares)) - min(map(len, shares)) <= 1
    assert set(number) == set(range(rounds))
    for share in shares:
        gaps = np.diff(np.append(share, share[0] + 72))
        assert gaps.max() <= 3 * 72 / len(share)
    assert plan.reversals == 0


@pytest.mark.parametrize("rounds", [-1, 4])
def test_rounds_need_positions(rounds):
    with pytest.raises(PlanError, match=f"3 CMM positions .* {rounds} rounds"):
        plan_measurement(12, [0, 1, 4, 6], positions=[0, 4, 8], order="table_once", rounds=rounds)


@pytest.mark.parametrize("grid", [5, 12, 72, 360])
def test_the_first_few_positions_are_spread_over_the_circle(grid):
    spread = spread_out(grid)
    assert sorted(spread) == list(range(grid))
    for count in range(3, grid + 1):
        gaps = np.diff(np.sort(spread[:count]), append=spread[:count].min() + grid)
        # three gap theorem: the golden section leaves none larger than twice the mean and a bit
        assert gaps.max() <= 2.2 * grid / count + 2


def test_the_first_positions_follow_the_golden_section():
    """Position n of 1000 lies where the fraction of n times the golden section says."""
    golden = (np.sqrt(5) - 1) / 2
    spread = spread_out(1000)
    away = spread / 1000 - (np.arange(1000) * golden) % 1.0
    assert np.abs(away).max() < 0.005


def test_the_table_turns_on_past_zero_when_the_probe_rests():
    """Positions 1 and 2 of 8, balls 0, 3, 4: the table brings them onward, nearest first."""
    plan = plan_measurement(8, [0, 3, 4], positions=[1, 2], order="probe_rests")
    assert plan.ball_step.tolist() == [0, 4, 3, 4, 3, 0]
    steps = np.round(plan.table_angle / (2 * np.pi / 8)).astype(int)
    assert steps.tolist() == [1, 5, 6, 6, 7, 10]
    assert plan.position.tolist() == [1, 5, 6, 6, 7, 2]
    assert plan.cmm_index.tolist() == [1, 1, 1, 2, 2, 2]


def test_the_table_turns_back_where_the_largest_gap_begins():
    """Balls 7, 0, 2 of 8 lie side by side but for the gap from 2 to 7."""
    plan = plan_measurement(8, [0, 2, 7], positions=[3, 4, 5], order="probe_rests", backlash=False)
    assert plan.ball_step.tolist() == [2, 0, 7, 7, 0, 2, 2, 0, 7]
    steps = np.round(plan.table_angle / (2 * np.pi / 8)).astype(int)
    assert (steps - steps[0]).tolist() == [0, 2, 3, 4, 3, 1, 2, 4, 5]
    assert plan.reversals == 2


def test_the_same_steps_twice_count_once():
    once = plan_measurement(12, [0, 1, 4], positions=[2, 5])
    twice = plan_measurement(12, [4, 0, 1, 0], positions=[5, 2, 5])
    assert once.ball_step.tolist() == twice.ball_step.tolist()
    assert once.position.tolist() == twice.position.tolist()
    assert once.duration == twice.duration
