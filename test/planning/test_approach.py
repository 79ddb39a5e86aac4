"""Ways of a joint: the right angle, side, turns and limits, whatever is ordered."""

from math import nan, pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.planning.approach import approach_angles, path_to, stopping_path
from rotcal_ros.planning.settings import TableAdapterSettings

DEG = pi / 180
ENDLESS = TableAdapterSettings(speed_deg_s=12.0, acceleration_deg_s2=30.0, overshoot_deg=2.0)
angles = st.floats(-20.0, 20.0)
approaches = st.sampled_from(list(Approach))


@given(angle=angles, start=angles, approach=approaches)
def test_the_goal_is_the_angle_by_the_shortest_way_that_keeps_the_side(angle, start, approach):
    way = path_to(angle, approach, start, ENDLESS)
    turns = (way.goal - angle) / (2 * pi)
    assert abs(turns - round(turns)) < 1e-9
    legs = np.diff([way.start, *way.angles])
    if approach is Approach.UNKNOWN:
        assert len(legs) == 1
        assert abs(legs[0]) <= pi + 1e-9
    else:
        sign = 1 if approach is Approach.POSITIVE else -1
        assert sign * legs[-1] >= 2.0 * DEG - 1e-9
        assert np.abs(legs).sum() <= pi + 4.0 * DEG + 1e-9


@given(angle=angles, start=angles, approach=approaches)
def test_neither_speed_nor_acceleration_is_exceeded_and_it_rests_at_every_stop(
    angle, start, approach
):
    way = path_to(angle, approach, start, ENDLESS)
    step = 1e-2
    times = np.arange(-0.05, way.times_s[-1] + 0.05, step)
    positions = np.array([way.at(t)[0] for t in times])
    velocity = np.diff(positions) / step
    assert np.abs(velocity).max() <= 12.0 * DEG * (1 + 1e-6)
    assert np.abs(np.diff(velocity)).max() / step <= 30.0 * DEG * (1 + 1e-6)
    assert positions[0] == pytest.approx(start)
    assert positions[-1] == way.goal
    for stop, time in zip(way.angles, way.times_s, strict=True):
        assert way.at(time)[0] == pytest.approx(stop)


def test_by_hand():
    assert path_to(30 * DEG, Approach.UNKNOWN, 370 * DEG, ENDLESS).angles == pytest.approx(
        [390 * DEG]
    )
    assert path_to(350 * DEG, Approach.UNKNOWN, 0.0, ENDLESS).angles == pytest.approx([-10 * DEG])
    assert path_to(30 * DEG, Approach.NEGATIVE, 30 * DEG, ENDLESS).angles == pytest.approx(
        [32 * DEG, 30 * DEG]
    )
    # 8 deg at 12 deg/s at most: 1.5 * 8 / 12 = 1 s; by 30 deg/s^2: sqrt(6 * 8 / 30) = 1.265 s
    way = path_to(8 * DEG, Approach.POSITIVE, 0.0, ENDLESS)
    assert way.times_s == pytest.approx([1.2649110640673518])


def test_the_ends_of_the_travel():
    travel = TableAdapterSettings(lower_deg=-190.0, upper_deg=190.0, overshoot_deg=2.0)
    assert path_to(185 * DEG, Approach.UNKNOWN, 0.0, travel).angles == pytest.approx([-175 * DEG])
    assert path_to(185 * DEG, Approach.UNKNOWN, 100 * DEG, travel).angles == pytest.approx(
        [185 * DEG]
    )
    # Below the lower end there is no room to come from; a turn higher there is.
    assert path_to(-189 * DEG, Approach.POSITIVE, -180 * DEG, travel).angles == pytest.approx(
        [171 * DEG]
    )
    narrow = TableAdapterSettings(lower_deg=-90.0, upper_deg=90.0, overshoot_deg=2.0)
    with pytest.raises(DataError, match=r"cannot go to 120\.0000 deg: its travel is -90 to 90"):
        path_to(120 * DEG, Approach.UNKNOWN, 0.0, narrow)
    with pytest.raises(DataError, match="with this side of approach"):
        path_to(90 * DEG, Approach.NEGATIVE, 90 * DEG, narrow)


@given(angle=angles, velocity=st.floats(-0.5, 0.5))
def test_a_joint_that_is_stopped_brakes_evenly_on_half_the_way_it_would_have_gone(angle, velocity):
    way = stopping_path(angle, velocity, ENDLESS)
    (time_s,) = way.times_s
    assert time_s == pytest.approx(max(abs(velocity) / (30.0 * DEG), 0.1))
    assert way.goal - angle == pytest.approx(velocity * time_s / 2)


def test_a_joint_of_which_no_velocity_is_known_is_stopped_where_it_is():
    assert stopping_path(1.5, nan, ENDLESS).goal == 1.5


@given(here=angles, goal=angles, side=st.sampled_from([Approach.POSITIVE, Approach.NEGATIVE]))
def test_the_last_run_up_is_on_the_ordered_side(here, goal, side):
    sign = 1.0 if side is Approach.POSITIVE else -1.0
    *before, last = (here, *approach_angles(here, goal, side, 0.1))
    assert last == goal
    assert sign * (goal - before[-1]) >= 0.1 - 1e-12
    mirrored = Approach.NEGATIVE if side is Approach.POSITIVE else Approach.POSITIVE
    assert approach_angles(-here, -goal, mirrored, 0.1) == pytest.approx(
        [-angle for angle in approach_angles(here, goal, side, 0.1)]
    )


def test_without_a_side_it_goes_straight():
    assert approach_angles(3.0, 1.0, Approach.UNKNOWN, 0.1) == (1.0,)
