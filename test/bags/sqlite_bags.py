"""Sqlite3 bags as each version of rosbag2 writes them."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

from bag_samples import START_NS, STORE, TYPES, serialised

from rotcal_ros.bags import names

PAGE = 1024
TOPICS = ((1, f"/cell/{names.TRACER_LENGTH}", TYPES[names.TRACER_LENGTH]),
          (2, f"/cell/{names.TEMPERATURE}", TYPES[names.TEMPERATURE]))  # fmt: skip
TEMPERATURE_EVERY = 10
_TIMES = "".join(
    f"  {name}: {{sec: 9223372036, nsec: 854775807}}\n"
    for name in ("deadline", "lifespan", "liveliness_lease_duration")
)
_NUMBERS = "- history: 1\n  depth: 10\n  reliability: 1\n  durability: 2\n  liveliness: 1\n"
_WORDS = (
    "- history: keep_last\n  depth: 10\n  reliability: reliable\n  durability: volatile\n"
    "  liveliness: automatic\n"
)
_LAST = f"{_TIMES}  avoid_ros_namespace_conventions: false\n"
QOS = {2: _NUMBERS + _LAST, 3: _NUMBERS + _LAST, 4: _WORDS + _LAST}
"""The quality of service as each version writes it."""


def payloads(count: int) -> list[bytes]:
    """Return messages, some of which do not fit on one page."""
    found = []
    for number in range(count):
        stamp_ns = START_NS + number
        if number % TEMPERATURE_EVERY == 0:
            frame = "sensor" * (1 + number % 7 * 60)
            found.append(
                serialised(
                    TYPES[names.TEMPERATURE], stamp_ns=stamp_ns, frame_id=frame, temperature=20.0,
                    variance=0.0,
                )
            )  # fmt: skip
        else:
            found.append(
                serialised(
                    TYPES[names.TRACER_LENGTH], stamp_ns=stamp_ns, sequence=number, length=0.1,
                    length_std=1e-7, status=1,
                )
            )  # fmt: skip
    return found


def write_bag(path: Path, messages: list[bytes], version: int = 4, page: int = PAGE) -> None:
    """Write a bag as rosbag2 does in ``version`` of its schema."""
    columns = "id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, "
    columns += "serialization_format TEXT NOT NULL"
    columns += ", offered_qos_profiles TEXT NOT NULL" * (version >= 2)
    columns += ", type_description_hash TEXT NOT NULL" * (version >= 4)
    script = [f"PRAGMA page_size = {page}; BEGIN; CREATE TABLE topics({columns});"]
    if version >= 3:
        script.append(
            "CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);"
            "CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL,"
            " metadata TEXT NOT NULL);"
            f"INSERT INTO schema VALUES({version}, 'kilted');"
        )
    if version >= 4:
        script.append(
            "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL,"
            " encoding TEXT NOT NULL, encoded_message_definition TEXT NOT NULL,"
            " type_description_hash TEXT NOT NULL);"
        )
    script.append(
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,"
        " timestamp INTEGER NOT NULL, data BLOB NOT NULL);"
        "CREATE INDEX timestamp_idx ON messages (timestamp ASC);"
    )
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.executescript("".join(script))
        for number, name, type_name in TOPICS:
            row = [number, name, type_name, "cdr"]
            row += [QOS[version]] if version >= 2 else []
            row += [STORE.hash_rihs01(type_name)] if version >= 4 else []
            database.execute(f"INSERT INTO topics VALUES({','.join('?' * len(row))})", row)
            if version >= 4:
                database.execute(
                    "INSERT INTO message_definitions VALUES(?, ?, 'ros2msg', ?, ?)",
                    (
                        number,
                        type_name,
                        STORE.generate_msgdef(type_name, ros_version=2)[0],
                        row[-1],
                    ),
                )
        database.executemany(
            "INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)",
            [
                (2 if number % TEMPERATURE_EVERY == 0 else 1, START_NS + number, data)
                for number, data in enumerate(messages)
            ],
        )
        database.execute("COMMIT")
