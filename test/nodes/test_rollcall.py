"""Who beats, who fell silent, who said goodbye."""

import pytest

pytest.importorskip("rclpy")

from rotcal_ros.nodes.roll_call import LOADING, SOLVING, RollCall


def watched(until, silent_from):
    """Return the first check (s, every 0.2 s) at which "a" counts as lost; None: never."""
    roll = RollCall(timeout_s=1.4)
    roll.silent(0.0)
    for turn in range(round(until / 0.2)):
        now = 0.2 * turn
        if now < silent_from:
            roll.seen["a"] = now
        if "a" in roll.silent(now):
            return now
    return None


def test_a_silent_node_is_noticed_within_two_seconds():
    noticed = watched(until=10.0, silent_from=3.0)
    assert noticed is not None
    assert 1.4 < noticed - 2.8 <= 2.0


def test_a_beating_node_is_never_lost():
    assert watched(until=10.0, silent_from=99.0) is None


def test_the_callers_own_pause_is_not_blamed_on_others():
    roll = RollCall(timeout_s=1.4)
    roll.seen["a"] = 0.0
    assert roll.silent(0.2) == {}
    assert roll.silent(60.2) == {}  # the machine was suspended
    for now in (60.7, 61.2):
        assert roll.silent(now) == {}
    assert set(roll.silent(61.7)) == {"a"}


def test_behind_a_pause_of_its_own_the_caller_does_not_know_the_others_at_once():
    roll = RollCall(timeout_s=1.4)
    assert roll.aware(0.0)
    roll.silent(0.2)
    assert roll.aware(0.4)
    assert not roll.aware(5.2)  # a call is answered before the beat that is due
    roll.silent(5.2)
    for now in (5.4, 5.6, 5.8):
        assert not roll.aware(now)
        roll.silent(now)
    assert roll.aware(6.0)


def test_who_is_solving_is_given_more_time_and_no_more_than_that():
    roll = RollCall(timeout_s=1.4)
    lost: dict[str, int] = {}
    for turn in range(100):
        now = 0.2 * turn
        if turn == 0:
            roll.hear("solver", SOLVING, now)
            roll.hear("dead solver", SOLVING, now)
            roll.hear("recorder", "recording", now)
        if turn == 25:
            roll.hear("solver", "final result", now)
        for name in roll.silent(now):
            lost.setdefault(name, turn)
    turns = {"recorder": (7, 8), "solver": (32, 33), "dead solver": (50, 51)}
    assert lost.keys() == turns.keys()
    for name, between in turns.items():
        assert lost[name] in between, name


def test_who_loads_the_code_of_a_method_is_given_as_much():
    roll = RollCall(timeout_s=1.4)
    for name, state in (("capture", LOADING), ("cell", "idle")):
        roll.hear(name, state, 0.0)
    seen = {turn: set(roll.silent(0.2 * turn)) for turn in range(60)}
    assert seen[20] == {"cell"}
    assert seen[59] == {"capture", "cell"}
