"""A node takes part in a plan once it knows what was measured before, and not without."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_msgs.msg import CalibrationPlan

from rotcal_ros.capture.publishers import RUN, unique_run_name
from rotcal_ros.foundation.observations import Approach, PointKind
from rotcal_ros.methods.continuation import Recorded
from rotcal_ros.nodes.solver import node as solver
from rotcal_ros.nodes.solver.node import NO_GOAL_S, PATIENCE_S, EarlierObservations
from rotcal_ros.planning.plan import Step

PLAN = CalibrationPlan(plan_id="ours", run=1)


class Node(SimpleNamespace):
    """A node that hears the planner's goal, and a recorder that answers when ``answer`` is set."""

    def __init__(self):
        health = SimpleNamespace(
            guarded=lambda work: work, present=lambda: {"planner"} if self.planner else set(),
            values=lambda _: {RUN: self.goal} if self.goal else {},
        )  # fmt: skip
        super().__init__(
            health=health, planner=True, goal="", ready=False, answer="", asked=0, warnings=[]
        )

    def create_client(self, _kind, _name):
        return SimpleNamespace(service_is_ready=lambda: self.ready, call_async=self.call)

    def call(self, _request):
        self.asked += 1
        return SimpleNamespace(
            add_done_callback=lambda _: None,
            done=lambda: bool(self.answer),
            result=lambda: SimpleNamespace(message=self.answer),
        )

    def every(self, _period_s, work):
        self.poll = work

    def get_logger(self):
        return SimpleNamespace(warning=lambda text, **_: self.warnings.append(text))


@pytest.fixture
def clock(monkeypatch):
    clock = SimpleNamespace(now_s=100.0)
    monkeypatch.setattr(solver.time, "monotonic", lambda: clock.now_s)
    return clock


def asked(**how):
    node, taken = Node(), []
    vars(node).update(how)
    EarlierObservations(node).ask(PLAN, {}, taken.append)
    return node, taken


def test_a_recorder_that_is_not_heard_is_waited_for_and_asked_again(clock):
    node, taken = asked(goal=unique_run_name(PLAN))
    clock.now_s += 10 * PATIENCE_S
    node.poll()
    assert taken == []
    assert "does not say what was measured earlier" in node.warnings[0]
    node.ready = True
    node.poll()
    clock.now_s += PATIENCE_S + 0.1  # the first request got lost
    node.poll()
    node.poll()
    assert (node.asked, taken) == (2, [])
    before = Step(3, 0, 0.0, Approach.POSITIVE, PointKind.DIRECT, 0, (0.1, 0.2, 0.3)).observed(
        (0.1,)
    )
    node.answer = Recorded("ours", 1, (before,)).to_json()
    node.poll()
    assert taken == [{(0, 3): before}]


def test_the_beat_of_the_planner_may_come_after_its_plan(clock):
    node, taken = asked()
    node.poll()
    node.goal = unique_run_name(PLAN)
    clock.now_s += NO_GOAL_S + 0.1
    node.poll()
    assert taken == []


@pytest.mark.parametrize("how", [{"goal": "another"}, {"planner": ""}])
def test_a_plan_of_somebody_else_has_none(clock, how):
    _, taken = asked(**how)
    assert taken == [{}]


def test_a_planner_without_a_goal_did_not_announce_the_plan(clock):
    node, taken = asked()
    assert taken == []
    clock.now_s += NO_GOAL_S + 0.1
    node.poll()
    assert taken == [{}]
