"""Reads a rosbag2 sqlite3 file of any version into the same blocks that an MCAP file gives.

The file is never changed; a damaged one is read as far as sqlite3 itself can. Version 1 of
rosbag2's schema knows names and types of topics, 2 adds the quality of service, 3 the table
``schema``, 4 hashes of types and the table ``message_definitions``.
"""

from __future__ import annotations

import re
import shutil
import sqlite3
import sys
from collections import Counter
from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final
from urllib.parse import quote_from_bytes

import numpy as np

from rotcal_ros.bags.blocks import HEADER_TYPE, Block
from rotcal_ros.bags.compression import (
    Unpacker,
    declared_compression,
    looks_packed,
    packed_one_by_one,
    stated_compression,
    unpacked_storage_file,
)
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.settings import DEFAULT_LIMITS, LARGEST_MESSAGE, ReadingLimits
from rotcal_ros.bags.storage_scan import Damage, FileVerdict, Scan, TopicCount
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.untrusted import cause_of

_BLOCK_BYTES: Final = 1 << 20
_MAX_CHANNELS: Final = 1 << 16
_LEAST_ROW: Final = 16
"""Least bytes of a row of messages."""
_NEEDED: Final = {"topics": ("id", "name", "type"), "messages": ("topic_id", "timestamp", "data")}
_UNKNOWN: Final = "(unknown topic)"
_UNNAMED: Final = "/unknown_topic_"
_NO_TYPE: Final = "unknown/msg/Unknown"
_LEFT_BESIDE: Final = ("-wal", "-journal")
"""Endings of the files in which sqlite3 has changes that are not in the database yet."""
_MAX_FAULTS: Final = 20
_NO_FAULT: Final = ("ok", "*** in database main ***")
"""Lines of sqlite3's integrity check that report no fault."""
_FAILURES: Final = (sqlite3.Error, UnicodeDecodeError, OverflowError)
"""What reading a damaged database raises; Python cannot decode every complaint of sqlite3."""
_AT_PAGE: Final = re.compile(r"page (\d+)")
_LARGEST_ID: Final = (1 << 63) - 1
Row = tuple[object, ...]


