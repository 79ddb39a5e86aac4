"""Sqlite3 bags of all versions, and seeded ways to damage them."""

from __future__ import annotations

import random
import sqlite3
from collections.abc import Callable
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


def _flip(data: bytearray, chance: random.Random) -> bytearray:
    for _ in range(chance.choice((1, 1, 3, 30))):
        data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
    return data


def _flip_header(data: bytearray, chance: random.Random) -> bytearray:
    data[chance.randrange(100)] ^= 1 << chance.randrange(8)
    return data


def _flip_structure(data: bytearray, chance: random.Random) -> bytearray:
    page = chance.randrange(len(data) // PAGE) * PAGE
    data[page + chance.randrange(16)] ^= 1 << chance.randrange(8)
    return data


def _cut(data: bytearray, chance: random.Random) -> bytearray:
    return data[: chance.randrange(len(data))]


def _zero(data: bytearray, chance: random.Random) -> bytearray:
    count = chance.choice((1, 1, 2, 5, 20))
    begin = chance.randrange(len(data) // PAGE) * PAGE
    size = len(data[begin : begin + count * PAGE])
    data[begin : begin + size] = bytes(size)
    return data


def _garbage(data: bytearray, chance: random.Random) -> bytearray:
    size = chance.choice((4, 40, 400, 4000))
    begin = chance.randrange(len(data) - size)
    data[begin : begin + size] = chance.randbytes(size)
    return data


def _header(data: bytearray, chance: random.Random) -> bytearray:
    size = chance.choice((16, 100, PAGE))
    data[:size] = chance.choice((bytes(size), chance.randbytes(size)))
    return data


def _page_size(data: bytearray, chance: random.Random) -> bytearray:
    data[16:18] = chance.choice((512, 2048, 4096, 1, 0, 77)).to_bytes(2, "big")
    return data


def _swap(data: bytearray, chance: random.Random) -> bytearray:
    one, other = (chance.randrange(len(data) // PAGE) * PAGE for _ in range(2))
    first = data[one : one + PAGE]
    data[one : one + PAGE] = data[other : other + PAGE]
    data[other : other + PAGE] = first
    return data


def _encrypted(data: bytearray, chance: random.Random) -> bytearray:
    return bytearray(a ^ b for a, b in zip(data, chance.randbytes(len(data)), strict=True))


def _append(data: bytearray, chance: random.Random) -> bytearray:
    return data + chance.randbytes(chance.choice((1, 100, 5 * PAGE)))


BYTES: tuple[Callable[[bytearray, random.Random], bytearray], ...] = (
    _flip, _flip_header, _flip_structure, _cut, _zero, _garbage, _header, _page_size, _swap,
    _encrypted, _append,
)  # fmt: skip

STATEMENTS = (
    "DROP TABLE messages", "DROP TABLE topics", "DROP TABLE message_definitions",
    "DROP TABLE schema", "DROP TABLE metadata", "DROP INDEX timestamp_idx",
    "ALTER TABLE topics DROP COLUMN type", "ALTER TABLE topics DROP COLUMN offered_qos_profiles",
    "ALTER TABLE messages RENAME COLUMN data TO content",
    "ALTER TABLE messages ADD COLUMN extra TEXT DEFAULT 'x'",
    "ALTER TABLE topics ADD COLUMN extra", "DELETE FROM topics", "DELETE FROM messages",
    "DELETE FROM topics WHERE id = 1", "DELETE FROM message_definitions WHERE id = 1",
    "UPDATE message_definitions SET encoding = 'unknown'",
    "UPDATE message_definitions SET encoded_message_definition = 'float64[ x'",
    "UPDATE message_definitions SET encoding = x'ff'",
    "UPDATE messages SET data = CAST(data AS TEXT) WHERE id % 3 = 0",
    "UPDATE messages SET data = 'text' WHERE id = 5", "UPDATE messages SET data = 7 WHERE id = 5",
    "UPDATE messages SET data = x'' WHERE id = 5", "UPDATE messages SET timestamp = -id",
    "UPDATE messages SET timestamp = 9223372036854775807 WHERE id = 9",
    "UPDATE messages SET timestamp = 1e300 WHERE id = 9",
    "UPDATE messages SET timestamp = 'noon' WHERE id = 9",
    "UPDATE messages SET topic_id = 77 WHERE id % 5 = 0",
    "UPDATE messages SET topic_id = 'one' WHERE id = 4",
    "UPDATE messages SET topic_id = -9223372036854775808 WHERE id = 4",
    "UPDATE messages SET id = 9223372036854775807 WHERE id = 4",
    "UPDATE messages SET id = -9223372036854775808 WHERE id = 4",
    "UPDATE topics SET name = CAST(x'2f63656c6cff' AS TEXT)", "UPDATE topics SET name = ''",
    "UPDATE topics SET name = x'2f00ff'", "UPDATE topics SET name = 7",
    "UPDATE topics SET type = 'no type at all'", "UPDATE topics SET type = ''",
    "UPDATE topics SET offered_qos_profiles = '{[: not yaml'",
    "UPDATE topics SET offered_qos_profiles = 5", "UPDATE topics SET id = id + 99999999",
    "UPDATE topics SET serialization_format = 'cbor'", "UPDATE topics SET name = '/same'",
    "UPDATE schema SET schema_version = 99", "DELETE FROM schema",
    "UPDATE topics SET type_description_hash = x'00'",
    "ALTER TABLE messages RENAME TO m; CREATE VIEW messages AS WITH RECURSIVE n(i) AS (SELECT 1"
    " UNION ALL SELECT i + 1 FROM n WHERE i < 1000)"
    " SELECT i AS id, 1 AS topic_id, i AS timestamp, x'00' AS data"
    " FROM n",
    "ALTER TABLE messages RENAME TO m; CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id,"
    " timestamp, data GENERATED ALWAYS AS (zeroblob(50000000)));"
    "INSERT INTO messages(topic_id, timestamp) SELECT topic_id, timestamp FROM m LIMIT 3;"
    "DROP TABLE m",
    "ALTER TABLE messages RENAME TO m; CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id,"
    " timestamp, data); INSERT INTO messages SELECT * FROM m; DROP TABLE m;"
    "UPDATE messages SET data = NULL WHERE id % 4 = 0; UPDATE messages SET timestamp = NULL"
    " WHERE id % 7 = 0; UPDATE messages SET topic_id = NULL WHERE id % 9 = 0",
    "ALTER TABLE messages RENAME TO m; CREATE TABLE messages(id INT PRIMARY KEY, topic_id,"
    " timestamp, data) WITHOUT ROWID; INSERT INTO messages SELECT * FROM m; DROP TABLE m",
    "CREATE TRIGGER t AFTER INSERT ON messages BEGIN DELETE FROM topics; END",
    "UPDATE topics SET name = replace(hex(zeroblob(100000)), '00', 'a')",
)  # fmt: skip
"""Statements that make a sound database of something that is no sound bag, or hardly one."""


def mutate(path: Path, sound: bytes, seed: int) -> str:
    """Write a damaged copy of a bag to ``path``; return what was done to it."""
    chance = random.Random(seed)
    for file in (path, *(Path(f"{path}{end}") for end in ("-wal", "-journal"))):
        file.unlink(missing_ok=True)
    kind = chance.random()
    if kind < 0.6:
        damage = chance.choice(BYTES)
        path.write_bytes(damage(bytearray(sound), chance))
        return damage.__name__
    path.write_bytes(sound)
    statement = STATEMENTS[seed % len(STATEMENTS)]
    if kind < 0.9:
        with closing(sqlite3.connect(path)) as database:
            database.executescript(f"PRAGMA writable_schema = ON; {statement}")
        return statement
    end = chance.choice(("-wal", "-journal"))
    Path(f"{path}{end}").write_bytes(chance.randbytes(chance.choice((1, 32, 4000))))
    return f"garbage in {end}"
