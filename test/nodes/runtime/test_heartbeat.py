"""A node beats while its executor takes no turn and says so; who hears nothing subscribes anew."""

from functools import partial
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from live_cell import wait_until
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import qos_profile_sensor_data
from rotcal_msgs.msg import NodeState
from std_msgs.msg import String

from rotcal_ros.foundation.node_state import NO_PLAN
from rotcal_ros.nodes.runtime import timers_and_subscriptions
from rotcal_ros.nodes.runtime.conversions import node_state
from rotcal_ros.nodes.runtime.health import Health
from rotcal_ros.nodes.runtime.liveness import HostProcess
from rotcal_ros.nodes.runtime.qos import EVENT
from rotcal_ros.nodes.runtime.running import PeerNode, default_context
from rotcal_ros.nodes.runtime.timers_and_subscriptions import (
    DrainedSubscription,
    connect_subscriptions,
)
from rotcal_ros.nodes.solver.node import SolverNode

pytestmark = pytest.mark.ros


@pytest.fixture
def heard():
    """Return a node, its executor, and what hears its beats until a condition."""
    peer, beats = PeerNode("listener"), []
    peer.node.create_subscription(NodeState, "heartbeat", beats.append, 100)
    with default_context():
        node = SolverNode()
        node.autostart()
        executor = SingleThreadedExecutor()
        executor.add_node(node)

        def wait_for(condition, turn=lambda: None):
            def met():
                turn()
                peer.work_until(lambda: False, 0.05)
                return condition(beats)

            wait_until(met, "a beat")
            return beats[-1]

        yield node, executor, wait_for
        executor.shutdown()
        node.destroy_node()
    peer.close()


def test_a_node_whose_executor_stands_beats_and_says_so(heard):
    _, executor, wait_for = heard
    wait_for(lambda beats: len(beats) > 3, lambda: executor.spin_once(timeout_sec=0.05))
    last = wait_for(lambda beats: beats[-1].busy > 2.0)
    assert node_state(last) == NO_PLAN
    assert HostProcess(last.host, last.pid, last.start) == HostProcess.own()
    back = wait_for(lambda beats: not beats[-1].busy, lambda: executor.spin_once(0.05))
    assert back.node == "solver"


def test_the_last_beat_is_the_goodbye(heard):
    node, executor, wait_for = heard
    wait_for(lambda beats: len(beats) > 3, lambda: executor.spin_once(timeout_sec=0.05))
    node.health.leave()
    wait_for(lambda beats: len(beats) > 3)
    assert wait_for(lambda _: True).state == NodeState.STATE_LEAVING


def test_who_does_not_hear_another_subscribes_anew():
    """As where the middleware never connects two ends: here one end is simply gone."""
    peer = PeerNode("planner")
    Health(peer.node, lambda: (NO_PLAN, {}))
    other = PeerNode("listener")
    deaf = Health(other.node, None)
    made, deaf._heard = deaf._heard, SimpleNamespace(drain=lambda: None)
    deaf._heard.anew = lambda: setattr(deaf, "_heard", made)

    def hears():
        peer.work_until(lambda: False, 0.05)
        other.work_until(lambda: False, 0.05)
        return deaf.present()

    wait_until(hears, "the planner is heard")
    assert deaf.state("planner") is NO_PLAN.state
    other.close()
    peer.close()


def test_who_is_not_connected_to_the_only_publisher_subscribes_anew(monkeypatch):
    """As where the middleware never connects two ends: here the first end asks for too much."""
    monkeypatch.setattr(timers_and_subscriptions, "UNHEARD_S", 0.5)
    source, listener, heard = PeerNode("instrument"), PeerNode("capture"), []
    node = listener.node
    publisher = source.node.create_publisher(String, "readings", qos_profile_sensor_data)
    deaf = DrainedSubscription(node, String, "readings", EVENT, heard.extend)
    deaf._make = partial(
        node.create_subscription, String, "readings", deaf._on_message, qos_profile_sensor_data
    )

    def hears():
        publisher.publish(String(data="a reading"))
        listener.work_until(lambda: False, 0.05)
        connect_subscriptions(node)
        return heard

    wait_until(hears, "a reading is heard")
    assert [node.count_publishers("readings"), len(list(node.subscriptions))] == [1, 1]
    ours = deaf.subscription
    wait_until(lambda: hears() and len(heard) > 50, "it is heard for longer than that")
    assert deaf.subscription is ours
    source.close()
    listener.close()
