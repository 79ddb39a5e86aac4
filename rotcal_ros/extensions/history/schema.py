"""The tables of the history, the same in SQLite and PostgreSQL; what makes them is in migrations.

Every row stays as it was written: triggers refuse UPDATE, DELETE and TRUNCATE. Times are integer
nanoseconds since 1970, numbers SI. Arrays are little-endian float64, row by row: a curve of 36
angles is read 250 times as fast as from Parquet, from fewer bytes (benchmarks/bench_history.py).
"""

from __future__ import annotations

from typing import Any, Final

import sqlalchemy as sa

WHOLE: Final = sa.BigInteger().with_variant(sa.Integer, "sqlite")
NUMBER: Final[sa.types.TypeEngine[float]] = sa.Double().with_variant(sa.REAL, "sqlite")
METADATA: Final = sa.MetaData()


def _table(name: str, *parts: Any) -> sa.Table:
    return sa.Table(name, METADATA, *parts, sqlite_strict=True)


def _given(name: str, kind: Any, *more: Any) -> sa.Column[Any]:
    return sa.Column(name, kind, *more, nullable=False)


def _own(name: str, kind: Any, *more: Any) -> sa.Column[Any]:
    return sa.Column(name, kind, *more, primary_key=True)


ITEMS: Final = _table(
    "items",
    _own("id", WHOLE),
    _given("serial", sa.Text),
    _given("axis", sa.Text),
    sa.UniqueConstraint("serial", "axis"),
)
"""A rotary axis of one machine."""

ENTRIES: Final = _table(
    "entries",
    _own("id", WHOLE),
    _given("item_id", WHOLE, sa.ForeignKey("items.id")),
    _given("kind", sa.Text),
    _given("what", sa.Text),
    _given("measured_ns", WHOLE),
    _given("added_ns", WHOLE),
    _given("added_by", sa.Text),
    _given("why", sa.Text),
    _given("content_sha256", sa.Text),
    _given("sha256", sa.Text, sa.CheckConstraint("length(sha256) = 64")),
    sa.Column("replaces", WHOLE, sa.ForeignKey("entries.id"), unique=True),
    _given("content", sa.LargeBinary),
    sa.UniqueConstraint("sha256"),
    sa.Index("entries_of_item", "item_id", "measured_ns"),
    sa.Index(
        "entries_once",
        "content_sha256",
        unique=True,
        sqlite_where=sa.text("replaces IS NULL"),
        postgresql_where=sa.text("replaces IS NULL"),
    ),
)
"""``content`` is compressed by zlib, ``content_sha256`` of what is in it, ``sha256`` of the entry.

The same content is added once; only a correction, which ``replaces`` another entry, may have it
again. An entry is replaced once.
"""

RESULTS: Final = _table(
    "results",
    _own("entry_id", WHOLE, sa.ForeignKey("entries.id")),
    _given("method", sa.Text),
    _given("verdict", sa.Text),
    _given("verdict_line", sa.Text),
    _given("covered", WHOLE),
    _given("simulated", WHOLE),
    _given("measured_on", sa.Text),
    _given("instruments", sa.Text),
    sa.Column("temperature_c", NUMBER),
    _given("tolerance_rad", NUMBER),
    _given("tolerance_m", NUMBER),
)
"""What is asked of a result without reading all of it. It follows from the content."""

CURVES: Final = _table(
    "curves",
    _own("entry_id", WHOLE, sa.ForeignKey("entries.id")),
    _own("component", sa.Text),
    _given("period", NUMBER),
    _given("angles", sa.LargeBinary),
    _given("deviation", sa.LargeBinary),
    _given("covariance", sa.LargeBinary),
)
"""The deviation curves of a result. They follow from its content."""

FORECASTS: Final = _table(
    "forecasts",
    _own("item_id", WHOLE, sa.ForeignKey("items.id")),
    _own("basis", sa.Text),
    _given("made_ns", WHOLE),
    _given("content", sa.Text),
)
"""What was forecast of an axis; ``basis`` hashes the entries and settings it was made from."""

TABLES: Final = tuple(table.name for table in METADATA.sorted_tables)
