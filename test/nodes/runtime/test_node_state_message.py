"""How a node stands, through a message and back."""

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_ros.foundation.language import phrase
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


def test_texts_in_arguments_keep_their_codes_and_a_foreign_node_may_leave_them_out():
    step = phrase("table position {0}, target {1}", 3, 30)
    message = node_state_message(NodeState.of(State.CALIBRATING, Why.MEASURING, step, "arm"))
    (reason,) = message.reasons
    assert [code.code for code in reason.argument_codes] == [step.template, ""]
    (read,) = node_state(message).reasons
    assert read.arguments[0].parts == (3, 30)
    assert type(read.arguments[1]) is str
    reason.argument_codes = []
    assert node_state(message).reasons[0].arguments == (step, "arm")
