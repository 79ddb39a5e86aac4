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
