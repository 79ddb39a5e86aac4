"""A service that takes its time holds up neither what its node hears nor its beat."""

import asyncio
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from live_cell import wait_until
from rclpy.executors import SingleThreadedExecutor
from std_srvs.srv import Trigger

from rotcal_ros.foundation.node_state import NodeState, State
from rotcal_ros.nodes.planner.node import Planner
from rotcal_ros.nodes.recorder.node import RecorderNode
from rotcal_ros.nodes.runtime.cell_node import CellNode, wait_for_condition
from rotcal_ros.nodes.runtime.running import default_context
from rotcal_ros.nodes.solver.node import SolverNode

pytestmark = pytest.mark.ros


class Waiting(CellNode):
    """Answers once its timer has come three times."""

    def __init__(self):
        super().__init__("waiting")

    def configure(self):
        self.ticks, self.told = 0, []
        self.every(0.02, self.tick)
        self.offer(Trigger, "wait", self.wait)
        self.client = self.create_client(Trigger, "wait")

    def tick(self):
        self.ticks += 1

    async def wait(self, _request, response):
        enough = self.ticks + 3
        response.success = await wait_for_condition(lambda: self.ticks >= enough, 5.0)
        return response

    def _report(self):
        return NodeState(State.WAITING), {}


@pytest.fixture
def made():
    """Return what makes a node that is active, and its executor."""
    nodes = []
    with default_context():
        executor = SingleThreadedExecutor()

        def make(kind):
            node = kind()
            nodes.append(node)
            node.autostart()
            executor.add_node(node)
            return node, executor

        yield make
        executor.shutdown()
        for node in nodes:
            node.destroy_node()


def test_a_node_goes_on_while_it_answers(made):
    node, executor = made(Waiting)

    def turn():
        executor.spin_once(timeout_sec=0.05)

    def ready():
        turn()
        return node.client.service_is_ready()

    wait_until(ready, "the service is there")
    answer = node.client.call_async(Trigger.Request())

    def answered():
        turn()
        return answer.done()

    wait_until(answered, "it answers")
    assert answer.result().success


def test_a_solver_that_was_deactivated_meanwhile_publishes_nothing(made, monkeypatch):
    node, _ = made(SolverNode)
    published = []

    async def final(_request):
        node.trigger_deactivate()

    monkeypatch.setattr(node, "_final", final)
    monkeypatch.setattr(node, "_publish", lambda *_, **__: published.append(1))
    response = asyncio.run(node._finish(None, SimpleNamespace(success=False, message="")))
    assert not published
    assert not response.success
    assert "solver is inactive" in response.message


def planned(made, monkeypatch, prepared):
    """Let a planner carry out a goal whose preparation is ``prepared``; return outcome and why."""
    node, _ = made(Planner)
    goal = SimpleNamespace(watch=SimpleNamespace(stopping=""), verdict_line="", values=dict)

    async def prepare(_handle):
        return prepared(node, goal)

    async def execute():
        return SimpleNamespace(error_code=0)

    goal.execute = execute
    monkeypatch.setattr(node, "_prepared", prepare)
    monkeypatch.setattr(node, "_end", lambda *_: None)
    assert node._judge_goal(None).name == "ACCEPT"
    outcome = asyncio.run(node._execute(SimpleNamespace(abort=lambda: None)))
    return outcome, goal.watch.stopping


def test_a_goal_in_preparation_is_given_up_though_the_planner_is_active_again(made, monkeypatch):
    def prepared(node, goal):
        node.trigger_deactivate()
        node.trigger_activate()
        return goal

    assert planned(made, monkeypatch, prepared)[1] == "the planner was deactivated"


def test_a_preparation_that_fails_for_an_unknown_reason_has_an_error_code(made, monkeypatch):
    def prepared(_node, _goal):
        raise ValueError("nobody thought of that")

    outcome, _ = planned(made, monkeypatch, prepared)
    assert outcome.error_code == outcome.UNKNOWN
    assert "nobody thought of that" in outcome.error_msg


def test_a_recorder_that_is_deactivated_while_it_reads_opens_no_bag(made):
    node, _ = made(RecorderNode)
    closed = []

    def go_on(_plan_id, _topic):
        node.deactivated()
        return SimpleNamespace(writer=SimpleNamespace(close=lambda: closed.append(True)))

    node._bags = SimpleNamespace(go_on=go_on)
    request = SimpleNamespace(plan_id="ours", configuration="")
    response = asyncio.run(node._go_on(request, SimpleNamespace(success=False, message="")))
    assert closed
    assert not response.success
    assert "meanwhile" in response.message
    assert node.stopped()
