"""A node beats while its executor takes no turn and says so; who hears no beat subscribes anew."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from live_cell import wait_until
from rclpy.executors import SingleThreadedExecutor
from rotcal_msgs.msg import NodeState

from rotcal_ros.foundation.node_state import NO_PLAN
from rotcal_ros.nodes.runtime.conversions import node_state
from rotcal_ros.nodes.runtime.health import Health
from rotcal_ros.nodes.runtime.liveness import HostProcess
from rotcal_ros.nodes.runtime.running import Peer, default_context
from rotcal_ros.nodes.solver.node import SolverNode

pytestmark = pytest.mark.ros


@pytest.fixture
def heard():
    """Return a node, its executor, and what hears its beats until a condition."""
    peer, beats = Peer("listener"), []
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
    peer = Peer("planner")
    Health(peer.node, lambda: (NO_PLAN, {}))
    other = Peer("listener")
    deaf = Health(other.node, None)
    other.node.destroy_subscription(deaf._heard.subscription)
    deaf._heard = SimpleNamespace(drain=lambda: None, subscription=None)

    def hears():
        peer.work_until(lambda: False, 0.05)
        other.work_until(lambda: False, 0.05)
        return deaf.present()

    wait_until(hears, "the planner is heard")
    assert deaf.state("planner") is NO_PLAN.state
    other.close()
    peer.close()
