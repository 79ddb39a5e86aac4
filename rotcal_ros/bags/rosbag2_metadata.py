"""rosbag2's ``metadata.yaml``: what every rosbag2 tool looks at first."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import yaml

from rotcal_ros.bags.definitions import ChannelDefinition

VERSION: Final = 9
"""Version of the format: the one of ROS 2 Kilted."""
INFINITE_NS: Final = 2**63 - 1


_QOS_KEYS: Final = {
    "history", "depth", "reliability", "durability", "deadline", "lifespan", "liveliness",
    "liveliness_lease_duration", "avoid_ros_namespace_conventions",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class OfferedQos:
    """Quality of service that a publisher offers, in rosbag2's words; durations in ns."""

    history: str = "unknown"
    depth: int = 0
    reliability: str = "reliable"
    durability: str = "volatile"
    deadline_ns: int = INFINITE_NS
    lifespan_ns: int = INFINITE_NS
    liveliness: str = "automatic"
    lease_ns: int = INFINITE_NS


def qos_text(profiles: Iterable[OfferedQos]) -> str:
    """Return the YAML text that rosbag2 keeps in a channel's ``offered_qos_profiles``."""
    entries = [
        {
            "history": profile.history,
            "depth": profile.depth,
            "reliability": profile.reliability,
            "durability": profile.durability,
            "deadline": _duration(profile.deadline_ns),
            "lifespan": _duration(profile.lifespan_ns),
            "liveliness": profile.liveliness,
            "liveliness_lease_duration": _duration(profile.lease_ns),
            "avoid_ros_namespace_conventions": False,
        }
        for profile in profiles
    ]
    return yaml_text(entries) if entries else ""


def qos_profiles(text: str) -> list[Any]:
    """Return the profiles in a channel's ``offered_qos_profiles``; none unless all are whole."""
    try:
        profiles = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError):
        return []
    whole = isinstance(profiles, list) and all(
        isinstance(profile, dict) and profile.keys() >= _QOS_KEYS for profile in profiles
    )
    return profiles if whole else []


@dataclass(slots=True)
class FileInfo:
    """One storage file: name, range of log times (ns) and number of messages per topic.

    ``channels`` of an earlier file say what the writer of a later one cannot know.
    """

    name: str
    start_ns: int = INFINITE_NS
    end_ns: int = 0
    counts: dict[str, int] = field(default_factory=dict)
    channels: tuple[ChannelDefinition, ...] = field(default=(), compare=False)

    @property
    def messages(self) -> int:
        """Number of messages over all topics."""
        return sum(self.counts.values())


def bag_information(
    files: Sequence[FileInfo],
    channels: Iterable[ChannelDefinition],
    *,
    ros_distro: str = "",
    custom_data: Mapping[str, str] | None = None,
    storage: str = "mcap",
    compression_mode: str = "",
) -> dict[str, Any]:
    """Return the mapping that rosbag2 calls ``rosbag2_bagfile_information``.

    It has the topics of ``channels`` and those that the files know besides. What is compressed
    by rosbag2, in the mode of that name, is so by zstd.
    """
    by_topic = {c.topic: c for c in (*(c for f in files for c in f.channels), *channels)}
    return {
        "version": VERSION,
        "storage_identifier": storage,
        **_span(files),
        "topics_with_message_count": [_topic(channel, files) for channel in by_topic.values()],
        "compression_format": "zstd" if compression_mode else "",
        "compression_mode": compression_mode,
        "relative_file_paths": [file.name for file in files],
        "files": [{"path": file.name, **_span([file])} for file in files],
        "custom_data": dict(custom_data or {}),
        "ros_distro": ros_distro,
    }


def _topic(channel: ChannelDefinition, files: Sequence[FileInfo]) -> dict[str, Any]:
    return {
        "topic_metadata": {
            "name": channel.topic,
            "type": channel.type_name,
            "serialization_format": channel.message_encoding,
            "offered_qos_profiles": qos_profiles(channel.offered_qos),
            "type_description_hash": channel.type_hash,
        },
        "message_count": sum(file.counts.get(channel.topic, 0) for file in files),
    }


def _span(files: Sequence[FileInfo]) -> dict[str, Any]:
    filled = [file for file in files if file.messages]
    start = min((file.start_ns for file in filled), default=0)
    end = max((file.end_ns for file in filled), default=0)
    return {
        "duration": {"nanoseconds": max(0, end - start)},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": sum(file.messages for file in files),
    }


def _duration(nanoseconds: int) -> dict[str, int]:
    seconds, rest = divmod(nanoseconds, 1_000_000_000)
    return {"sec": seconds, "nsec": rest}


def yaml_text(data: Any) -> str:
    """Return ``data`` as YAML in the form of rosbag2's files."""
    text: str = yaml.safe_dump(data, sort_keys=False, default_flow_style=False)
    return text
