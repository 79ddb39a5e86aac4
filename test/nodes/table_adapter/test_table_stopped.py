"""How the adapter to ros2_control stops a table in an emergency, and what it says; no graph."""

import sys
from concurrent.futures import Future
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_msgs.msg import TableAngle

from rotcal_ros.foundation.machine_load import AwakeClock
from rotcal_ros.foundation.node_state import NodeState, State, Why
from rotcal_ros.foundation.observations import Approach, TableSample
from rotcal_ros.nodes.table_adapter import joint_controllers
from rotcal_ros.nodes.table_adapter.joint_controllers import (
    ControllerReport,
    PositionController,
    TrajectoryController,
)
from rotcal_ros.nodes.table_adapter.joint_watch import JointMonitor
from rotcal_ros.nodes.table_adapter.node import TableAdapter
from rotcal_ros.planning.approach import path_to, stopping_path
from rotcal_ros.planning.settings import TableAdapterSettings

DEG = np.pi / 180.0
SETTINGS = TableAdapterSettings(
    controller="/drive", speed_deg_s=10.0, acceleration_deg_s2=20.0, silence_s=2.0
)


class Controller:
    """A controller that takes ways; without a place it does what it says."""

    def __init__(self):
        self.sent, self.halted, self.said = [], 0, ControllerReport()
        self.setpoint, self.send, self.forget = lambda: None, self.sent.append, lambda: None
        self.report = lambda: self.said

    def halt(self):
        self.halted += 1
        return "its goal is canceled"


class Adapter(TableAdapter):
    """An adapter whose joint and controller are the test's, and that is no node."""

    def __init__(self, controller=None):
        self.logged, self.health = [], SimpleNamespace(awake=AwakeClock())
        log = SimpleNamespace(warning=self.logged.append, error=self.logged.append)
        self.get_logger = lambda: log
        self._settings, self._joint = SETTINGS, "rotary"
        self._watch, self._controller = JointMonitor(SETTINGS), controller or Controller()
        self._stop = SimpleNamespace(why="", refuses=lambda _step: bool(self._stop.why))
        self._waiting, self._held, self._refused, self._others = None, False, None, ()
        self._state = NodeState.of(State.WORKING, Why.ORDERED, 1, 0)

    def __del__(self):
        pass

    def order(self, ago_s=0.0):
        """Send the joint from 0 to 90 deg, some time ago."""
        way = path_to(90.0 * DEG, Approach.UNKNOWN, 0.0, SETTINGS)
        self._controller.send(way)
        self._watch.begin(way, self.health.awake.now_s() - ago_s)

    def receive(self, angle_deg, velocity_deg_s=0.0):
        now_s = self.health.awake.now_s()
        self._watch.receive(TableSample(1, angle_deg * DEG, velocity_deg_s * DEG), now_s)

    def halt(self):
        self._stop.why = "estop"
        self._halt("estop")


@pytest.fixture
def adapter():
    return Adapter()


def test_a_joint_under_way_is_braked_and_what_waits_is_forgotten(adapter):
    """At 10 deg/s it brakes with 20 deg/s^2: half a second, 2.5 deg."""
    adapter.order()
    adapter.receive(30.0, 10.0)
    adapter._waiting = "an order"
    adapter.halt()
    assert adapter._waiting is None
    assert np.rad2deg(adapter._controller.sent[-1].angles) == pytest.approx([32.5])
    assert adapter._controller.sent[-1].times_s == pytest.approx([0.5])
    adapter._obey(TableAngle(step=7))
    assert adapter._waiting is None
    assert adapter._wrong() is None  # it stands where it was stopped, and that is right
    assert adapter._report()[0].has(Why.HELD)
    adapter._stop.why = None
    assert adapter._report()[0].has(Why.NO_ORDER)


def test_an_order_to_turn_on_is_refused_with_its_reason(adapter):
    adapter.receive(0.0)
    adapter._controller.heard = lambda: True
    adapter._obey(TableAngle(step=7, angle=1.0, turn_speed=0.5))
    assert adapter._controller.sent == []
    assert "ordered to turn on at 28.6479 deg/s" in adapter._wrong()


def test_a_hold_that_the_controller_refuses_is_told(adapter):
    adapter.order()
    adapter.receive(30.0, 10.0)
    adapter.halt()
    adapter._controller.said = ControllerReport("/drive rejected the goal of 32.5000 deg")
    assert adapter._wrong() == (
        "joint 'rotary' of /drive: /drive rejected the goal of 32.5000 deg"
    )


def test_a_joint_whose_place_nobody_tells_is_not_sent_anywhere_and_its_way_is_given_up(adapter):
    adapter.order()
    adapter.receive(float("nan"))
    adapter.halt()
    assert (len(adapter._controller.sent), adapter._controller.halted) == (1, 1)
    assert adapter.logged == [
        "the table cannot be held: its position is not known; its goal is canceled"
    ]


