"""Harm to bags that knows their form: records and chunks of MCAP, pages and cells of SQLite.

Lengths and checksums are put right again behind most changes, so that the harm gets past them.
"""

from __future__ import annotations

import contextlib
import io
import sqlite3
import struct
import tempfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Final

import lz4.frame
import zstandard
from mcap.writer import CompressionType, Writer
from mutations import EDGES, harmed_bytes

DATA: Final = Path(__file__).parents[2] / "examples" / "data"
MAGIC: Final = b"\x89MCAP0\r\n"
CHUNK: Final = 0x06
MESSAGE_INDEX: Final = 0x07
DATA_END: Final = 0x0F
FOOTER: Final = 0x02
SUMMARY: Final = (0x08, 0x0B, 0x0D, 0x0E)
"""Opcodes that a summary begins with, behind repeated schemas and channels."""
START_NS: Final = 1_700_000_000_000_000_000
Record = tuple[int, bytes]


def mcap_seeds() -> Iterator[bytes]:
    """Yield small sound files: with and without chunks, compression, indexes, attachments."""
    for kind in (CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD):
        yield _written(compression=kind, chunk_size=256)
    yield _written(use_chunking=False)
    yield _written(use_summary_offsets=False, use_statistics=False, chunk_size=1 << 20)


def _written(**options: object) -> bytes:
    stream = io.BytesIO()
    writer = Writer(stream, **options)  # type: ignore[arg-type]
    writer.start("ros2", "fuzz")
    text = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
    empty = writer.register_schema("std_msgs/msg/Empty", "ros2msg", b"")
    json = writer.register_schema("Reading", "jsonschema", b'{"type": "object"}')
    channels = [
        writer.register_channel("/chatter", "cdr", text),
        writer.register_channel("/tick", "cdr", empty),
        writer.register_channel("/reading", "json", json),
    ]
    cdr = b"\0\1\0\0"
    bodies = (cdr + struct.pack("<I", 6) + b"hello\0", cdr + b"\0", b'{"value": 1.5}')
    for k in range(12):
        at = START_NS + 1_000_000 * k
        writer.add_message(channels[k % 3], at, bodies[k % 3], at, k)
    writer.add_attachment(START_NS, START_NS, "configuration.yaml", "text/yaml", b"/**: {}\n")
    writer.add_metadata("rosbag2", {"storage": "mcap"})
    writer.finish()
    return stream.getvalue()


def harmed_mcap(rng: Random, data: bytes) -> bytes:
    """Return a file with harm to its records, or to its bytes where it has none."""
    records = list(_records(data[8:-8]))
    if rng.random() < 0.15 or not records:
        return harmed_bytes(rng, data)
    if rng.random() < 0.4:
        records = _without_index(records)
    for _ in range(rng.randint(1, 3)):
        _harm_records(rng, records)
    body = b"".join(map(_framed, records))
    if rng.random() < 0.7:
        body = _with_footer(records)
    whole = MAGIC + body + MAGIC
    return whole[: rng.randrange(len(whole))] if rng.random() < 0.1 else whole


def _records(data: bytes) -> Iterator[Record]:
    place = 0
    while place + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, place)
        if place + 9 + length > len(data):
            return
        yield opcode, data[place + 9 : place + 9 + length]
        place += 9 + length


def _without_index(records: list[Record]) -> list[Record]:
    """Return the records of the data, which no index contradicts, and an end."""
    opcodes = [opcode for opcode, _ in records]
    data = records[: opcodes.index(DATA_END)] if DATA_END in opcodes else records
    kept = [record for record in data if record[0] not in (MESSAGE_INDEX, FOOTER)]
    return [*kept, (DATA_END, bytes(4)), (FOOTER, bytes(20))]


def _framed(record: Record) -> bytes:
    return struct.pack("<BQ", record[0], len(record[1])) + record[1]


def _harm_records(rng: Random, records: list[Record]) -> None:
    k = rng.randrange(len(records))
    opcode, content = records[k]
    how = rng.randrange(9)
    if how == 0:
        del records[k]
        records[:] = records or [(opcode, content)]
    elif how == 1:
        records.insert(rng.randrange(len(records) + 1), (opcode, content))
    elif how == 2:
        other = rng.randrange(len(records))
        records[k], records[other] = records[other], records[k]
    elif how == 3:  # readers ignore what they do not know at the end of a record
        records[k] = (opcode, content + rng.randbytes(rng.randint(1, 9)))
    elif how == 4:
        records[k] = (rng.choice((0, 1, 3, 4, 5, 7, 10, 15, 16, 127, 128, 255)), content)
    elif opcode == CHUNK and how <= 7:
        records[k] = (CHUNK, _harmed_chunk(rng, content))
    else:
        records[k] = (opcode, _harmed_fields(rng, content))


