"""The first form: that of ``database``, of which no row ever changes.

Whoever changes its tables first copies them here, as they are released.
"""

from __future__ import annotations

from alembic import op

from rotcal_ros.extensions.history.database import METADATA, TABLES

revision = "1"
down_revision = None
REFUSAL = "the history is never changed in place: add a correction"


def upgrade() -> None:
    """Make all tables and what protects them."""
    METADATA.create_all(op.get_bind(), checkfirst=False)
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