@dataclass(frozen=True)
class Database:
    """A connection and the file that it reads: the bag's own, or a copy of it.

    ``damages`` are those found so far; none while the file is sound.
    """

    connection: sqlite3.Connection
    file: Path
    damages: list[Damage] = field(default_factory=list)

    def columns(self, table: str) -> tuple[str, ...]:
        """Return the columns of a table, none when there is no such table."""
        kind = "SELECT 1 FROM sqlite_master WHERE type = 'table' AND lower(name) = ?"
        if self.connection.execute(kind, (table,)).fetchone() is None:
            return ()
        info = self.connection.execute(f"PRAGMA table_info({table})")
        return tuple(_text(name).lower() for _, name, *_ in info)

    def select(self, table: str, wanted: tuple[str, ...], order: str = "") -> Iterator[Row]:
        """Yield columns and expressions of all rows that sqlite3 can read; note where it fails.

        A missing column is NULL. Rows come by ``order`` and their ids, in a damaged database by
        their ids alone.
        """
        try:
            if not (present := self.columns(table)):
                return
            names = [
                name if name in present or not name.isidentifier() else "NULL" for name in wanted
            ]
            what = ", ".join(names)
            if self.damages:
                yield from self._rows_of_damaged(table, what)
                return
            key = "id" if "id" in present else "rowid"
            yield from self.connection.execute(
                f"SELECT {what} FROM {table} ORDER BY {order or key}, {key}"
            )
        except _FAILURES as error:
            self._note(table, _words(error))

    def _rows_of_damaged(self, table: str, what: str) -> Iterator[Row]:
        """Yield the rows of a damaged table by their ids, before and after what is damaged.

        After a damage reading is tried one id further, then twice as far each time.
        """
        start, step = 0, 1
        while start < _LARGEST_ID:
            last = yield from self._rows_above(table, what, start)
            step = 2 * step if last == start else 1
            start = last + step

    def _rows_above(self, table: str, what: str, start: int) -> Generator[Row, None, int]:
        """Yield the rows with ids above ``start``; return the last id before a damage.

        Ids have to ascend: a damaged B-tree may lead to the same page again and again. Without a
        damage the largest id is returned.
        """
        before = last = start
        query = f"SELECT rowid, {what} FROM {table} NOT INDEXED WHERE rowid > ? ORDER BY rowid"
        try:
            for row_id, *values in self.connection.execute(query, (start,)):
                if row_id <= last:  # then the one before may have been wrong as well
                    self._note(table, "its rows are not in order")
                    return before
                before, last = last, row_id
                yield tuple(values)
        except _FAILURES as error:
            self._note(table, _words(error))
            return last
        return _LARGEST_ID

    def _note(self, table: str, reason: str) -> None:
        at = min((damage.offset for damage in self.damages), default=0)
        what = f"not all of its {table} can be read ({reason}); sqlite3 .recover may save more"
        if Damage(at, what) not in self.damages:
            self.damages.append(Damage(at, what))

    def check(self) -> None:
        """Note what sqlite3's own integrity check reports."""
        self.damages.extend(self._integrity())
        if self.damages:
            # With this, sqlite3 tolerates a damaged schema; it refuses a file that is cut off
            # otherwise. Nothing is written: the connection is read-only or to a copy.
            self.connection.execute("PRAGMA writable_schema = ON")

    def _integrity(self) -> list[Damage]:
        try:
            found = self.connection.execute(f"PRAGMA integrity_check({_MAX_FAULTS})").fetchall()
            (page_size,) = self.connection.execute("PRAGMA page_size").fetchone()
        except _FAILURES as error:
            return [Damage(0, f"the database cannot be checked: {_words(error)}")]
        lines = [line for (answer,) in found for line in _text(answer).splitlines()]
        return [_damage(line, page_size) for line in lines if line not in _NO_FAULT]


@contextmanager
def open_database(path: Path, limits: ReadingLimits = DEFAULT_LIMITS) -> Iterator[Database]:
    """Open ``path`` for reading; texts come as bytes. Raises BagError when that is impossible.

    A journal or write-ahead log that was left beside it belongs to the data, but sqlite3 writes
    into the database to use it: that happens in a temporary copy.
    """
    try:
        with unpacked_storage_file(path, limits) as (plain, damage):
            if not plain.is_file() or not plain.stat().st_size:
                what = "is empty" if plain.is_file() else "is not a file"
                raise BagError(f"cannot read {path}: it {what}; copy the recording again")
            with (
                _with_pending_changes(plain) as (file, how),
                closing(_connected(file, how)) as connection,
            ):
                yield Database(connection, file, [damage] if damage else [])
    except _FAILURES as error:
        raise _refusal(path, _words(error)) from error
    except OSError as error:
        raise BagError(f"cannot read {path}: {cause_of(error)}") from error


def _refusal(path: Path, what: str) -> BagError:
    return BagError(
        f"cannot read {path}: {what}; rotcal records MCAP, which it can repair; what is left of a "
        "sqlite3 bag may be saved by 'sqlite3 FILE .recover'"
    )


@contextmanager
def _with_pending_changes(path: Path) -> Iterator[tuple[Path, str]]:
    """Yield the file to open and how; where something was left beside it, a copy of both."""
    left = [file for end in _LEFT_BESIDE if (file := Path(f"{path}{end}")).is_file()]
    if not any(file.stat().st_size for file in left):
        with path.open("rb"):  # raises OSError with the system's reason, which sqlite3 hides
            pass
        # immutable: no locks and no files beside, so that read-only media work too
        yield path, "mode=ro&immutable=1"
        return
    with TemporaryDirectory(prefix="rotcal_") as folder:
        for file in (path, *left):
            shutil.copyfile(file, Path(folder) / file.name)
        yield Path(folder) / path.name, "mode=rw"


