"""Topics of the graph as the recorder needs them: type, definition, hash, quality of service."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Final

from ament_index_python.packages import get_package_share_directory
from rclpy.duration import Duration, Infinite
from rclpy.node import Node
from rclpy.qos import QoSProfile

from rotcal_ros.bags.definitions import collect_definition
from rotcal_ros.bags.rosbag2_metadata import INFINITE_NS, OfferedQos, qos_text
from rotcal_ros.errors import BagError
from rotcal_ros.nodes.qos import adapted_qos
from rotcal_ros.nodes.recording import Channel

ALWAYS: Final = ("/diagnostics", "/rosout")


@dataclass(frozen=True)
class DiscoveredTopic:
    """A topic with publishers, ready to be subscribed to and to become a channel."""

    channel: Channel
    message_type: type
    qos: QoSProfile


def wanted_topics(node: Node) -> dict[str, str]:
    """Return name -> type of all topics of the cell: its namespace, diagnostics and log."""
    prefix = node.get_namespace().rstrip("/") + "/"
    return {
        name: types[0]
        for name, types in node.get_topic_names_and_types()
        if (name in ALWAYS or name.startswith(prefix)) and "/_" not in name
    }


def discover(node: Node, name: str, type_name: str) -> DiscoveredTopic | None:
    """Return what is to know about a topic; None as long as nobody publishes it.

    Raises BagError when its type is not installed here.
    """
    infos = node.get_publishers_info_by_topic(name)
    if not infos:
        return None
    hashes = {str(info.topic_type_hash) for info in infos}
    type_hash = hashes.pop() if len(hashes) == 1 else ""
    profiles = [info.qos_profile for info in infos]
    channel = Channel(
        topic=name,
        type_name=type_name,
        definition=collect_definition(type_name, lambda p: Path(get_package_share_directory(p))),
        type_hash=type_hash if type_hash.startswith("RIHS") else "",
        offered_qos=qos_text(_offered(profile) for profile in profiles),
    )
    return DiscoveredTopic(channel, _message_type(type_name), adapted_qos(profiles))


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
