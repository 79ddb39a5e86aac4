"""Whether a machine that comes in the middle of a replay gets an order; no graph."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_ros.bags import names
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.nodes.player.node import Player, TopicConflictGuard

NAMELESS = "_NODE_NAME_UNKNOWN_"
TOPICS = [f"/cell/{role}" for role in (names.TABLE_ANGLE, names.PROBE_TARGET, "joint_states")]


class Replay:
    """A player of TOPICS to ``listeners``, a node's name each; ``hear`` is what a wait brings."""

    def __init__(self):
        self.listeners, self.published, self.waited = [], [], 0
        self.receive = lambda: None
        publisher = SimpleNamespace(publish=self.published.append)
        self.player = player = Player.__new__(Player)
        player._publishers = dict.fromkeys(TOPICS, publisher)
        bag = player._bag = SimpleNamespace(
            called=SimpleNamespace(role=lambda topic: topic.removeprefix("/cell/")), outputs=()
        )
        node = SimpleNamespace(
            get_subscriptions_info_by_topic=lambda _: [*map(self._subscription, self.listeners)],
            get_publishers_info_by_topic=lambda _: [],
            get_name=lambda: "player",
        )
        health = SimpleNamespace(is_calibrating=lambda: False)
        given = SimpleNamespace(everything=False, clock=False, watchers=())
        player._guard = TopicConflictGuard(node, health, bag, given, self._wait)

    def publish(self, topic):
        self.player._publish(SimpleNamespace(topic=topic), topic)

    def _subscription(self, name):
        return SimpleNamespace(node_name=name, endpoint_gid=[len(self.listeners)] * 16)

    def _wait(self, condition, timeout_s):
        """Wait as a player does: hear what comes, once for each time-out."""
        if not condition():
            assert timeout_s < 60.0
            self.waited += 1
            self.receive()


def test_the_graph_is_asked_before_every_order_and_no_machine_gets_one():
    replay = Replay()
    for topic in TOPICS:
        replay.publish(topic)
    assert replay.published == TOPICS
    replay.listeners.append("table_adapter")
    for topic in TOPICS[:2]:
        with pytest.raises(ConfigurationError, match=f"node table_adapter listens to {topic}"):
            replay.publish(topic)
    assert replay.published == TOPICS
    assert replay.waited == 0


@pytest.mark.parametrize(
    ("name", "harmless"), [("recorder", True), ("table_adapter", False), (NAMELESS, False)]
)
def test_who_listens_without_a_name_is_waited_for(name, harmless):
    replay = Replay()
    replay.listeners.append(NAMELESS)
    replay.receive = lambda: replay.listeners.__setitem__(0, name)
    if harmless:
        replay.publish(TOPICS[0])
    else:
        with pytest.raises(ConfigurationError, match=f"node {name} listens to"):
            replay.publish(TOPICS[0])
    assert replay.published == TOPICS[:harmless]
    assert replay.waited == 1


def test_a_name_that_never_comes_is_waited_for_once_and_only_where_it_counts():
    replay = Replay()
    replay.listeners.append(NAMELESS)
    replay.player._guard.poll(*TOPICS[2:])  # who listens to joint_states moves nothing
    assert replay.waited == 0
    for _ in range(3):
        with pytest.raises(ConfigurationError, match=f"node {NAMELESS} listens to"):
            replay.publish(TOPICS[0])
    assert replay.waited == 1
