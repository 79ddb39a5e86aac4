"""What a bag says of a topic: its type with the definition, and its publishers' QoS."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, Final

from ament_index_python.packages import get_package_share_directory
from rclpy.duration import Duration
from rclpy.qos import QoSProfile

from rotcal_ros.bags.definitions import collect_definition
from rotcal_ros.bags.rosbag2_metadata import INFINITE_NS, OfferedQos, qos_text
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.nodes.writing.recording import Channel

_FEEDBACK: Final = "_FeedbackMessage"


def described_channel(name: str, type_name: str, infos: Sequence[Any]) -> Channel:
    """Return what a bag says of a topic; BagError when its type is not installed here."""
    hashes = {str(info.topic_type_hash) for info in infos}
    type_hash = hashes.pop() if len(hashes) == 1 else ""
    return Channel(
        topic=name,
        type_name=type_name,
        definition=collect_definition(type_name, _share),
        type_hash=type_hash if type_hash.startswith("RIHS") else "",
        offered_qos=qos_text(_offered(info.qos_profile) for info in infos),
    )


@cache
def own_channel(topic: str, type_name: str) -> Channel:
    """Return what a bag says of a topic without publishers: the recorder writes it itself."""
    return Channel(
        topic=topic,
        type_name=type_name,
        definition=collect_definition(type_name, _share),
        type_hash=_installed_hash(type_name) or "",
        offered_qos=qos_text([OfferedQos(depth=1)]),
    )


def importable_type(type_name: str, type_hash: str) -> type:
    """Return the class of a recorded message type; BagError where it is not the same here.

    ``type_hash`` is that of the recorded definition, empty where it is not known.
    """
    found, here = message_type(type_name), _installed_hash(type_name)
    if type_hash and here and type_hash != here:
        raise BagError(f"message type {type_name} is defined differently here and in the bag")
    return found


def message_type(type_name: str) -> type:
    """Return the class of a message type (``pkg/msg/Name``); BagError where there is none."""
    package, kind, name = [*type_name.split("/"), "", ""][:3]
    try:
        if kind == "action" and name.endswith(_FEEDBACK):
            action = getattr(import_module(f"{package}.{kind}"), name.removesuffix(_FEEDBACK))
            feedback: type = action.Impl.FeedbackMessage
            return feedback
        found: type = getattr(import_module(f"{package}.{kind}"), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise BagError(f"message type {type_name} is not installed here: {error}") from error
    return found


def _installed_hash(type_name: str) -> str | None:
    """Return the hash of a type's definition as it is installed; None where it is not known."""
    package, kind, name = type_name.split("/")
    try:
        described = _share(package) / kind / f"{name}.json"
        hashes = json.loads(described.read_text())["type_hashes"] if described.exists() else ()
    except LookupError:
        return None
    return next((h["hash_string"] for h in hashes if h["type_name"] == type_name), None)


def _share(package: str) -> Path:
    return Path(get_package_share_directory(package))


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


def _nanoseconds(duration: Duration) -> int:
    """Return a duration; "unspecified" (0) and "infinite" are both infinite for rosbag2."""
    nanoseconds: int = duration.nanoseconds
    return nanoseconds if nanoseconds > 0 else INFINITE_NS