def _harmed_fields(rng: Random, content: bytes) -> bytes:
    """Put a number of the kind that goes wrong somewhere, or harm single bytes."""
    if rng.random() < 0.5 or len(content) < 8:
        return harmed_bytes(rng, content)
    form = rng.choice(("<H", "<I", "<Q"))
    size = struct.calcsize(form)
    at = rng.randrange(min(len(content), 48) - size + 1)
    value = rng.choice(EDGES) & ((1 << 8 * size) - 1)
    return content[:at] + struct.pack(form, value) + content[at + size :]


def _harmed_chunk(rng: Random, content: bytes) -> bytes:
    """Harm the records inside of a chunk; its sizes and its checksum fit again, mostly."""
    try:
        start, end, _size, _crc, length = struct.unpack_from("<QQQII", content)
        compression = content[32 : 32 + length].decode()
        inside = list(_records(_unpacked(compression, content[40 + length :])))
    except (struct.error, ValueError, RuntimeError, zstandard.ZstdError):
        return harmed_bytes(rng, content)
    if inside:
        _harm_records(rng, inside)
    data = b"".join(map(_framed, inside))
    if rng.random() < 0.05:
        data = bytes(rng.choice((1 << 16, 1 << 22)))
    kind = rng.choice((compression, compression, "", "lz4", "zstd", "brotli"))
    size = len(data) if rng.random() < 0.85 else rng.choice(EDGES)
    crc = zlib.crc32(data) if rng.random() < 0.8 else rng.choice((0, 1))
    packed = _packed(kind, data)
    head = struct.pack("<QQQII", start, end, size, crc, len(kind)) + kind.encode()
    return head + struct.pack("<Q", len(packed)) + packed


def _unpacked(kind: str, data: bytes) -> bytes:
    if kind == "zstd":
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=1 << 24)
    return bytes(lz4.frame.decompress(data)) if kind == "lz4" else data


def _packed(kind: str, data: bytes) -> bytes:
    if kind == "zstd":
        return zstandard.ZstdCompressor().compress(data)
    return bytes(lz4.frame.compress(data)) if kind == "lz4" else data


def _with_footer(records: list[Record]) -> bytes:
    """Return the records with a footer that points at its summary, whose checksum fits."""
    body, starts = b"", []
    for record in records:
        starts.append(len(MAGIC) + len(body))
        if record[0] == FOOTER:
            begins = [at for at, r in zip(starts, records, strict=False) if r[0] in SUMMARY]
            summary = min(begins, default=0)
            part = (MAGIC + body)[summary:] if summary else b""
            head = struct.pack("<BQQQ", FOOTER, 20, summary, 0)
            body += head + struct.pack("<I", zlib.crc32(part + head))
        else:
            body += _framed(record)
    return body


def sqlite_seeds() -> Iterator[bytes]:
    """Yield small bags of rosbag2's SQLite storage: of version 3, 4 and with many pages."""
    for version, rows in ((3, 12), (4, 12), (4, 400)):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "seed.db3"
            _fill(path, version, rows)
            yield path.read_bytes()


def _fill(path: Path, version: int, rows: int) -> None:
    connection = sqlite3.connect(path)
    extra = ", type_description_hash TEXT NOT NULL" if version >= 4 else ""
    connection.executescript(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, "
        f"serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL{extra});"
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp "
        "INTEGER NOT NULL, data BLOB NOT NULL); CREATE INDEX timestamp_idx ON messages"
        "(timestamp ASC); CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro "
        f"TEXT NOT NULL); INSERT INTO schema VALUES ({version}, 'jazzy');"
    )
    if version >= 4:
        connection.execute(
            "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, "
            "encoding TEXT NOT NULL, encoded_message_definition TEXT NOT NULL, "
            "type_description_hash TEXT NOT NULL)"
        )
        connection.execute(
            "INSERT INTO message_definitions VALUES (1, 'std_msgs/msg/String', 'ros2msg', "
            "'string data', 'RIHS01_0')"
        )
    topic = (1, "/chatter", "std_msgs/msg/String", "cdr", "", "RIHS01_0")[: 5 + (version >= 4)]
    connection.execute(f"INSERT INTO topics VALUES ({','.join('?' * len(topic))})", topic)
    body = b"\0\1\0\0" + struct.pack("<I", 6) + b"hello\0"
    connection.executemany(
        "INSERT INTO messages VALUES (?, 1, ?, ?)",
        [(k + 1, START_NS + 1_000_000 * k, body) for k in range(rows)],
    )
    connection.commit()
    connection.close()


