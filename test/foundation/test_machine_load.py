"""Time that counts only while this process gets its turns, on a clock of the test."""

import math
import re

import pytest

from rotcal_ros.foundation import machine_load
from rotcal_ros.foundation.machine_load import (
    LARGEST_LOAD_FACTOR,
    AwakeClock,
    LoadFactor,
    WaitBudget,
)


class Clock:
    now_s = 50.0

    def __call__(self):
        return self.now_s


def alone():
    return 1.0


def waited(patience, clock, turn_s, *, pausing=False, most=100_000):
    """Return the seconds until the patience is over; None: it is not."""
    begin_s = clock.now_s
    for _ in range(most):
        clock.now_s += turn_s
        if patience.is_over(pausing=pausing):
            return clock.now_s - begin_s
    return None


def test_an_awake_clock_runs_with_the_turns_and_stands_with_its_process():
    clock = Clock()
    awake = AwakeClock(clock)
    begin_s = awake.now_s()
    for _ in range(10):
        clock.now_s += 0.2
        awake.now_s()
    assert awake.now_s() - begin_s == pytest.approx(2.0)
    clock.now_s += 3600.0  # the machine was suspended
    assert awake.now_s() - begin_s == pytest.approx(2.5)
    assert awake.awake_s() == 0.0
    clock.now_s += 0.3
    assert awake.awake_s() == pytest.approx(0.3)


def test_a_process_that_never_stood_has_been_awake_for_ever():
    assert AwakeClock(Clock()).awake_s() == math.inf


def test_a_time_out_is_what_it_says_on_a_quiet_machine():
    clock = Clock()
    assert waited(WaitBudget(5.0, alone, clock), clock, 0.2) == pytest.approx(5.0, abs=0.25)


def test_a_standstill_does_not_use_it_up():
    clock = Clock()
    patience = WaitBudget(5.0, alone, clock)
    clock.now_s += 600.0
    assert not patience.is_over()
    assert waited(patience, clock, 0.2) == pytest.approx(4.5, abs=0.25)


def test_on_a_crowded_machine_it_is_longer_by_as_much():
    clock = Clock()
    assert waited(WaitBudget(5.0, lambda: 4.0, clock), clock, 0.2) == pytest.approx(20.0, abs=0.25)


def test_while_somebody_is_waited_for_it_does_not_run():
    clock = Clock()
    patience = WaitBudget(5.0, alone, clock)
    assert waited(patience, clock, 0.2, pausing=True, most=1000) is None
    assert waited(patience, clock, 0.2) == pytest.approx(5.0, abs=0.25)


def test_no_end_is_no_end():
    clock = Clock()
    assert waited(WaitBudget(math.inf, alone, clock), clock, 0.5, most=1000) is None


@pytest.mark.parametrize(("found", "told"), [(0.0, 1.0), (3.5, 3.5), (1e6, LARGEST_LOAD_FACTOR)])
def test_a_machine_is_crowded_within_bounds(found, told):
    assert LoadFactor(lambda: found)() == told


def test_the_load_is_told_with_the_cores():
    assert re.fullmatch(r"load \d+\.\d on \d+ cores?", machine_load.describe_load())
