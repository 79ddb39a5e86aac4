"""rosbag2's ``metadata.yaml``, which every rosbag2 tool reads first.

It is written in version 9; versions 1 to 9 of any writer are read.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any, Final

import yaml

from rotcal_ros.bags import names
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.untrusted import cause_of, load_yaml, read_text

VERSION: Final = 9
"""Version of the format: that of ROS 2 Jazzy and Kilted."""
INFINITE_NS: Final = 2**63 - 1


_QOS_KEYS: Final = {
    "history", "depth", "reliability", "durability", "deadline", "lifespan", "liveliness",
    "liveliness_lease_duration", "avoid_ros_namespace_conventions",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class OfferedQos:
    """Quality of service that a publisher offers, as rosbag2 writes it; durations in ns."""

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

    It has the topics of ``channels`` and all others in the files. rosbag2's compression is always
    zstd here, in the mode of that name.
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


METADATA_FILE: Final = "metadata.yaml"
INFORMATION: Final = "rosbag2_bagfile_information"
LIBRARY_KEY: Final = "library"
MISSING_KEY: Final = "rotcal_missing"
"""What was missing when the description was rebuilt, among the custom data."""
_LARGEST: Final = 1 << 22
_LARGEST_COUNT: Final = 1 << 63


@dataclass(frozen=True, slots=True)
class FileEntry:
    """What a description says of one file: times in ns; None if it does not say (before 5)."""

    name: str
    messages: int | None = None
    start_ns: int | None = None
    duration_ns: int | None = None

    def describe(self) -> str:
        """Return how much is in the file."""
        if self.messages is None or self.duration_ns is None:
            return ""
        return f"{self.messages} messages in {self.duration_ns / 1e9:.3f} s"


@dataclass(frozen=True, slots=True)
class BagDescription:
    """What ``metadata.yaml`` says: its files, and messages by topic over all of them.

    ``compression_mode`` is ``file``, ``message`` or empty.
    """

    version: int
    storage: str
    files: tuple[FileEntry, ...]
    topics: Mapping[str, int]
    messages: int
    start_ns: int
    duration_ns: int
    compression_mode: str = ""
    ros_distro: str = ""
    custom: Mapping[str, str] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the files."""
        return tuple(file.name for file in self.files)


def read_description(folder: Path) -> BagDescription | None:
    """Return what ``metadata.yaml`` in ``folder`` says; None without one.

    Raises BagError in one line for what cannot be understood.
    """
    path = folder / METADATA_FILE
    if not path.is_symlink() and not path.exists():
        return None
    try:
        text = read_text(path, largest=_LARGEST)
    except (OSError, UnicodeDecodeError) as error:
        raise BagError(f"{path} cannot be read: {cause_of(error)}") from error
    return parse_description(text, str(path))


def parse_description(text: str, source: str) -> BagDescription:
    """Return the content of the text of a ``metadata.yaml``; BagError names ``source``."""
    try:
        data = load_yaml(text, source, strict=False)
    except ConfigurationError as error:
        raise BagError(str(error)) from error
    if not isinstance(data, dict) or not isinstance(data.get(INFORMATION), dict):
        raise BagError(f"{source} is not a description of a bag: it has no group {INFORMATION}")
    try:
        return _description(data[INFORMATION])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        what = f"the entry {error} is missing" if isinstance(error, KeyError) else str(error)
        raise BagError(f"{source} is not as rosbag2 writes it: {what}") from error


def recorded_files(notes: Mapping[str, Mapping[str, str]]) -> tuple[FileEntry, ...]:
    """Return the files of the session up to this one, as our recorder noted them in it.

    The last one is the file itself, under the name that it was recorded with. Empty for files of
    other recorders, which note something else, and where the note is damaged.
    """
    text = notes.get(names.ROSBAG2, {}).get("serialized_metadata", "")
    if not text:
        return ()
    try:
        known = _description(load_yaml(text, names.ROSBAG2, strict=False))
    except (ConfigurationError, KeyError, TypeError, ValueError, AttributeError):
        return ()
    ours = (known.custom or {}).get(LIBRARY_KEY, "").startswith("rotcal_ros")
    return known.files if ours else ()


def _description(data: Mapping[str, Any]) -> BagDescription:
    version = _count(data["version"], "version")
    if not 1 <= version <= VERSION:
        raise ValueError(f"version {version}, expected 1 to {VERSION}")
    mode = str(data.get("compression_mode") or "").lower()
    custom = data.get("custom_data") or {}
    return BagDescription(
        version,
        str(data.get("storage_identifier", "")),
        _files(data),
        {
            str(topic["topic_metadata"]["name"]): _count(topic["message_count"], "message_count")
            for topic in data.get("topics_with_message_count") or ()
        },
        _count(data["message_count"], "message_count"),
        *_stated_span(data),
        "" if mode == "none" else mode,
        str(data.get("ros_distro") or ""),
        {str(key): str(value) for key, value in custom.items()},
    )


def _files(data: Mapping[str, Any]) -> tuple[FileEntry, ...]:
    known = {
        _name(entry["path"]): FileEntry(
            _name(entry["path"]),
            _count(entry["message_count"], "message_count"),
            *_stated_span(entry),
        )
        for entry in data.get("files") or ()
    }
    if not isinstance(data["relative_file_paths"], list):
        raise ValueError("relative_file_paths is not a list")
    listed = [_name(path) for path in data["relative_file_paths"]]
    return tuple(known.get(name, FileEntry(name)) for name in listed)


def _name(path: Any) -> str:
    """Return the name of a file; before version 4 the folder stood before it."""
    name = PurePosixPath(path).name if isinstance(path, str) else ""
    if name in ("", "..") or "\0" in name:
        raise ValueError(f"{path!r} does not name a file")
    return name


def _stated_span(data: Mapping[str, Any]) -> tuple[int, int]:
    """Return start and duration in ns."""
    start = _count(data["starting_time"]["nanoseconds_since_epoch"], "starting_time", -1)
    return start, _count(data["duration"]["nanoseconds"], "duration", -_LARGEST_COUNT)


def _count(value: Any, what: str, smallest: int = 0) -> int:
    whole = isinstance(value, int) and not isinstance(value, bool)
    if not whole or not smallest <= value <= _LARGEST_COUNT:
        raise ValueError(f"{what} is {value!r:.40}, expected a whole number from {smallest} on")
    return int(value)
