"""A node on its way between its states, in this process."""

import pytest

rclpy = pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.lifecycle import TransitionCallbackReturn  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from rotcal_ros.foundation.errors import ConfigurationError  # noqa: E402
from rotcal_ros.foundation.node_state import NodeState, State  # noqa: E402
from rotcal_ros.nodes.runtime.cell_node import CellNode  # noqa: E402
from rotcal_ros.nodes.runtime.qos import EVENT, LATCHED  # noqa: E402

pytestmark = pytest.mark.ros
SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


class Fragile(CellNode):
    """Makes one of each, and does what ``trouble`` lets it."""

    trouble = ""

    def configure(self):
        self.heard, self.given_up, self.ending = [], 0, False
        self.plans = self.create_publisher(String, "plan", LATCHED)
        self.news = self.create_publisher(String, "news", EVENT)
        self.listen(String, "plan", lambda message: self.heard.append(message.data), LATCHED)
        self.listen(String, "news", lambda message: self.heard.append(message.data), EVENT)
        self.every(10.0, lambda: None)
        self.offer(Trigger, "do", lambda _request, response: response)
        if self.trouble == "configure":
            raise ConfigurationError("there is no machine")

    def activated(self):
        if self.trouble == "activate":
            raise OSError("the port is taken")

    def deactivated(self):
        self.given_up += 1
        if self.trouble == "deactivate":
            raise ValueError("half way")

    def stopped(self):
        return self.trouble != "clean up"

    def _report(self):
        return NodeState(State.WORKING), {}


@pytest.fixture
def node():
    rclpy.init()
    autostart = Parameter("autostart", value=False)
    made = Fragile("fragile", parameter_overrides=[autostart], start_parameter_services=False)
    yield made
    made.destroy_node()
    rclpy.shutdown()


def parts(node):
    kinds = (node.publishers, node.subscriptions, node.services, node.timers)
    return [len(list(kind)) for kind in kinds]


def test_what_could_not_be_configured_leaves_nothing_and_is_tried_again(node):
    before = parts(node)
    node.trouble = "configure"
    assert node.trigger_configure() == FAILURE
    assert (parts(node), node._beat_values()[0].state) == (before, State.UNCONFIGURED)
    node.trouble = ""
    assert node.trigger_configure() == SUCCESS
    assert parts(node) == [n + more for n, more in zip(before, (2, 2, 1, 1), strict=True)]
    text = "node fragile is inactive: ros2 lifecycle set /fragile activate"
    assert str(node.not_active_error()) == text
    node.trouble = "activate"
    assert node.trigger_activate() == FAILURE
    assert not node.active
    node.trouble = ""
    assert node.trigger_activate() == SUCCESS
    assert node._beat_values()[0].state is State.WORKING
    node.trouble = "deactivate"  # it must be off, whatever happens
    assert node.trigger_deactivate() == SUCCESS
    assert (node.given_up, node.active) == (1, False)


def test_a_clean_up_gives_all_back_and_waits_for_what_is_still_ending(node):
    before = parts(node)
    node.trigger_configure()
    node.trouble = "clean up"
    assert node.trigger_cleanup() == FAILURE
    assert node.trigger_activate() == FAILURE  # it is half gone
    node.trouble = ""
    assert node.trigger_cleanup() == SUCCESS
    assert parts(node) == before
    assert (node.trigger_configure(), node.trigger_activate()) == (SUCCESS, SUCCESS)
    assert not node.has_ended()
    node.trigger_shutdown()
    assert node.has_ended()


def test_a_clean_up_leaves_a_subscription_that_was_made_anew(node):
    before = parts(node)
    node.trigger_configure()
    node.health._heard.anew()
    assert node.trigger_cleanup() == SUCCESS
    assert parts(node) == before
    assert node.health._heard.subscription in node.subscriptions


def test_a_latched_message_waits_for_the_activation_and_others_do_not(node):
    node.trigger_configure()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    node.plans.publish(String(data="a plan"))
    node.news.publish(String(data="old news"))
    for _ in range(100):
        executor.spin_once(timeout_sec=0.05)
        if node._latched and node._ignored_topics:
            break
    assert node.heard == []
    node.trigger_activate()
    assert node.heard == ["a plan"]
    executor.shutdown()


def test_with_autostart_the_reason_is_raised(node):
    node._autostart, node.trouble = True, "configure"
    with pytest.raises(ConfigurationError, match="there is no machine"):
        node.autostart()