def _text(value: object) -> str:
    """Return a text of the database, whatever its bytes; '' for anything else."""
    return value.decode(errors="backslashreplace") if isinstance(value, bytes) else ""


def _words(error: Exception) -> str:
    """Return what a failure says, in one line of visible characters."""
    complaint = "its texts are damaged" if isinstance(error, UnicodeDecodeError) else str(error)
    return complaint.encode("unicode_escape").decode()


def _connected(path: Path, how: str) -> sqlite3.Connection:
    address = quote_from_bytes(bytes(path.absolute()))
    connection = sqlite3.connect(f"file:{address}?{how}", uri=True, isolation_level=None)
    connection.text_factory = bytes
    if sys.version_info >= (3, 11):
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, 2 * LARGEST_MESSAGE)
    # Functions and checks in the schema of a foreign file must not run.
    for pragma in (
        "trusted_schema = OFF",
        "ignore_check_constraints = ON",
        "cell_size_check = ON",
    ):
        connection.execute(f"PRAGMA {pragma}")
    return connection


def _damage(line: str, page_size: int) -> Damage:
    page = _AT_PAGE.search(line)
    what = line.encode("unicode_escape").decode()
    return Damage((int(page[1]) - 1) * page_size if page else 0, f"the database: {what}")


class SqliteScan(Scan):
    """One pass over a sqlite3 file.

    sqlite3's own integrity check says whether it is sound. There are no checksums: a changed byte
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
        self._packed = False

    def blocks(self) -> Iterator[Block]:
        """Yield the messages in the order of log times, those of a damaged file by their ids."""
        with open_database(self.path, self._limits) as database:
            self._size = self.path.stat().st_size
            self._plain_size = database.file.stat().st_size
            self._unpacker = Unpacker(self._limits, self._size)
            database.check()
            self._damages = database.damages
            damaged = bool(self._damages)
            if not damaged:
                self._require_tables(database)
                if count := topics_without_text(database):
                    self._oddities["topics with a name or type that is not UTF-8"] = count
            yield from self._read(database)
            if damaged:
                self._missing_rows(database)
        if self._damages and not self._counts and not self.channels:
            raise _refusal(self.path, self._damages[0].what)

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
                    f"{self.path} is not a bag of rosbag2: its database has no table {table} with "
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
            self._packed = packed_one_by_one(*self._compression(database))
        except BagError as error:
            raise BagError(f"cannot read {self.path}: {error}") from None
        for block in self._batches(database):
            yield from self._plain(block)

    def _compression(self, database: Database) -> tuple[str, str]:
        """Return mode and format of the messages' compression; what the file states counts."""
        stated = ("", "")
        for (metadata,) in database.select("metadata", ("metadata",)):
            stated = stated_compression(metadata) if isinstance(metadata, bytes) else stated
        return stated if stated[0] else declared_compression(self.path)

    def _batches(self, database: Database) -> Iterator[Block]:
        batch: list[tuple[int, int, bytes]] = []
        size, room = 0, 4 * self._plain_size + LARGEST_MESSAGE
        for topic_id, time_ns, data, length in database.select("messages", _MESSAGE, "timestamp"):
            if (message := self._message(topic_id, time_ns, data, length)) is None:
                continue
            batch.append(message)
            size += len(message[2])
            if size >= _BLOCK_BYTES:
                self.position = min(self._size, self.position + size)
                room -= size
                yield _block(batch)
                batch, size = [], 0
            if room < 0:
                self._damages.append(Damage(0, "its messages are more than its size allows"))
                break
        if batch:
            yield _block(batch)

    def _message(
        self, topic_id: object, time_ns: object, data: object, size: object
    ) -> tuple[int, int, bytes] | None:
        """Return channel, log time and message of a row; count what is wrong with it."""
        number = self._numbers.get(topic_id) if isinstance(topic_id, int) else None
        if number is None and isinstance(topic_id, int):
            number = self._unnamed_channel(topic_id)
        if number is None:
            self._oddities["messages of no topic"] += 1
            self._unreadable += 1
            return None
        if not isinstance(time_ns, int) or not isinstance(data, bytes):
            what = "without content or time"
            if size and not isinstance(data, bytes):
                what = "whose size is out of range"
            elif isinstance(time_ns, bytes | float):
                what = "whose time is no integer (UPDATE messages SET timestamp = CAST(...))"
            self._oddities[f"messages {what}"] += 1
            self._lost[number] += 1
            return None
        if time_ns < 0:
            self._oddities["messages with a time before 1970, read as 1970"] += 1
        return number, max(0, time_ns), data

    def _unnamed_channel(self, topic_id: int) -> int | None:
        """Return a new channel for a topic whose row is missing; None when there are too many."""
        number = len(self.channels)
        if number >= _MAX_CHANNELS:
            return None
        self._numbers[topic_id] = number
        name = f"{_UNNAMED}{topic_id}".replace("-", "minus_")
        self.channels[number] = ChannelDefinition(number, name, _NO_TYPE, "", "")
        self._oddities["topics without name and type; their messages are kept as they are"] += 1
        return number

    def _plain(self, block: Block) -> Iterator[Block]:
        """Count and yield the messages of ``block`` as they were published."""
        self._packed |= looks_packed(block.payload(0))
        broken = Counter[int]()
        for plain in self._unpacker.messages(block, broken) if self._packed else (block,):
            self._count(plain)
            yield plain
        if broken:
            self._lost += broken
            self._oddities["compressed messages that cannot be unpacked"] += broken.total()

    def _missing_rows(self, database: Database) -> None:
        """Count the ids that were not read: rosbag2 numbers them without gaps."""
        with suppress(*_FAILURES):
            (last,) = database.connection.execute("SELECT max(rowid) FROM messages").fetchone()
            known = self._counts.total() + self._lost.total() + self._unreadable
            if isinstance(last, int) and 0 < last - known <= self._plain_size // _LEAST_ROW:
                self._unreadable += last - known


