"""Who beats, who fell silent, who said goodbye."""

import pytest

pytest.importorskip("rclpy")

from rotcal_ros.nodes.health import RollCall


def watched(until, silent_from):
    """Return the first check (s, every 0.2 s) at which "a" counts as lost; None: never."""
    roll = RollCall(timeout_s=1.4)
    roll.silent(0.0)
    for turn in range(round(until / 0.2)):
        now = 0.2 * turn
        if now < silent_from:
            roll.beat("a", now)
        if "a" in roll.silent(now):
            return now
    return None


def test_a_silent_node_is_noticed_within_two_seconds():
    noticed = watched(until=10.0, silent_from=3.0)
    assert noticed is not None
    assert 1.4 < noticed - 2.8 <= 2.0


def test_a_beating_node_is_never_lost():
    assert watched(until=10.0, silent_from=99.0) is None


def test_a_node_that_left_is_not_missed():
    roll = RollCall(timeout_s=1.4)
    roll.beat("a", 0.0)
    roll.leave("a")
    assert roll.silent(0.1) == {}
    assert roll.silent(0.6) == roll.silent(1.1) == roll.silent(5.0) == {}


def test_the_callers_own_pause_is_not_blamed_on_others():
    roll = RollCall(timeout_s=1.4)
    roll.beat("a", 0.0)
    assert roll.silent(0.2) == {}
    assert roll.silent(60.2) == {}  # the machine was suspended
    for now in (60.7, 61.2):
        assert roll.silent(now) == {}
    assert set(roll.silent(61.7)) == {"a"}
