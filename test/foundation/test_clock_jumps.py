"""Steps of a clock against one that does not step."""

import pytest

from rotcal_ros.foundation.clock_jumps import (
    ClockJump,
    ClockWatch,
    jumps_from_metadata,
    jumps_to_metadata,
)

NOON_NS = 1_700_000_000_000_000_000  # 2023-11-14T22:13:20Z


def watched(*ahead_s):
    """Return a watch and what it says to a clock that is so far ahead of the steady one."""
    ahead_ns = iter([round(s * 1e9) for s in ahead_s])

    def read():
        ahead = next(ahead_ns)
        return NOON_NS + ahead, ahead

    watch = ClockWatch(read)
    return watch, [watch.poll() for _ in ahead_s[1:]]


def test_a_step_is_told_once_with_its_size_and_the_time_behind_it():
    watch, seen = watched(0.0, 0.0, -45.0, -45.0, -45.0)
    assert seen == [None, ClockJump(-45 * 10**9, NOON_NS - 45 * 10**9), None, None]
    assert seen[1].describe() == "the system clock jumped by -45.0 s at 2023-11-14T22:12:35Z"
    assert seen[1].named
    assert (watch.count, watch.ahead_ns) == (1, -45 * 10**9)


def test_steps_add_up_and_jitter_of_reading_is_none():
    watch, seen = watched(0.0, 0.02, -0.02, 1.0, 3601.0)
    assert seen[:2] == [None, None]
    assert [jump.named for jump in seen[2:]] == [False, True]
    assert watch.count == 2
    assert watch.ahead_ns == pytest.approx(3601e9, abs=5e7)


def test_a_true_clock_does_not_jump():
    watch = ClockWatch()
    assert all(watch.poll() is None for _ in range(1000))


def test_a_note_in_a_bag_gives_the_jumps_back_and_leaves_out_what_it_cannot_read():
    jumps = (ClockJump(-45 * 10**9, NOON_NS), ClockJump(10**9, NOON_NS + 5))
    assert jumps_from_metadata(jumps_to_metadata(jumps)) == jumps
    assert jumps_from_metadata({"0": "x 1", "1": "5", "2": f"1 {10**40}", "3": "1 2 3"}) == ()
