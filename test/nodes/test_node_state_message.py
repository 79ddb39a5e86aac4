"""The constants of the messages are those of the package, and a state goes through a beat."""

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_msgs.msg import NodeReason
from rotcal_msgs.msg import NodeState as NodeStateMsg

from rotcal_ros.foundation.node_state import UNHEARD, NodeState, Reason, State, Why
from rotcal_ros.nodes.runtime.conversions import node_state, node_state_message


def constants(message, prefix=""):
    names = (n for n in dir(type(message)) if n.isupper() and n.startswith(prefix))
    return {name.removeprefix(prefix): getattr(message, name) for name in names}


def test_the_constants_are_the_same():
    assert constants(NodeStateMsg, "STATE_") == {s.name: s.value for s in State}
    assert constants(NodeReason) == {code.name: code.value for code in Why}


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
