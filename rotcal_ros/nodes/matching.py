"""Who cannot hear whom: qualities of service that do not match, before anybody waits in vain."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from rclpy.node import Node
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible


@dataclass(frozen=True)
class Offer:
    """A publisher that is still to come."""

    node_name: str
    qos_profile: QoSProfile


def deaf_listeners(
    node: Node, topic: str, counts: Callable[[str], bool], to_come: Iterable[Offer] = ()
) -> Iterator[str]:
    """Yield in words which subscribers of an absolute ``topic`` get nothing of a publisher.

    ``counts`` says by its name whether a subscriber matters.
    """
    for source in (*node.get_publishers_info_by_topic(topic), *to_come):
        for reader in node.get_subscriptions_info_by_topic(topic):
            if not counts(reader.node_name):
                continue
            verdict, why = qos_check_compatible(source.qos_profile, reader.qos_profile)
            if verdict == QoSCompatibility.ERROR:
                yield (
                    f"node {reader.node_name} hears nothing on {topic} of node "
                    f"{source.node_name}: their qualities of service do not match "
                    f"({why.strip(' ;')})"
                )
