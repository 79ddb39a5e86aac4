"""Saving the rows of a damaged rosbag2 sqlite3 file into a new, sound database.

What SELECT still reads comes first; the rest from the leaf pages.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO, Final

from rotcal_ros.bags.sqlite_file import FAILURES, Database
from rotcal_ros.bags.sqlite_pages import PAGE_SIZES, LeafPages, Row, Value

TABLES: Final = {
    "topics": (
        "name", "type", "serialization_format", "offered_qos_profiles", "type_description_hash",
    ),
    "message_definitions": (
        "topic_type", "encoding", "encoded_message_definition", "type_description_hash",
    ),
    "metadata": ("metadata_version", "metadata"),
    "messages": ("topic_id", "timestamp", "data"),
}  # fmt: skip
"""The tables of a bag and their columns beside ``id``, of all versions of rosbag2."""

_MAGIC: Final = b"SQLite format 3\0"
_TRIED_BYTES: Final = 1 << 20
_ENCODINGS: Final = (b"ros2msg", b"ros2idl", b"unknown", b"")
_MAX_READ: Final = 4
"""Bytes that are read for each byte of the file: a tree may lead to a page twice, and for ever."""
_LEAST_ROW: Final = 4
_INSERT_OTHER: Final = (
    "INSERT INTO messages SELECT NULL, ?, ?, ? WHERE NOT EXISTS (SELECT 1 FROM messages"
    " WHERE id = ? AND topic_id IS ? AND timestamp IS ? AND data IS ?)"
)


@contextmanager
def salvaged(damaged: Database) -> Iterator[Database]:
    """Yield a temporary database with all rows of ``damaged`` that can still be read.

    Raises sqlite3.Error or OSError when there is no room for it.
    """
    with TemporaryDirectory(prefix="rotcal_") as folder:
        path = Path(folder) / "salvaged.db3"
        with closing(sqlite3.connect(path, isolation_level=None)) as target:
            target.text_factory = bytes
            target.executescript("PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF;")
            for table, columns in TABLES.items():
                target.execute(
                    f"CREATE TABLE {table} (id INTEGER PRIMARY KEY, {','.join(columns)})"
                )
            target.execute("BEGIN")
            for table in TABLES:
                for order in ("ASC", "DESC"):
                    _copy(target, table, _selected(damaged, table, order))
            with damaged.file.open("rb") as file:
                for row_id, values in _likeliest(file).rows():
                    if found := _table_of(values):
                        _copy(target, found, [(row_id, values[1 : len(TABLES[found]) + 1])])
            target.execute("COMMIT")
            yield Database(target, path)


def _copy(target: sqlite3.Connection, table: str, rows: Iterable[Row]) -> None:
    """Insert rows whose ids are new; columns at the end may be missing.

    Another message with the id of one that is there already got it by damage: it gets a new one.
    """
    columns = TABLES[table]
    statement = f"INSERT OR IGNORE INTO {table} VALUES (?{',?' * len(columns)})"
    missing = (None,) * len(columns)
    for row_id, values in rows:
        whole = (*values, *missing[len(values) :])
        added = target.execute(statement, (row_id, *whole)).rowcount
        if not added and table == "messages":
            target.execute(_INSERT_OTHER, (*whole, row_id, *whole))


def _selected(source: Database, table: str, order: str) -> Iterator[Row]:
    """Yield the rows that SELECT reads, up to the first damage on its way."""
    size = source.file.stat().st_size
    room, rows = _MAX_READ * size, size // _LEAST_ROW
    with suppress(*FAILURES):
        if not (present := source.columns(table)):
            return
        columns = ", ".join(name if name in present else "NULL" for name in TABLES[table])
        key = "id" if "id" in present else "rowid"
        for row_id, *values in source.connection.execute(
            f"SELECT {key}, {columns} FROM {table} NOT INDEXED ORDER BY {key} {order}"
        ):
            room, rows = room - _bytes(values), rows - 1
            if room < 0 or rows < 0:
                return
            if isinstance(row_id, int):
                yield row_id, tuple(values)


def _bytes(values: Iterable[Value]) -> int:
    return sum(len(value) for value in values if isinstance(value, bytes))


def _likeliest(file: BinaryIO) -> LeafPages:
    """Return the pages of the size that makes most sense: the header may be damaged too."""
    header = file.read(100)
    stated = LeafPages(file, 4096)
    if header.startswith(_MAGIC):
        size = int.from_bytes(header[16:18], "big")
        size = 65536 if size == 1 else size
        if size in PAGE_SIZES:
            stated = LeafPages(file, size, header[20])
    return max((stated, *(LeafPages(file, size) for size in PAGE_SIZES)), key=_likelihood)


def _likelihood(pages: LeafPages) -> int:
    return sum(1 for _, values in pages.rows(_TRIED_BYTES) if _table_of(values))


def _table_of(values: tuple[Value, ...]) -> str | None:
    """Return the table that a row without its name belongs to, by its form."""
    if len(values) < 3 or not isinstance(values[0], int | None):
        return None  # the first column repeats the row id, mostly as NULL
    _, first, second, *others = values
    if isinstance(first, int) and isinstance(second, int):
        return "messages" if others and isinstance(others[0], bytes) else None
    if isinstance(first, int) and isinstance(second, bytes):
        return "metadata"
    if not isinstance(first, bytes) or not isinstance(second, bytes) or not others:
        return None
    if second in _ENCODINGS:
        return "message_definitions"
    return "topics" if b"/" in second else None
