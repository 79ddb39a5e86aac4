"""A node that has time takes messages together, and wakes often enough for everybody else."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_ros.nodes import running
from rotcal_ros.nodes.health import CALIBRATING

TURN_S = 0.001


@pytest.mark.parametrize(
    ("has_time", "simulated", "share"), [(True, False, 0.25), (False, False, 1), (True, True, 1)]
)
def test_who_has_time_is_awake_for_a_part_of_it(monkeypatch, has_time, simulated, share):
    now_s, awake_s = 0.0, 0.0

    def sleep(seconds):
        nonlocal now_s
        now_s += seconds

    monkeypatch.setattr(running.time, "monotonic", lambda: now_s)
    monkeypatch.setattr(running.time, "sleep", sleep)
    sim = SimpleNamespace(used=simulated)
    node = SimpleNamespace(has_time=lambda: has_time, health=SimpleNamespace(sim=sim))
    rest = running._Rest()
    while now_s < 2.0:  # a turn of the executor, and the rest behind it
        now_s, awake_s = now_s + TURN_S, awake_s + TURN_S
        before_s = now_s
        rest.take(node)
        assert now_s - before_s < 0.05  # a beat is due five times a second
    assert awake_s / now_s == pytest.approx(share, abs=0.06)


def test_the_capture_has_time_until_the_planner_measures():
    from rotcal_ros.nodes.capture import CaptureNode

    for state, has_time in (("", True), ("idle", True), (f"{CALIBRATING}: step 3", False)):
        health = SimpleNamespace(state={"planner": state}.__getitem__)
        assert CaptureNode.has_time(SimpleNamespace(health=health)) is has_time


@pytest.fixture
def clock(monkeypatch):
    from rotcal_ros.nodes import waiting

    clock = SimpleNamespace(now_s=100.0)
    monkeypatch.setattr(waiting.time, "monotonic", lambda: clock.now_s)
    return clock


def member(group, kind):
    """Return something of a kind that the group holds."""
    made = kind.__new__(kind)
    group.add_entity(made)
    return made


def test_events_are_looked_for_a_few_times_a_second_and_the_rest_always(clock):
    from rclpy.event_handler import EventHandler
    from rclpy.subscription import Subscription

    from rotcal_ros.nodes.waiting import EVENTS_S, Seldom

    group = Seldom()
    event, subscription = member(group, EventHandler), member(group, Subscription)
    looked = []
    for turn in range(2000):  # every ms
        assert group.can_execute(subscription)
        if group.can_execute(event):
            assert group.can_execute(event)  # what was waited for may be handled in the same turn
            looked.append(turn)
        clock.now_s += TURN_S
    looks = [a for a, b in zip(looked, [-9, *looked], strict=False) if a - b > 1]
    assert len(looks) == pytest.approx(2.0 / EVENTS_S, abs=1)
    assert len(looked) < 0.03 * 2000


def test_a_late_turn_looks_for_events_at_once(clock):
    from rclpy.event_handler import EventHandler

    from rotcal_ros.nodes.waiting import Seldom

    group = Seldom()
    event = member(group, EventHandler)
    for pause_s in (0.0, 0.25, 3.0, 0.21):
        clock.now_s += pause_s
        assert group.can_execute(event)


def test_nobody_wakes_for_what_is_drained(clock):
    from rclpy.event_handler import EventHandler
    from rclpy.subscription import Subscription
    from rclpy.timer import Timer

    from rotcal_ros.nodes.waiting import Unwaited

    group = Unwaited()
    assert not group.can_execute(member(group, Subscription))
    assert group.can_execute(member(group, Timer))
    assert group.can_execute(member(group, EventHandler))
