"""Whether a machine that comes in the middle of a replay gets an order; no graph."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("rotcal_msgs")

from rotcal_ros.bags import names
from rotcal_ros.errors import ConfigurationError
from rotcal_ros.nodes.player import Player


def test_the_graph_is_asked_before_every_order_and_no_machine_gets_one():
    machines, published = [], []
    publisher = SimpleNamespace(publish=published.append)
    topics = [f"/cell/{role}" for role in (names.TABLE_ANGLE, names.PROBE_TARGET, "joint_states")]
    player = Player.__new__(Player)
    player._publishers = dict.fromkeys(topics, (publisher, lambda data, _run: data))
    player._bag = SimpleNamespace(
        called=SimpleNamespace(role=lambda topic: topic.removeprefix("/cell/")), outputs=()
    )
    player._node = SimpleNamespace(
        get_subscriptions_info_by_topic=lambda _: [SimpleNamespace(node_name=n) for n in machines],
        get_publishers_info_by_topic=lambda _: [],
        get_name=lambda: "player",
    )
    player._health = SimpleNamespace(state=lambda _: "idle")
    player._given = SimpleNamespace(everything=False, clock=False, watchers=())
    for topic in topics:
        player._publish(SimpleNamespace(topic=topic), topic, 1)
    assert published == topics
    machines.append("table_adapter")
    for topic in topics[:2]:
        with pytest.raises(ConfigurationError, match=f"node table_adapter listens to {topic}"):
            player._publish(SimpleNamespace(topic=topic), topic, 1)
    assert published == topics
