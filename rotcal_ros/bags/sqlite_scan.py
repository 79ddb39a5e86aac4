"""Reading a rosbag2 sqlite3 file of any version, in the same blocks as an MCAP file.

The topics of a rosbag2 sqlite3 file with their definitions, in all versions of its schema.

Version 1 knows names and types, 2 adds the quality of service, 3 the table ``schema``, 4 hashes
of types and the table ``message_definitions``.
"""

from __future__ import annotations

import re
import sqlite3
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from rotcal_ros.bags.blocks import HEADER_TYPE, Block
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.message_compression import (
    Unpack,
    declared_compression,
    decompressor,
    looks_packed,
    stated_compression,
    unpacked,
)
from rotcal_ros.bags.reading_limits import DEFAULT_LIMITS, LARGEST_MESSAGE, ReadingLimits
from rotcal_ros.bags.sqlite_file import FAILURES, Database, opened, text, words
from rotcal_ros.bags.sqlite_salvage import salvaged
from rotcal_ros.bags.storage_scan import Scan
from rotcal_ros.bags.verdict import Damage, FileVerdict, TopicCount
from rotcal_ros.foundation.errors import BagError

_BLOCK_BYTES: Final = 1 << 20
_MAX_CHANNELS: Final = 1 << 16
_LEAST_ROW: Final = 16
_NEEDED: Final = {"topics": ("id", "name", "type"), "messages": ("topic_id", "timestamp", "data")}
_UNKNOWN: Final = "(unknown topic)"
_NAMELESS: Final = "/unknown_topic_"
_NO_TYPE: Final = "unknown/msg/Unknown"


