"""Which plans a node takes while the planner has a goal: its own, whatever else comes when."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from builtin_interfaces.msg import Time
from rotcal_msgs.msg import CalibrationPlan

from rotcal_ros.capture.publishers import PATIENCE_S, RUN, unique_run_name
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.nodes.runtime import announced_plan as plans
from rotcal_ros.nodes.runtime.announced_plan import REFUSED_RUN, PlanSubscription
from rotcal_ros.nodes.runtime.beat_values import FOREIGN_PLAN


class Node(SimpleNamespace):
    """A node that hears the planner's beat as ``goal`` says, empty: it has no goal."""

    def __init__(self):
        health = SimpleNamespace(
            lost={}, concerns={}, alarms={}, others={"planner": object()},
            values=lambda _: {RUN: self.goal} if self.goal else {},
            beat=lambda: self.beats.append(dict(health.alarms)),
        )  # fmt: skip
        super().__init__(goal="another run", health=health, warnings=[], beats=[])

    def listen(self, _kind, _topic, handle, _qos):
        self.offer = handle

    def every(self, _period_s, work):
        self.poll = work

    def resolve_topic_name(self, topic):
        return f"/cell/{topic}"

    def get_publishers_info_by_topic(self, _topic):
        return [SimpleNamespace(node_name="planner"), SimpleNamespace(node_name="stranger")]

    def get_logger(self):
        return SimpleNamespace(warning=self.warnings.append)


@pytest.fixture
def clock(monkeypatch):
    clock = SimpleNamespace(now_s=100.0)
    monkeypatch.setattr(plans.time, "monotonic", lambda: clock.now_s)
    return clock


def plan(name):
    message = CalibrationPlan(plan_id=name)
    message.header.stamp = Time(sec=1)
    return message


OURS, STRAY = plan("ours"), plan("stray")


@pytest.mark.parametrize("order", [(OURS, STRAY), (STRAY, OURS), (STRAY, OURS, STRAY)])
def test_the_planners_plan_is_taken_with_its_beat_whatever_came_before_it_or_behind(clock, order):
    node, taken = Node(), []
    PlanSubscription(node, taken.append)
    for message in order:
        node.offer(message)
    assert taken == []
    node.goal = unique_run_name(OURS)
    node.poll()
    assert taken == [OURS]
    clock.now_s += PATIENCE_S + 0.1
    node.poll()
    assert taken == [OURS]
    (warning,) = node.warnings
    assert "is not the planner's and was ignored (plan 'stray', published by stranger)" in warning


def test_without_a_goal_every_plan_is_taken_at_once(clock):
    node, taken = Node(), []
    PlanSubscription(node, taken.append)
    node.goal = ""
    for message in (STRAY, OURS):
        node.offer(message)
    assert taken == [STRAY, OURS]


def test_a_node_that_has_just_been_started_waits_until_it_knows_the_planner(clock):
    node, taken = Node(), []
    PlanSubscription(node, taken.append)
    node.goal = ""
    node.health.others.clear()
    for message in (OURS, STRAY):
        node.offer(message)
    assert taken == []
    node.goal = unique_run_name(OURS)
    node.health.others["planner"] = object()
    node.poll()
    assert taken == [OURS]


def test_without_a_planner_a_plan_is_taken_after_a_moment(clock):
    node, taken = Node(), []
    PlanSubscription(node, taken.append)
    node.goal = ""
    node.health.others.clear()
    node.offer(STRAY)
    clock.now_s += PATIENCE_S + 0.1
    node.poll()
    assert taken == [STRAY]


def test_a_plan_that_cannot_be_taken_is_offered_once_and_keeps_no_other_back(clock):
    node, taken = Node(), []

    def take(message):
        taken.append(message)
        if message is STRAY:
            raise ValueError("another version")

    PlanSubscription(node, take)
    node.goal = ""
    node.health.others.clear()
    for message in (STRAY, OURS):
        node.offer(message)
    node.health.others["planner"] = object()
    with pytest.raises(ValueError, match="another version"):
        node.poll()
    node.poll()
    node.poll()
    assert taken == [STRAY, OURS]


def refuse(message):
    raise ConfigurationError(f"plan {message.plan_id} names no method")


def test_a_strangers_plan_that_is_none_is_said_and_is_no_error_of_the_node(clock):
    node = Node()
    PlanSubscription(node, refuse)
    node.goal = ""
    node.offer(STRAY)
    (warning,) = node.warnings
    assert "a plan on /cell/plan cannot be used: plan stray names no method" in warning
    assert "published by stranger" in warning
    assert node.health.concerns == {FOREIGN_PLAN: warning}


def test_the_planners_own_plan_that_cannot_be_used_is_an_error(clock):
    node = Node()
    PlanSubscription(node, refuse)
    node.goal = unique_run_name(OURS)
    with pytest.raises(ConfigurationError, match="plan ours names no method"):
        node.offer(OURS)


@pytest.mark.parametrize(
    ("error", "why"),
    [(ConfigurationError("no method"), "no method"), (KeyError(), "KeyError")],
)
def test_the_planner_hears_at_once_who_cannot_take_its_plan_until_another_comes(clock, error, why):
    node, errors = Node(), [error]

    def take(_message):
        if errors:
            raise errors.pop()

    PlanSubscription(node, take)
    node.goal = unique_run_name(OURS)
    with pytest.raises(type(error)):
        node.offer(OURS)
    assert node.beats == [{REFUSED_RUN: f"{unique_run_name(OURS)} {why}"}]
    later = plan("later")
    node.goal = unique_run_name(later)
    node.offer(later)
    assert node.health.alarms == {}


def test_what_came_in_a_goal_is_left_alone_behind_it_too(clock):
    node, taken = Node(), []
    PlanSubscription(node, taken.append)
    node.offer(STRAY)
    node.goal = ""
    node.poll()
    clock.now_s += PATIENCE_S + 0.1
    node.poll()
    assert taken == []
    assert "is not the planner's and was ignored (plan 'stray'" in node.warnings[0]
