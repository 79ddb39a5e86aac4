"""Whether a machine that comes in the middle of a replay gets an order; no graph."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_ros.bags import names
from rotcal_ros.errors import ConfigurationError
from rotcal_ros.nodes.player import Player

TOPICS = [f"/cell/{role}" for role in (names.TABLE_ANGLE, names.PROBE_TARGET, "joint_states")]


@pytest.fixture
def replay():
    """Return a player, who listens to every topic, what was published, how long it stood still."""
    listeners, published, stood_s = [], [], []
    publisher = SimpleNamespace(publish=published.append)
    player = Player.__new__(Player)
    player._publishers = dict.fromkeys(TOPICS, (publisher, lambda data, _run: data))
    player._bag = SimpleNamespace(
        called=SimpleNamespace(role=lambda topic: topic.removeprefix("/cell/")), outputs=()
    )
    player._node = SimpleNamespace(
        get_subscriptions_info_by_topic=lambda _: [
            SimpleNamespace(node_name=n) for n in listeners
        ],
        get_publishers_info_by_topic=lambda _: [],
        get_name=lambda: "player",
    )
    player._health = SimpleNamespace(state=lambda _: "idle")
    player._given = SimpleNamespace(everything=False, clock=False, watchers=())
    player._pace, player._end = SimpleNamespace(stood_still=stood_s.append), False
    return player, listeners, published, stood_s


def publish(player, topic):
    player._publish(SimpleNamespace(topic=topic), topic, 1)


def test_the_graph_is_asked_before_every_order_and_no_machine_gets_one(replay):
    player, listeners, published, _ = replay
    for topic in TOPICS:
        publish(player, topic)
    assert published == TOPICS
    listeners.append("table_adapter")
    for topic in TOPICS[:2]:
        with pytest.raises(ConfigurationError, match=f"node table_adapter listens to {topic}"):
            publish(player, topic)
    assert published == TOPICS


@pytest.mark.parametrize(("name", "harmless"), [("recorder", True), ("table_adapter", False)])
def test_who_listens_without_a_name_is_waited_for(replay, name, harmless):
    player, listeners, published, stood_s = replay
    listeners.append("_NODE_NAME_UNKNOWN_")

    def work_until(_condition, _timeout_s):
        assert published == []
        listeners[:] = [name]

    player._peer = SimpleNamespace(work_until=work_until)
    if harmless:
        publish(player, TOPICS[0])
        assert published == TOPICS[:1]
    else:
        with pytest.raises(ConfigurationError, match="node table_adapter listens to"):
            publish(player, TOPICS[0])
        assert published == []
    assert 0.0 < sum(stood_s) < 10.0
