"""The first form: that of ``database``, of which no row ever changes.

Whoever changes its tables first copies them here, as they are released.
"""

from __future__ import annotations

from itertools import product

from alembic import op

from rotcal_history.database import METADATA, TABLES

revision = "1"
down_revision = None
REFUSAL = "the history is never changed in place: add a correction"


def upgrade() -> None:
    """Make all tables and what protects them."""
    METADATA.create_all(op.get_bind(), checkfirst=False)
    changes, refuse = ["UPDATE", "DELETE"], f"BEGIN SELECT RAISE(ABORT, '{REFUSAL}'); END"
    if op.get_bind().dialect.name == "postgresql":
        changes, refuse = [*changes, "TRUNCATE"], "EXECUTE FUNCTION history_stays()"
        raising = f"BEGIN RAISE EXCEPTION '{REFUSAL}'; END"
        function = "FUNCTION history_stays() RETURNS trigger LANGUAGE plpgsql"
        op.execute(f"CREATE {function} AS $$ {raising} $$")
    for table, change in product(TABLES, changes):
        name = f"{table}_{change.lower()}"
        op.execute(f"CREATE TRIGGER {name} BEFORE {change} ON {table} {refuse}")
