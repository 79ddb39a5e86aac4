"""What a joint's feedback says of an order: begun, arrived, stalled, in degrees, not at all."""

from math import isnan, nan, pi

import numpy as np
import pytest

from rotcal_ros.foundation.observations import Approach, TableSample
from rotcal_ros.nodes.table_adapter.joint_watch import JointMonitor
from rotcal_ros.planning.approach import path_to
from rotcal_ros.planning.settings import TableAdapterSettings

DEG = pi / 180
SETTINGS = TableAdapterSettings(
    speed_deg_s=10.0, acceleration_deg_s2=100.0, silence_s=2.0, controller="/drive"
)


class Joint:
    """A joint with a clock, read every 10 ms."""

    def __init__(self, angle):
        self.watch, self.angle, self.now_s, self.told = JointMonitor(SETTINGS), angle, 0.0, []
        self.noise = np.random.default_rng(3).normal(0.0, 2e-8, 10_000).tolist()
        self.stay(0.1)

    def read(self, velocity=nan):
        self.now_s += 0.01
        shown = self.angle + self.noise.pop()
        sample = TableSample(round(self.now_s * 1e9), shown, velocity)
        told = self.watch.receive(sample, self.now_s)
        if told is not None and not isnan(told.velocity):
            self.told.append((round(told.angle / DEG, 6), told.velocity))

    def stay(self, seconds):
        for _ in range(round(seconds / 0.01)):
            self.read()

    def order(self, angle, approach=Approach.UNKNOWN):
        self.way = path_to(angle, approach, self.angle, SETTINGS)
        self.watch.begin(self.way, self.now_s)
        self.told.clear()

    def go(self, seconds=None):
        begun = self.now_s
        for number in range(1, round((seconds or self.way.times_s[-1] + 0.1) / 0.01) + 1):
            self.angle = self.way.at(number * 0.01)[0]
            self.read()
        assert self.now_s > begun

    def current_fault(self):
        return self.watch.current_fault(self.now_s)


def test_an_order_that_is_obeyed():
    joint = Joint(0.0)
    joint.order(30 * DEG)
    assert not joint.watch.arrived()
    joint.stay(0.5)
    assert joint.told == []
    joint.go()
    assert joint.watch.arrived()
    assert joint.told[-1] == (pytest.approx(30.0, abs=1e-5), pytest.approx(0.0, abs=1e-4))
    assert max(velocity for _, velocity in joint.told) == pytest.approx(10 * DEG, rel=1e-2)
    joint.stay(10.0)
    assert joint.current_fault() is None


def test_one_that_stands_there_by_chance_is_not_at_rest_before_it_came_from_the_right_side():
    joint = Joint(30 * DEG)
    joint.order(30 * DEG, Approach.NEGATIVE)
    joint.stay(0.5)
    assert joint.told == []
    joint.go()
    assert max(angle for angle, _ in joint.told) == pytest.approx(32.0, abs=1e-2)
    assert joint.told[-1][0] == pytest.approx(30.0, abs=1e-5)


def test_one_that_stands_there_by_chance_and_is_not_obeyed_is_named():
    joint = Joint(30 * DEG)
    joint.order(30 * DEG, Approach.NEGATIVE)
    assert not joint.watch.arrived()
    joint.stay(2.2)
    assert not joint.watch.arrived()
    assert "has not moved for 2.2 s since it was sent to 30.0000 deg" in joint.current_fault()


def test_where_nothing_has_to_move_the_feedback_is_told_at_once():
    joint = Joint(30 * DEG)
    joint.order(30 * DEG)
    joint.read()
    assert len(joint.told) == 1


def test_a_velocity_that_is_told_is_passed_on():
    joint = Joint(1.0)
    joint.told.clear()
    joint.read(velocity=0.25)
    assert joint.told == [(pytest.approx(1.0 / DEG, abs=1e-5), 0.25)]


def test_one_that_does_not_begin():
    joint = Joint(0.0)
    joint.order(30 * DEG)
    joint.stay(1.9)
    assert joint.current_fault() is None
    joint.stay(0.3)
    assert "has not moved for 2.2 s since it was sent to 30.0000 deg" in joint.current_fault()
    assert "/drive active" in joint.current_fault()


def test_one_that_stalls_on_its_way_and_goes_on_later():
    joint = Joint(0.0)
    joint.order(30 * DEG)
    joint.go(2.0)
    at = joint.angle / DEG
    joint.stay(8.0)
    assert f"stopped at {at:.4f} deg" in joint.current_fault()
    assert "from where it was sent (30.0000 deg)" in joint.current_fault()
    joint.angle = 30 * DEG
    joint.read()
    assert joint.current_fault() is None


def test_silence():
    joint = Joint(0.0)
    assert joint.watch.current_fault(joint.now_s + 1.9) is None
    assert joint.watch.current_fault(joint.now_s + 3.0) == "no feedback of the table for 3.0 s"


def test_degrees_are_named():
    joint = Joint(0.0)
    joint.order(30 * DEG)
    joint.angle = 30.0  # the joint went there, and reports it in degrees
    joint.stay(0.3)
    assert joint.current_fault() is None  # a table that passes by proves nothing
    joint.stay(0.4)
    assert "reports 30 where 0.523599 rad were ordered: its feedback is in degrees" in (
        joint.current_fault()
    )


def test_an_angle_of_many_turns_before_the_first_order_is_doubted():
    assert "4.8 turns: if these are degrees" in Joint(30.0).watch.doubt()
    assert Joint(-3.9 * pi).watch.doubt() is None
    trusting = JointMonitor(TableAdapterSettings(many_turns=True))
    trusting.receive(TableSample(1, 30.0, 0.0), 0.0)
    assert trusting.doubt() is None


def test_an_endless_table_goes_on_for_many_turns():
    joint = Joint(0.0)
    for step in range(1, 40):
        joint.order(step * 30 * DEG, Approach.POSITIVE)
        joint.angle = joint.way.goal
        joint.read()
        assert joint.watch.doubt() is None
    assert joint.angle > 3 * 2 * pi


def test_old_feedback_says_nothing_of_where_the_joint_is():
    joint = Joint(1.0)
    assert joint.watch.here(joint.now_s) == pytest.approx(1.0, abs=1e-6)
    assert joint.watch.here(joint.now_s + 2.1) is None
    assert Joint(nan).watch.here(0.2) is None


def test_what_is_no_number_is_not_told():
    joint = Joint(nan)
    assert joint.told == []
    assert joint.current_fault() == "the feedback of the table is not a number"


def test_who_falls_silent_with_an_order_is_not_blamed_for_standing_still():
    joint = Joint(0.0)
    joint.order(30 * DEG)
    joint.read()  # on its way when the order was sent
    complaints = {
        joint.watch.current_fault(joint.now_s + after_s) for after_s in np.arange(0, 4, 0.001)
    }
    assert None in complaints
    words = {text.partition(" for ")[0] for text in complaints - {None}}
    assert words == {"no feedback of the table"}
