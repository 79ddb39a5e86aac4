"""Listening to every topic of a cell as serialised bytes, whoever publishes it whenever."""

from __future__ import annotations

import struct
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Final

from ament_index_python.packages import get_package_share_directory
from rclpy.duration import Duration, Infinite
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile

from rotcal_ros.bags.definitions import collect_definition
from rotcal_ros.bags.rosbag2_metadata import INFINITE_NS, OfferedQos, qos_text
from rotcal_ros.errors import BagError
from rotcal_ros.nodes.bookkeeping import TopicLosses
from rotcal_ros.nodes.cell_node import CellNode
from rotcal_ros.nodes.draining import GRAPH_PERIOD_S, Batch, DrainedSubscription
from rotcal_ros.nodes.qos import adapted_qos
from rotcal_ros.nodes.recording import Channel

ALWAYS: Final = ("/diagnostics", "/rosout")
"""Topics outside the namespace of the cell that are recorded too."""
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
        """Subscribe to topics that are new in the graph and have publishers."""
        for name, type_name in _wanted_topics(self._node).items():
            if name in self.topics or name in self.refused:
                continue
            infos = self._node.get_publishers_info_by_topic(name)
            if not infos:
                continue
            try:
                message_type = _message_type(type_name)
                self.topics[name] = HeardTopic(_channel(name, type_name, infos))
            except BagError as error:
                self.refused[name] = str(error)
                self._node.get_logger().error(f"{name} cannot be recorded: {error}")
                continue
            qos = adapted_qos([info.qos_profile for info in infos])
            self._subscribe(self.topics[name], message_type, qos)

    def _subscribe(self, topic: HeardTopic, message_type: type, qos: QoSProfile) -> None:
        name = topic.channel.topic

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
                message_type,
                name,
                qos,
                self._node.health.guarded(handle),
                raw=True,
                event_callbacks=SubscriptionEventCallbacks(
                    message_lost=message_lost, incompatible_qos=incompatible
                ),
            )
        )


def _wanted_topics(node: Node) -> dict[str, str]:
    """Return name -> type of all topics of the cell: its namespace, diagnostics and log."""
    prefix = node.get_namespace().rstrip("/") + "/"
    return {
        name: types[0]
        for name, types in node.get_topic_names_and_types()
        if (name in ALWAYS or name.startswith(prefix)) and "/_" not in name
    }


def _channel(name: str, type_name: str, infos: Sequence[Any]) -> Channel:
    """Return what a bag says of a topic; BagError when its type is not installed here."""
    hashes = {str(info.topic_type_hash) for info in infos}
    type_hash = hashes.pop() if len(hashes) == 1 else ""
    return Channel(
        topic=name,
        type_name=type_name,
        definition=collect_definition(type_name, lambda p: Path(get_package_share_directory(p))),
        type_hash=type_hash if type_hash.startswith("RIHS") else "",
        offered_qos=qos_text(_offered(info.qos_profile) for info in infos),
    )


def _message_type(type_name: str) -> type:
    package, kind, name = type_name.split("/")
    try:
        message_type: type = getattr(import_module(f"{package}.{kind}"), name)
    except (ImportError, AttributeError) as error:
        raise BagError(f"message type {type_name} is not installed here: {error}") from error
    return message_type


def _offered(profile: QoSProfile) -> OfferedQos:
    return OfferedQos(
        history=profile.history.short_key,
        depth=profile.depth,
        reliability=profile.reliability.short_key,
        durability=profile.durability.short_key,
        deadline_ns=_nanoseconds(profile.deadline),
        lifespan_ns=_nanoseconds(profile.lifespan),
        liveliness=profile.liveliness.short_key,
        lease_ns=_nanoseconds(profile.liveliness_lease_duration),
    )


def _nanoseconds(duration: Duration | Any) -> int:
    """Return a duration; "unspecified" (0) and "infinite" are both infinite for rosbag2."""
    nanoseconds: int = duration.nanoseconds
    if nanoseconds <= 0 or duration == Infinite:
        return INFINITE_NS
    return min(nanoseconds, INFINITE_NS)
