"""Listening to every topic of a cell as serialised bytes, whoever publishes it whenever."""

from __future__ import annotations

import struct
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

from rclpy.event_handler import SubscriptionEventCallbacks

from rotcal_ros.errors import BagError
from rotcal_ros.nodes.cell_node import CellNode
from rotcal_ros.nodes.draining import GRAPH_PERIOD_S, Batch, DrainedSubscription
from rotcal_ros.nodes.recording import Channel
from rotcal_ros.nodes.topic_discovery import DiscoveredTopic, discover, wanted_topics
from rotcal_ros.nodes.topic_losses import TopicLosses

_STAMP: Final = struct.Struct("<4xiI")
"""CDR encapsulation, then the stamp that begins every message with a header."""


@dataclass
class HeardTopic:
    """A topic that is listened to: its channel and how far it has come.

    ``heard_s`` is the monotonic time of the latest batch, or of the subscription.
    """

    channel: Channel
    heard_s: float = field(default_factory=time.monotonic)
    latest: bytes = b""
    losses: TopicLosses = field(default_factory=TopicLosses)

    def latest_stamp_ns(self) -> int:
        """Return the stamp of the newest message, which must have a header; 0: none came."""
        if not self.latest:
            return 0
        seconds, nanoseconds = _STAMP.unpack_from(self.latest)
        return int(seconds) * 1_000_000_000 + int(nanoseconds)


class Listener:
    """Subscribes to topics as they appear and hands their messages to ``take``.

    ``topics`` maps absolute names to what was heard, ``refused`` names topics whose type is not
    installed.
    """

    def __init__(self, node: CellNode, take: Callable[[HeardTopic, Batch], None]) -> None:
        self._node = node
        self._hand_over = take
        self._drained: list[DrainedSubscription] = []
        self.topics: dict[str, HeardTopic] = {}
        self.refused: dict[str, str] = {}
        self._incompatible: Counter[str] = Counter()
        node.every(GRAPH_PERIOD_S, self._look)

    @property
    def losses(self) -> Counter[str]:
        """What the middleware lost, and how many publishers nobody can hear, by name."""
        lost = {f"lost {name}": topic.losses.count for name, topic in self.topics.items()}
        return Counter({name: count for name, count in lost.items() if count}) + self._incompatible

    def forget_losses(self) -> None:
        """Count from zero."""
        self._incompatible.clear()
        for topic in self.topics.values():
            topic.losses.forget()

    def drain(self) -> None:
        """Take what has arrived and is still waiting."""
        for drained in self._drained:
            drained.drain()

    def _look(self) -> None:
        """Subscribe to topics that are new in the graph."""
        for name, type_name in wanted_topics(self._node).items():
            if name in self.topics or name in self.refused:
                continue
            try:
                discovered = discover(self._node, name, type_name)
            except BagError as error:
                self.refused[name] = str(error)
                self._node.get_logger().error(f"{name} cannot be recorded: {error}")
                continue
            if discovered is not None:
                self._subscribe(discovered)

    def _subscribe(self, found: DiscoveredTopic) -> None:
        name = found.channel.topic
        topic = self.topics[name] = HeardTopic(found.channel)

        def handle(batch: Batch) -> None:
            topic.latest, topic.heard_s = batch[-1][0], time.monotonic()
            for _, info in batch:
                publisher = info.get("publisher_gid")
                if publisher is not None:
                    topic.losses.number(
                        info.get("publication_sequence_number"), bytes(publisher["data"])
                    )
            self._hand_over(topic, batch)

        def message_lost(event: Any) -> None:
            topic.losses.report(event.total_count_change)

        def incompatible(event: Any) -> None:
            self._incompatible[f"incompatible publisher {name}"] += event.total_count_change

        self._drained.append(
            DrainedSubscription(
                self._node,
                found.message_type,
                name,
                found.qos,
                self._node.health.guarded(handle),
                raw=True,
                event_callbacks=SubscriptionEventCallbacks(
                    message_lost=message_lost, incompatible_qos=incompatible
                ),
            )
        )
