"""A node beats while its executor takes no turn, and tells for how long that has been."""

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from diagnostic_msgs.msg import DiagnosticStatus
from live_cell import wait_until
from rclpy.executors import SingleThreadedExecutor

from rotcal_ros.nodes.runtime.heartbeat import BUSY
from rotcal_ros.nodes.runtime.peer import Peer
from rotcal_ros.nodes.runtime.processes_here import PROCESS, own_process
from rotcal_ros.nodes.runtime.running import default_context
from rotcal_ros.nodes.solver import SolverNode

pytestmark = pytest.mark.ros


@pytest.fixture
def heard():
    """Return a node, its executor, and what hears the values of its beats until a condition."""
    peer, beats = Peer("listener"), []
    peer.node.create_subscription(DiagnosticStatus, "heartbeat", beats.append, 100)
    with default_context():
        node = SolverNode()
        node.autostart()
        executor = SingleThreadedExecutor()
        executor.add_node(node)

        def wait_for(condition, turn=lambda: None):
            def met():
                turn()
                peer.work_until(lambda: False, 0.05)
                return condition([{v.key: v.value for v in beat.values} for beat in beats])

            wait_until(met, "a beat")
            return beats[-1]

        yield node, executor, wait_for
        executor.shutdown()
        node.destroy_node()
    peer.close()


def test_a_node_whose_executor_stands_beats_and_says_so(heard):
    _, executor, wait_for = heard
    wait_for(lambda beats: len(beats) > 3, lambda: executor.spin_once(timeout_sec=0.05))
    last = wait_for(lambda beats: float(beats[-1].get(BUSY, 0.0)) > 2.0)
    assert last.message == "waiting for a plan"
    values = {v.key: v.value for v in last.values}
    assert values[PROCESS] == own_process()
    back = wait_for(lambda beats: BUSY not in beats[-1], lambda: executor.spin_once(0.05))
    assert back.name == "solver"


def test_the_last_beat_is_the_goodbye(heard):
    node, executor, wait_for = heard
    wait_for(lambda beats: len(beats) > 3, lambda: executor.spin_once(timeout_sec=0.05))
    node.health.leave()
    wait_for(lambda beats: len(beats) > 3)
    assert wait_for(lambda _: True).message == "leaving"