@pytest.mark.parametrize("case", ["no order", "arrived", "moved since", "stopped", "deactivated"])
def test_a_table_that_this_adapter_does_not_move_is_let_be(adapter, case):
    if case != "no order":
        adapter.order(ago_s=0.0 if case == "deactivated" else 1e4)
    adapter.receive(0.0)
    if case in ("arrived", "moved since"):
        adapter.receive(45.0)
        adapter.receive(90.0)
    if case == "moved since":
        adapter.receive(60.0, 5.0)  # by hand
    if case == "stopped":
        adapter._watch._moved_s -= 1e4
    if case == "deactivated":
        adapter.receive(30.0, 10.0)
        adapter.deactivated()
    ordered = len(adapter._controller.sent)
    adapter._waiting = "an order"
    adapter.halt()
    assert (len(adapter._controller.sent), adapter._controller.halted) == (ordered, 0)
    assert (adapter._waiting, adapter.logged) == (None, [])


@pytest.fixture
def topic(monkeypatch):
    """Return a node that keeps what is published, that, and a function that lets time pass."""
    now = [100.0]
    monkeypatch.setattr(joint_controllers, "time", SimpleNamespace(monotonic=lambda: now[0]))
    said, timers = [], []
    publisher = SimpleNamespace(publish=said.append)
    node = SimpleNamespace(
        create_publisher=lambda *_: publisher, every=lambda _s, work: timers.append(work)
    )

    def after(seconds):
        now[0] += seconds
        for work in timers:
            work()

    return node, said, after


def test_positions_brake_within_the_acceleration_also_where_feedback_is_lost(topic):
    node, said, after = topic
    adapter = Adapter(PositionController(node, "/drive", "rotary"))
    adapter.order()
    for _ in range(100):
        after(0.02)
    adapter.halt()  # it has heard nothing at all of the joint
    for _ in range(100):
        after(0.02)
    angles = np.array([message.data[0] for message in said]) / DEG
    accelerations = np.diff(angles, n=2) / 0.02**2
    assert np.abs(accelerations).max() < 20.0 * 1.02
    assert angles.max() < 90.0 / 2
    assert len(said) < 200  # and then no more


@pytest.fixture
def goals(monkeypatch):
    """Return a controller by goals, and the goals that it was sent: futures of handles."""
    futures = []

    class Client:
        def __init__(self, *_):
            pass

        def send_goal_async(self, _goal):
            futures.append(Future())
            return futures[-1]

    messages = SimpleNamespace(FollowJointTrajectory=SimpleNamespace(Goal=SimpleNamespace))
    for name in ("control_msgs", "control_msgs.action"):
        monkeypatch.setitem(sys.modules, name, messages)
    monkeypatch.delitem(sys.modules, "rotcal_ros.nodes.table_adapter.joint_goals", raising=False)
    module = import_module("rotcal_ros.nodes.table_adapter.joint_goals")
    monkeypatch.setattr(module, "ActionClient", Client)
    node = SimpleNamespace(health=SimpleNamespace(guarded=lambda work: work))
    yield module.GoalController(node, "/drive", "rotary"), futures
    sys.modules.pop("rotcal_ros.nodes.table_adapter.joint_goals")


class Goal:
    """A goal that the controller has accepted."""

    accepted = True

    def __init__(self):
        self.canceled, self.result = 0, Future()

    def cancel_goal_async(self):
        self.canceled += 1

    def get_result_async(self):
        return self.result


@pytest.mark.parametrize("accepted", ["before", "after"])
def test_a_goal_is_canceled_also_where_it_is_accepted_only_behind_the_stop(goals, accepted):
    controller, futures = goals
    adapter, goal = Adapter(controller), Goal()
    adapter.order()
    if accepted == "before":
        futures[0].set_result(goal)
    adapter.halt()
    if accepted == "after":
        futures[0].set_result(goal)
    assert goal.canceled == 1
    goal.result.set_result(SimpleNamespace(status=5))  # canceled
    assert controller.report() == ControllerReport()


def test_a_trajectory_by_topic_is_not_followed_by_an_empty_one(topic):
    """Controllers of ros2_control refuse one: what cannot be stopped is said."""
    node, said, _ = topic
    adapter = Adapter(TrajectoryController(node, "/drive", "rotary"))
    adapter.order()
    adapter.halt()
    assert len(said) == 1
    assert "cannot be taken back" in adapter.logged[0]


def test_the_way_to_rest_brakes_evenly_from_the_velocity_at_its_start():
    """p = v t - a t^2 / 2 with a = v / T, in closed form."""
    way = stopping_path(1.0, 10.0 * DEG, SETTINGS)
    for time_s in (0.0, 0.1, 0.3, 0.5, 0.9):
        t = min(time_s, 0.5)
        angle, speed = way.at(time_s)
        assert (angle - 1.0) / DEG == pytest.approx(10.0 * t - 10.0 * t * t)
        assert speed / DEG == pytest.approx(10.0 - 20.0 * t, abs=1e-12)
