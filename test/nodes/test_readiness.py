"""What is waited for, and what a person is told when nothing is any more."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_ros.foundation.node_state import NodeState, State, Why
from rotcal_ros.nodes.planner.cell_links import CellLinks
from rotcal_ros.nodes.readiness import inactive_node_lines, next_steps

IDLE = NodeState.of(State.INACTIVE, Why.TO_ACTIVATE, "/cell/capture")
READY, WAITING = NodeState(State.READY), NodeState(State.WAITING)
TOLD = "node capture is inactive: ros2 lifecycle set /cell/capture activate"


class Heard:
    """A health that has heard these states."""

    def __init__(self, **states):
        self._states = states

    def state(self, name):
        return self._states[name].state

    def describe(self, name):
        return self._states[name].describe()

    def present(self):
        return self._states.keys()

    def missing(self, names):
        return sorted(set(names) - self._states.keys())


def test_each_node_that_is_not_active_is_named_with_what_to_do():
    heard = Heard(planner=READY, capture=IDLE)
    assert inactive_node_lines(heard, ["planner", "capture", "solver"]) == [
        TOLD,
        "node solver is not there (yet)",
    ]
    assert inactive_node_lines(Heard(planner=READY), ["planner"]) == []


def test_a_goal_waits_for_every_node_but_those_it_does_not_need():
    heard = Heard(capture=IDLE, dme_adapter=WAITING, bridge=IDLE, scene=IDLE)
    assert CellLinks.idle_nodes(SimpleNamespace(health=heard)) == [TOLD]


def test_the_goal_is_sent_to_this_cell_in_this_domain():
    text = next_steps("/left/cell/", ["planner"], "7")
    assert "ros2 action send_goal --feedback /left/cell/calibrate rotcal_msgs/action/Calib" in text
    assert "rotcal_msgs/action/Calibrate '{}'\n" in text
    assert "ROS_DOMAIN_ID=7\n" in text
    assert "ROS_DOMAIN_ID" not in next_steps("/cell", ["planner"], "")
