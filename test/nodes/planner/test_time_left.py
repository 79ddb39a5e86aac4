"""The time that is left stands still during a pause, and goes on from there."""

import pytest

from rotcal_ros.nodes.planner import progress as module
from rotcal_ros.nodes.planner.progress import GoalProgress


def test_a_pause_neither_lengthens_nor_shortens_it(monkeypatch):
    now_s = [100.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now_s[0])
    progress = GoalProgress(total=10, done=2, left=8, started_s=100.0)
    left = []
    for event, at_s in (
        ("", 120.0),
        ("pause", 120.0),
        ("", 720.0),
        ("go_on", 1020.0),
        ("", 1030.0),
    ):
        now_s[0] = at_s
        if event:
            getattr(progress, event)()
        left.append(progress.time_left())
    assert left == pytest.approx([80.0, 80.0, 80.0, 80.0, 120.0])


def test_it_is_never_negative_after_a_node_was_lost_before_the_first_step(monkeypatch):
    now_s = [100.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now_s[0])
    progress = GoalProgress(total=10, left=9, started_s=100.0)
    progress.pause()
    now_s[0] = 160.0
    progress.begin()
    now_s[0] = 165.0
    progress.note(0, accepted=True)
    assert progress.time_left() == pytest.approx(45.0)
