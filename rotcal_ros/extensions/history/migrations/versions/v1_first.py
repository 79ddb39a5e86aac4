"""The first form: items, entries, results, curves and forecasts, of which no row ever changes."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "1"
down_revision = None
TABLES = ("items", "entries", "results", "curves", "forecasts")
REFUSAL = "the history is never changed in place: add a correction"
WHOLE = sa.BigInteger().with_variant(sa.Integer, "sqlite")
NUMBER = sa.Double().with_variant(sa.REAL, "sqlite")


def upgrade() -> None:
    """Make all tables and what protects them."""
    _make(
        "items",
        _key("id", WHOLE), _text("serial"), _text("axis"),
        sa.UniqueConstraint("serial", "axis"),
    )  # fmt: skip
    _make(
        "entries",
        _key("id", WHOLE), _whole("item_id", "items.id"), _text("kind"), _text("what"),
        _whole("measured_ns"), _whole("added_ns"), _text("added_by"), _text("why"),
        _text("content_sha256"),
        sa.Column("sha256", sa.Text, sa.CheckConstraint("length(sha256) = 64"), nullable=False),
        sa.Column("replaces", WHOLE, sa.ForeignKey("entries.id"), unique=True),
        _bytes("content"), sa.UniqueConstraint("sha256"),
    )  # fmt: skip
    op.create_index("entries_of_item", "entries", ["item_id", "measured_ns"])
    original = sa.text("replaces IS NULL")
    op.create_index(
        "entries_once", "entries", ["content_sha256"],
        unique=True, sqlite_where=original, postgresql_where=original,
    )  # fmt: skip
    _make(
        "results",
        _key("entry_id", WHOLE, "entries.id"), _text("method"), _text("verdict"),
        _text("verdict_line"), _whole("covered"), _whole("simulated"), _text("measured_on"),
        _text("instruments"), sa.Column("temperature_c", NUMBER), _number("tolerance_rad"),
        _number("tolerance_m"),
    )  # fmt: skip
    _make(
        "curves",
        _key("entry_id", WHOLE, "entries.id"), _key("component", sa.Text), _number("period"),
        _bytes("angles"), _bytes("deviation"), _bytes("covariance"),
    )  # fmt: skip
    _make(
        "forecasts",
        _key("item_id", WHOLE, "items.id"), _key("basis", sa.Text), _whole("made_ns"),
        _text("content"),
    )  # fmt: skip
    protect = _in_sqlite if op.get_bind().dialect.name == "sqlite" else _in_postgresql
    for statement in protect():
        op.execute(statement)


def _in_sqlite() -> list[str]:
    return [
        f"CREATE TRIGGER {table}_{what.lower()} BEFORE {what} ON {table} "
        f"BEGIN SELECT RAISE(ABORT, '{REFUSAL}'); END"
        for table in TABLES
        for what in ("UPDATE", "DELETE")
    ]


def _in_postgresql() -> list[str]:
    function = (
        "CREATE FUNCTION history_stays() RETURNS trigger LANGUAGE plpgsql AS "
        f"$$ BEGIN RAISE EXCEPTION '{REFUSAL}'; END $$"
    )
    triggers = [
        f"CREATE TRIGGER {table}_stays BEFORE UPDATE OR DELETE OR TRUNCATE ON {table} "
        "FOR EACH STATEMENT EXECUTE FUNCTION history_stays()"
        for table in TABLES
    ]
    return [function, *triggers]


def _make(name: str, *parts: Any) -> None:
    op.create_table(name, *parts, sqlite_strict=True)


def _key(name: str, kind: Any, to: str = "") -> sa.Column[Any]:
    return sa.Column(name, kind, *([sa.ForeignKey(to)] if to else []), primary_key=True)


def _whole(name: str, to: str = "") -> sa.Column[Any]:
    return sa.Column(name, WHOLE, *([sa.ForeignKey(to)] if to else []), nullable=False)


def _text(name: str) -> sa.Column[Any]:
    return sa.Column(name, sa.Text, nullable=False)


def _number(name: str) -> sa.Column[Any]:
    return sa.Column(name, NUMBER, nullable=False)


def _bytes(name: str) -> sa.Column[Any]:
    return sa.Column(name, sa.LargeBinary, nullable=False)
