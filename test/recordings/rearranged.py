"""One simulated run as other programs would leave it: their order, channels, times and chunks.

Written by mcap's own writer, so that nothing of the suite's recorder is in it.
"""

from __future__ import annotations

import functools
import sqlite3
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from bag_samples import CONFIGURATION, START_NS, STORE, TYPES, encode, simulate
from mcap.writer import CompressionType, Writer

from rotcal_ros.bags import names
from rotcal_ros.foundation.observations import Command, Observation

SECOND = 1_000_000_000


@dataclass(frozen=True)
class Kept:
    """A message in a file; ``channel`` distinguishes channels of one topic."""

    topic: str
    type_name: str
    data: bytes
    log_ns: int
    publish_ns: int
    sequence: int = 0
    channel: int = 0


@functools.cache
def run_messages() -> tuple[Kept, ...]:
    """Return the messages of a run of 32 lengths, logged 2 ms after they were taken."""
    now, kept = START_NS, []
    counts: dict[str, int] = {}
    for record in simulate().records:
        if not isinstance(record, Command | Observation):
            now = max(now, record.stamp_ns)
        for role, data in encode(record):
            if isinstance(record, Command):  # the sample orders bear no time of their own
                data = data[:4] + _stamp(now) + data[12:]
            counts[role] = counts.get(role, 0) + 1
            kept.append(
                Kept(f"/cell/{role}", TYPES[role], data, now + 2_000_000, now, counts[role])
            )
    return tuple(kept)


def _stamp(time_ns: int) -> bytes:
    seconds, rest = divmod(time_ns, SECOND)
    return seconds.to_bytes(4, "little") + rest.to_bytes(4, "little")


def stamped(message: Kept, time_ns: int) -> Kept:
    """Return a message that was taken and sent at another time."""
    data = message.data[:4] + _stamp(time_ns) + message.data[12:]
    return replace(message, data=data, publish_ns=time_ns)


def by_topic(messages: Iterable[Kept]) -> list[Kept]:
    """Return the messages topic by topic, each in its order: what many converters write."""
    return sorted(messages, key=lambda m: m.topic)


def changed(messages: Iterable[Kept], change: Callable[[int, Kept], dict[str, int]]) -> list[Kept]:
    """Return the messages with other fields, which may depend on their place."""
    return [replace(m, **change(n, m)) for n, m in enumerate(messages)]


def definition_of(type_name: str) -> str:
    return str(STORE.generate_msgdef(type_name, ros_version=2)[0])


def write_mcap(
    path: Path,
    messages: Iterable[Kept],
    *,
    chunk_size: int = 1 << 20,
    definition: Callable[[str], str] = definition_of,
    configuration: str = CONFIGURATION,
) -> Path:
    """Write a bag of one file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD, chunk_size=chunk_size)
        writer.start(profile="ros2", library="a converter")
        if configuration:
            text = configuration.encode()
            writer.add_attachment(0, 0, names.CONFIGURATION, "application/yaml", text)
        schemas: dict[str, int] = {}
        channels: dict[tuple[str, int], int] = {}
        for m in messages:
            if m.type_name not in schemas:
                schemas[m.type_name] = writer.register_schema(
                    m.type_name, "ros2msg", definition(m.type_name).encode()
                )
            key = (m.topic, m.channel)
            if key not in channels:
                channels[key] = writer.register_channel(m.topic, "cdr", schemas[m.type_name])
            writer.add_message(channels[key], m.log_ns, m.data, m.publish_ns, m.sequence)
        writer.finish()
    return path


def write_sqlite(path: Path, messages: Iterable[Kept]) -> Path:
    """Write a bag of one file as rosbag2 of Jazzy does."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with sqlite3.connect(path) as base:
        base.executescript(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
            " serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL,"
            " type_description_hash TEXT NOT NULL);"
            "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL,"
            " encoding TEXT NOT NULL, encoded_message_definition TEXT NOT NULL,"
            " type_description_hash TEXT NOT NULL);"
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,"
            " timestamp INTEGER NOT NULL, data BLOB NOT NULL);"
        )
        ids: dict[tuple[str, int], int] = {}
        types: set[str] = set()
        for m in messages:
            if m.type_name not in types:
                types.add(m.type_name)
                base.execute(
                    "INSERT INTO message_definitions VALUES (NULL, ?, 'ros2msg', ?, '')",
                    (m.type_name, definition_of(m.type_name)),
                )
            key = (m.topic, m.channel)
            if key not in ids:
                ids[key] = len(ids) + 1
                base.execute(
                    "INSERT INTO topics VALUES (?, ?, ?, 'cdr', '', '')",
                    (ids[key], m.topic, m.type_name),
                )
            base.execute(
                "INSERT INTO messages VALUES (NULL, ?, ?, ?)", (ids[key], m.log_ns, m.data)
            )
    base.close()
    return path
