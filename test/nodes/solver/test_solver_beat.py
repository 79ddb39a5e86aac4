"""The solver says that it solves as long as it does, so that nobody takes it for dead."""

import threading
from types import SimpleNamespace

import pytest

from rotcal_ros.foundation.machine_load import load_scaled_timeout

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from live_cell import wait_until
from rclpy.executors import SingleThreadedExecutor

from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.node_state import SOLVING
from rotcal_ros.nodes.runtime.running import default_context
from rotcal_ros.nodes.solver.node import SolverNode

pytestmark = pytest.mark.ros


class SlowCalibration:
    """Solves as long as the test wants, each solution on its own."""

    configuration = SimpleNamespace(cell=SimpleNamespace(axis="C"))

    def __init__(self):
        self.begun, self.go_on = threading.Semaphore(0), threading.Semaphore(0)

    def solve(self, *_):
        self.begun.release()
        assert self.go_on.acquire(timeout=load_scaled_timeout(30))
        raise DataError("nothing to solve")


@pytest.fixture
def solver():
    with default_context():
        node = SolverNode()
        node.autostart()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        yield node, executor
        node.begin_stop()
        executor.shutdown()
        node.destroy_node()


def test_a_preliminary_solution_that_ends_does_not_hide_the_final_one(solver):
    node, executor = solver
    slow = node._calibration = SlowCalibration()
    node._observations = {(0, 0): object()}

    node._preliminary()
    assert slow.begun.acquire(timeout=load_scaled_timeout(30))
    assert node._report()[0] == SOLVING

    final = node._begin(slow)
    slow.go_on.release()
    assert slow.begun.acquire(
        timeout=load_scaled_timeout(30)
    )  # the preliminary one ended, the final one runs
    for _ in range(5):
        executor.spin_once(timeout_sec=0.05)
    assert node._report()[0] == SOLVING

    slow.go_on.release()
    wait_until(final.done, "the final solution")
    assert node._report()[0] != SOLVING
