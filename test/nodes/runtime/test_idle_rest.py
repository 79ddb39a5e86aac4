"""A node that has time takes messages together, and wakes often enough for everybody else."""

import sys
import time
from functools import partial
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_ros.foundation.machine_load import load_scaled_timeout
from rotcal_ros.nodes.runtime import running

TURN_S = 0.001


@pytest.mark.parametrize(
    ("gather_s", "simulated", "share"), [(0.04, False, 0.25), (0.0, False, 1), (0.04, True, 1)]
)
def test_who_lets_messages_gather_is_awake_for_a_part_of_it(
    monkeypatch, gather_s, simulated, share
):
    now_s, awake_s = 0.0, 0.0

    def sleep(seconds):
        nonlocal now_s
        now_s += seconds

    monkeypatch.setattr(running.time, "monotonic", lambda: now_s)
    monkeypatch.setattr(running.time, "sleep", sleep)
    sim = SimpleNamespace(used=simulated)
    node = SimpleNamespace(batch_period_s=lambda: gather_s, health=SimpleNamespace(sim=sim))
    rest = running._Rest()
    while now_s < 2.0:  # a turn of the executor, and the rest behind it
        now_s, awake_s = now_s + TURN_S, awake_s + TURN_S
        before_s = now_s
        rest.take(node)
        assert now_s - before_s < 0.05  # a beat is due five times a second
    assert awake_s / now_s == pytest.approx(share, abs=0.06)


def test_capture_and_solver_take_their_time_until_the_planner_measures():
    from rotcal_ros.nodes.capture.node import CaptureNode
    from rotcal_ros.nodes.runtime.cell_node import CellNode
    from rotcal_ros.nodes.solver.node import SolverNode

    for kind, at_work_s in ((CaptureNode, 0.01), (SolverNode, 0.04)):
        for measures, gather_s in ((False, 0.1), (True, at_work_s)):
            health = SimpleNamespace(is_calibrating=lambda measures=measures: measures)
            node = SimpleNamespace(health=health, _answering=0)
            node.idle_batch_period_s = partial(CellNode.idle_batch_period_s, node)
            assert kind.batch_period_s(node) == gather_s


def test_events_are_handled_once_and_no_turn_waits_for_them(monkeypatch):
    """A publisher that nobody can hear: the event of a subscription that asks for more."""
    import rclpy
    from rclpy.event_handler import EventHandler, SubscriptionEventCallbacks
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from std_msgs.msg import Bool

    from rotcal_ros.nodes.runtime.managed_node import ManagedNode
    from rotcal_ros.nodes.runtime.timers_and_subscriptions import handle_events
    from rotcal_ros.sessions.processes import node_environment

    for name, value in node_environment().items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("AMENT_PREFIX_PATH", sys.prefix)
    rclpy.init()
    try:
        node, heard = ManagedNode("listener"), []
        callbacks = SubscriptionEventCallbacks(incompatible_qos=heard.append)
        node.create_subscription(Bool, "stop", print, 1, event_callbacks=callbacks)
        events = [each for each in node.waitables if isinstance(each, EventHandler)]
        assert events
        assert not any(each.callback_group.can_execute(each) for each in events)
        assert all(t.callback_group.can_execute(t) for t in node.timers)

        other = rclpy.create_node("speaker")
        unheard = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        other.create_publisher(Bool, "stop", unheard)
        end = time.monotonic() + load_scaled_timeout(30.0)
        while not heard and time.monotonic() < end:
            handle_events(node)
            time.sleep(0.01)
        handle_events(node)
        assert [event.total_count for event in heard] == [1]
    finally:
        rclpy.try_shutdown()