class SqliteScan(Scan):
    """One pass over a sqlite3 file.

    Whether it is sound says sqlite3's own integrity check. It has no checksums: a changed byte
    within a message is not noticed.
    """

    def __init__(self, path: Path, limits: ReadingLimits = DEFAULT_LIMITS) -> None:
        super().__init__(path)
        self._limits = limits
        self._size = 0
        self._plain_size = 0
        self._damages: list[Damage] = []
        self._numbers: dict[int, int] = {}  # channel id by the topic's id in the database
        self._lost: Counter[int] = Counter()
        self._unreadable = 0
        self._oddities: Counter[str] = Counter()
        self._unpack: Unpack | None = None

    def blocks(self) -> Iterator[Block]:
        """Yield the messages in the order of their log times."""
        with opened(self.path, self._limits) as database:
            self._size = self.path.stat().st_size
            self._plain_size = database.file.stat().st_size
            self._damages += database.damages()
            if not self._damages:
                self._require_tables(database)
                if count := topics_without_text(database):
                    self._oddities["topics of which something is no text in UTF-8"] = count
                yield from self._read(database)
                return
            with salvaged(database) as rescued:
                yield from self._read(rescued)
                self._missing_rows(rescued)
        if not self._counts and not self.channels:
            raise BagError(
                f"cannot read {self.path}: {self._damages[0].what}; no page of it holds a row of "
                "a bag (is it encrypted, or something else than a rosbag2 sqlite3 file?)"
            )

    def verdict(self) -> FileVerdict:
        """Return the verdict on the file, after the iteration."""
        odd = [Damage(0, f"{count} {what}") for what, count in self._oddities.items()]
        damages = sorted((*self._damages, *odd), key=lambda damage: damage.offset)
        topics = self._topics(self._lost)
        if self._unreadable:
            topics[_UNKNOWN] = TopicCount("", 0, self._unreadable)
        start_ns, end_ns = self._span or (None, None)
        return FileVerdict(
            path=self.path,
            size=self._size,
            state="damaged" if damages else "complete",
            damages=tuple(damages),
            topics=topics,
            start_ns=start_ns,
            end_ns=end_ns,
            lost_exactly=not self._damages,
            dropouts=tuple(self._dropouts.found),
        )

    def _require_tables(self, database: Database) -> None:
        """Refuse a sound database that is no bag."""
        for table, needed in _NEEDED.items():
            missing = [name for name in needed if name not in database.columns(table)]
            if missing:
                raise BagError(
                    f"{self.path} is no bag of rosbag2: its database has no table {table} with "
                    f"the columns {', '.join(missing)}"
                )

    def _read(self, database: Database) -> Iterator[Block]:
        for number, (topic_id, channel) in enumerate(read_channels(database)):
            if number >= _MAX_CHANNELS:
                self._oddities[f"topics or more, {_MAX_CHANNELS} are read"] = number
                break
            self._numbers[topic_id] = number
            self.channels[number] = replace(channel, channel_id=number)
        try:
            self._unpack = decompressor(*self._compression(database))
        except BagError as error:
            raise BagError(f"cannot read {self.path}: {error}") from None
        for block in self._batches(database):
            yield from self._plain(block)

    def _compression(self, database: Database) -> tuple[str, str]:
        """Return mode and format of the messages' compression; the file's own word counts."""
        stated = ("", "")
        if "metadata" in database.columns("metadata"):
            for (text,) in database.connection.execute("SELECT metadata FROM metadata"):
                stated = stated_compression(text) if isinstance(text, bytes) else stated
        return stated if stated[0] else declared_compression(self.path)

    def _batches(self, database: Database) -> Iterator[Block]:
        batch: list[tuple[int, int, bytes]] = []
        size, room = 0, 4 * self._plain_size + LARGEST_MESSAGE
        try:
            key = "id" if "id" in database.columns("messages") else "rowid"
            odd = database.connection.execute(_ODD_TIMES).fetchone() is not None
            by = "CAST(timestamp AS INTEGER)" if odd else "timestamp"
            for row in database.connection.execute(f"{_MESSAGES}{by}, {key}"):
                if (message := self._understood(*row)) is None:
                    continue
                batch.append(message)
                size += len(message[2])
                if size >= _BLOCK_BYTES:
                    self.position = min(self._size, self.position + size)
                    room -= size
                    yield _block(batch)
                    batch, size = [], 0
                if room < 0:
                    raise sqlite3.DatabaseError("it holds more than its size allows")
        except FAILURES as error:
            self._damages.append(Damage(0, f"the database cannot be read further: {words(error)}"))
        if batch:
            yield _block(batch)

    def _understood(
        self, topic_id: object, time_ns: object, data: object, size: object
    ) -> tuple[int, int, bytes] | None:
        """Return channel, log time and message of a row; what is wrong with it is counted."""
        number = self._numbers.get(topic_id) if isinstance(topic_id, int) else None
        if number is None and isinstance(topic_id, int):
            number = self._nameless(topic_id)
        if number is None:
            self._oddities["messages of no topic"] += 1
            self._unreadable += 1
            return None
        if not isinstance(time_ns, int) and (time_ns := _whole(time_ns)) is not None:
            self._oddities["messages whose time is a text or a fraction, read as a whole one"] += 1
        if not isinstance(time_ns, int) or not isinstance(data, bytes):
            large = size and not isinstance(data, bytes)
            what = "whose size is out of range" if large else "without content or time"
            self._oddities[f"messages {what}"] += 1
            self._lost[number] += 1
            return None
        if time_ns < 0:
            self._oddities["messages with a time before 1970, read as 1970"] += 1
        return number, max(0, time_ns), data

    def _nameless(self, topic_id: int) -> int | None:
        """Return a new channel for a topic whose row is missing; None when there are too many."""
        number = len(self.channels)
        if number >= _MAX_CHANNELS:
            return None
        self._numbers[topic_id] = number
        name = f"{_NAMELESS}{topic_id}".replace("-", "minus_")
        self.channels[number] = ChannelDefinition(number, name, _NO_TYPE, "", "")
        self._oddities["topics without name and type; their messages are kept as they are"] += 1
        return number

    def _plain(self, block: Block) -> Iterator[Block]:
        """Count and yield the messages of ``block`` as they were published."""
        if self._unpack is None and looks_packed(block.payload(0)):
            self._unpack = decompressor("message", "zstd")
        broken = Counter[int]()
        for plain in (block,) if self._unpack is None else unpacked(block, self._unpack, broken):
            self._count(plain)
            yield plain
        if broken:
            self._lost += broken
            self._oddities["compressed messages that cannot be unpacked"] += broken.total()

    def _missing_rows(self, rescued: Database) -> None:
        """Count the ids that are missing: rosbag2 gives them one after the other."""
        query = "SELECT count(*), min(id), max(id) FROM messages"
        count, first, last = rescued.connection.execute(query).fetchone()
        if count and first >= 1 and last <= count + self._plain_size // _LEAST_ROW:
            self._unreadable += last - count