def harmed_sqlite(rng: Random, data: bytes) -> bytes:
    """Return a database with harm to values, to a page's head and cells, or to single bytes."""
    how = rng.random()
    if how < 0.35:
        return _harmed_values(rng, data)
    if how < 0.5 or len(data) < 4096:
        return harmed_bytes(rng, data)
    harmed = bytearray(data)
    size = int.from_bytes(data[16:18], "big") or 4096
    for _ in range(rng.randint(1, 3)):
        page = rng.randrange(max(len(data) // size, 1)) * size
        head = page + (100 if page == 0 else 0)
        at = head + rng.randrange(min(64, size - 100)) if rng.random() < 0.7 else page
        harmed[at : at + 2] = rng.choice((b"\0\0", b"\xff\xff", b"\x05\x0d", rng.randbytes(2)))
    return bytes(harmed[: len(data)])


_STATEMENTS: Final = (
    "UPDATE messages SET data = ? WHERE id % 3 = 0",
    "UPDATE messages SET timestamp = ? WHERE id % 3 = 0",
    "UPDATE messages SET topic_id = ?",
    "UPDATE topics SET name = ?",
    "UPDATE topics SET type = ?",
    "UPDATE topics SET serialization_format = ?",
    "UPDATE topics SET offered_qos_profiles = ?",
    "UPDATE message_definitions SET encoded_message_definition = ?",
    "UPDATE message_definitions SET encoding = ?",
    "UPDATE schema SET schema_version = ?",
    "DELETE FROM messages WHERE ?",
    "DELETE FROM topics WHERE ?",
)
_SCHEMA: Final = (
    "DROP TABLE schema", "DROP TABLE topics", "DROP TABLE messages", "DROP INDEX timestamp_idx",
    "ALTER TABLE messages ADD COLUMN more TEXT", "CREATE VIEW v AS SELECT 1",
    "PRAGMA user_version = 7", "ALTER TABLE topics DROP COLUMN type",
    "ALTER TABLE messages RENAME COLUMN data TO content",
    "ALTER TABLE messages RENAME TO m; CREATE VIEW messages AS SELECT * FROM m",
    "ALTER TABLE messages RENAME TO m; CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id,"
    " timestamp, data GENERATED ALWAYS AS (zeroblob(50000000)));"
    "INSERT INTO messages(topic_id, timestamp) SELECT topic_id, timestamp FROM m LIMIT 3",
    "ALTER TABLE messages RENAME TO m; CREATE TABLE messages(id INT PRIMARY KEY, topic_id,"
    " timestamp, data) WITHOUT ROWID; INSERT INTO messages SELECT * FROM m; DROP TABLE m",
    "CREATE TRIGGER t AFTER INSERT ON messages BEGIN DELETE FROM topics; END",
    "UPDATE messages SET id = 9223372036854775807 WHERE id = 4",
    "UPDATE messages SET id = -9223372036854775808 WHERE id = 4",
)  # fmt: skip
_CELLS: Final = (None, 0, -1, 1 << 62, -(1 << 63), 1.5, float("inf"), "", "text", "\x00", b"",
                 b"\xff" * 9, b"\0\1\0\0", "string data\n" * 50, "std_msgs/msg/String",
                 "a\x1b[31m\nb", "- history: [&a [*a]]", "= = =\nMSG: x/y\n")  # fmt: skip


def _harmed_values(rng: Random, data: bytes) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "harmed.db3"
        path.write_bytes(data)
        connection = sqlite3.connect(path)
        for _ in range(rng.randint(1, 3)):
            statement = rng.choice(_STATEMENTS)
            try:
                if rng.random() < 0.2:
                    connection.executescript(rng.choice(_SCHEMA))
                elif rng.random() < 0.2:  # bytes that are no text, in the place of one
                    invalid = statement.replace("?", "CAST(x'ff80' AS TEXT)")
                    connection.execute(invalid)
                else:
                    connection.execute(statement, (rng.choice(_CELLS),))
            except (sqlite3.Error, OverflowError):
                continue
        with contextlib.suppress(sqlite3.Error):
            connection.commit()
        connection.close()
        return path.read_bytes()
