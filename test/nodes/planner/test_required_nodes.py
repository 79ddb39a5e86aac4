"""Which lost nodes end a goal, which are waited for, and which need another run."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_ros.nodes.planner import goal_watch
from rotcal_ros.nodes.planner.goal_watch import GoalError, RequiredNodes

SUITE = ("capture", "recorder", "solver")


class Health:
    """Nodes that beat, as processes by name; those of ``gone`` do not."""

    def __init__(self):
        self.processes = dict.fromkeys((*SUITE, "machine"), "first")
        self.gone, self.lost = set(), {}

    def process(self, name):
        return self.processes[name]

    def missing(self, names):
        return sorted(set(names) & self.gone)

    def last_words(self, name):
        return f"last words of {name}"


@pytest.fixture
def clock(monkeypatch):
    clock = SimpleNamespace(now_s=100.0)

    def patience(seconds):
        end_s = clock.now_s + seconds
        return SimpleNamespace(is_over=lambda: clock.now_s > end_s)

    monkeypatch.setattr(goal_watch, "WaitBudget", patience)
    return clock


def watched(restart_wait_s=20.0):
    health = Health()
    made = RequiredNodes(health, restart_wait_s)
    made.nodes = {*SUITE, "machine"}
    made.begin_run()
    made.check("at step 3")
    return health, made


def test_a_solver_may_be_away_for_a_while_and_be_another_process(clock):
    health, made = watched()
    health.gone = {"solver"}
    made.check("at step 3")
    clock.now_s += 19.0
    made.check("at step 3")
    health.gone, health.processes["solver"] = set(), "second"
    made.check("at step 3")
    health.gone = {"solver"}
    made.check("at step 3")
    clock.now_s += 21.0
    with pytest.raises(GoalError, match="node solver was ended at step 3"):
        made.check("at step 3")


@pytest.mark.parametrize("name", ["capture", "recorder"])
def test_capture_and_recorder_need_another_run_even_if_they_were_away_unnoticed(name):
    health, made = watched()
    health.processes[name] = "second"
    with pytest.raises(GoalError, match=f"node {name} was restarted at step 3") as raised:
        made.check("at step 3")
    assert raised.value.in_another_run
    made.end_run()
    made.check("in the preflight")


def test_a_machine_that_is_lost_ends_the_goal():
    health, made = watched()
    health.gone, health.lost = {"machine", "capture"}, {"machine": "gone"}
    text = r"node capture, machine is lost at step 3 \(last words of machine\)"
    with pytest.raises(GoalError, match=text) as raised:
        made.check("at step 3")
    assert not raised.value.in_another_run


def test_without_patience_nobody_is_waited_for():
    health, made = watched(0.0)
    health.gone = {"solver"}
    with pytest.raises(GoalError, match="node solver was ended"):
        made.check("at step 3")


def test_a_machine_that_was_started_anew_ends_the_goal_however_quickly_it_was_back():
    health, made = watched()
    made.end_run()  # nor is it forgotten while the goal waits for others
    made.check("in the preflight")
    health.processes["machine"] = "second"
    with pytest.raises(GoalError, match="node machine was restarted at step 3") as raised:
        made.check("at step 3")
    assert not raised.value.in_another_run