_MESSAGES: Final = (
    "SELECT topic_id, timestamp,"
    f" CASE WHEN length(data) <= {LARGEST_MESSAGE} THEN data END, length(data)"
    " FROM messages ORDER BY "
)
_ODD_TIMES: Final = "SELECT 1 FROM messages WHERE typeof(timestamp) != 'integer' LIMIT 1"
_TIME: Final = re.compile(rb"\s*([+-]?[0-9]{1,19})(\.[0-9]*)?([eE][+-]?[0-9]{1,3})?\s*")
_LARGEST_TIME: Final = float(1 << 62)


def _whole(time_ns: object) -> int | None:
    """Return a time that stands there as a text or a fraction; None for what is none."""
    found = _TIME.fullmatch(time_ns) if isinstance(time_ns, bytes) else None
    if found is not None:  # a double does not hold all digits of a time of today
        time_ns = float(found[0]) if found[3] else int(found[1])
    if isinstance(time_ns, float | int) and abs(time_ns) < _LARGEST_TIME:
        return int(time_ns)
    return None


def _block(batch: list[tuple[int, int, bytes]]) -> Block:
    sizes = np.array([len(data) for _, _, data in batch], np.int64)
    headers = np.zeros(len(batch), HEADER_TYPE)
    headers["channel"] = [number for number, _, _ in batch]
    headers["log_time"] = headers["publish_time"] = [time_ns for _, time_ns, _ in batch]
    content = b"".join(data for _, _, data in batch)
    return Block(content, np.cumsum(sizes) - sizes, sizes, headers)


_TOPIC: Final = (
    "id", "name", "type", "type_description_hash", "offered_qos_profiles", "serialization_format",
)  # fmt: skip
_DEFINITION: Final = (
    "topic_type", "type_description_hash", "encoding", "encoded_message_definition",
)  # fmt: skip
_ENCODINGS: Final = ("ros2msg", "ros2idl")
_CDR: Final = "cdr"
_TEXTS: Final = ("name", "type")


def read_channels(database: Database) -> Iterator[tuple[int, ChannelDefinition]]:
    """Yield the id of each topic in the database and its channel, numbered 0."""
    known: dict[tuple[str, str], tuple[str, str]] = {}
    for name, type_hash, encoding, definition in _rows(
        database, "message_definitions", _DEFINITION
    ):
        if text(encoding) in _ENCODINGS:
            stated = text(encoding), text(definition)
            for key in ((text(name), text(type_hash)), (text(name), "")):
                known.setdefault(key, stated)
    for topic_id, name, type_name, type_hash, qos, form in _rows(database, "topics", _TOPIC):
        if isinstance(topic_id, int):
            key = text(type_name), text(type_hash)
            encoding, definition = known.get(key) or known.get((key[0], "")) or _own(key[0])
            channel = ChannelDefinition(
                0, text(name), key[0], encoding, definition, key[1], text(qos), text(form) or _CDR
            )
            yield topic_id, channel


def topics_without_text(database: Database) -> int:
    """Return how many topics there are of which something is no text in UTF-8.

    Beside name and type it may be missing.
    """
    present = [name for name in _TOPIC[1:] if name in database.columns("topics")]
    needed = " AND ".join(f"typeof({name}) = 'text'" for name in _TEXTS)
    others = "".join(f" AND typeof({name}) IN ('text', 'null')" for name in present)
    query = f"SELECT {needed}{others}, {', '.join(present)} FROM topics"
    rows = database.connection.execute(query)
    return sum(not all_texts or not all(map(_is_utf8, values)) for all_texts, *values in rows)


def _is_utf8(value: bytes | None) -> bool:
    try:
        (value or b"").decode()
    except UnicodeDecodeError:
        return False
    return True


def _rows(
    database: Database, table: str, columns: tuple[str, ...]
) -> Iterator[tuple[object, ...]]:
    """Yield the rows of a table, NULL for columns that it does not have."""
    present = database.columns(table)
    if present:
        wanted = ", ".join(name if name in present else "NULL" for name in columns)
        yield from database.connection.execute(f"SELECT {wanted} FROM {table} ORDER BY rowid")


def _own(type_name: str) -> tuple[str, str]:
    """Return encoding and definition of one of ROS's own types: older bags carry none."""
    from rosbags.typesys import Stores, get_typestore  # takes a while, and few bags need it

    store = get_typestore(Stores.LATEST)
    if type_name not in store.fielddefs:
        return "", ""
    return "ros2msg", store.generate_msgdef(type_name, ros_version=2)[0]
