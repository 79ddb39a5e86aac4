"""How a node stands, through a message and back."""

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_ros.foundation.node_state import UNHEARD, NodeState, Reason, State, Why
from rotcal_ros.nodes.runtime.conversions import node_state, node_state_message


@pytest.mark.parametrize(
    "state",
    [
        UNHEARD,
        NodeState(State.CALIBRATING, (Reason.of(Why.MEASURING, "target 3"),), 3, 60),
        NodeState(State.READY, (Reason.of(Why.SERVING, "x"),), page="http://[::1]:80"),
        NodeState(State.FAILED, (Reason(Why.HELD), Reason.of(Why.NO_RESULT, "too few"))),
    ],
)
def test_a_state_goes_through_a_message(state):
    assert node_state(node_state_message(state)) == state