_MESSAGE: Final = (
    "topic_id", "timestamp", f"CASE WHEN length(data) <= {LARGEST_MESSAGE} THEN data END",
    "length(data)",
)  # fmt: skip


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
    for name, type_hash, encoding, definition in database.select(
        "message_definitions", _DEFINITION
    ):
        if _text(encoding) in _ENCODINGS:
            stated = _text(encoding), _text(definition)
            for key in ((_text(name), _text(type_hash)), (_text(name), "")):
                known.setdefault(key, stated)
    for topic_id, name, type_name, type_hash, qos, form in database.select("topics", _TOPIC):
        if isinstance(topic_id, int):
            key = _text(type_name), _text(type_hash)
            encoding, definition = (
                known.get(key) or known.get((key[0], "")) or _standard_definition(key[0])
            )
            channel = ChannelDefinition(
                0, _text(name), key[0], encoding, definition, key[1], _text(qos),
                _text(form) or _CDR,
            )  # fmt: skip
            yield topic_id, channel


def topics_without_text(database: Database) -> int:
    """Return how many topics have something that is not UTF-8.

    All but name and type may be missing.
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


def _standard_definition(type_name: str) -> tuple[str, str]:
    """Return encoding and definition of one of ROS's own types: versions before 4 have none."""
    from rosbags.typesys import Stores, get_typestore  # takes a while, and few bags need it

    store = get_typestore(Stores.LATEST)
    if type_name not in store.fielddefs:
        return "", ""
    return "ros2msg", store.generate_msgdef(type_name, ros_version=2)[0]
