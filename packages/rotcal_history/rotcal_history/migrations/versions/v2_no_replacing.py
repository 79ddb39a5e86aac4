"""No row is replaced either: INSERT OR REPLACE of SQLite would remove the old one silently.

It fires no trigger for what it removes, unless the connection asks for that (recursive_triggers).
PostgreSQL has no such statement.
"""

from __future__ import annotations

from alembic import op

revision = "2"
down_revision = "1"
KEYS = {
    "items": (("id",), ("serial", "axis")),
    "entries": (("id",), ("sha256",), ("replaces",), ("content_sha256",)),
    "results": (("entry_id",),),
    "curves": (("entry_id", "component"),),
    "forecasts": (("basis",),),
}
"""What is there once in each table; of contents those that replace no other entry."""


def upgrade() -> None:
    """Pass over rows that are there already, whatever the statement wants to do with them."""
    if op.get_bind().dialect.name != "sqlite":
        return
    for table, keys in KEYS.items():
        same = []
        for key in keys:
            words = " AND ".join(f"{name} = NEW.{name}" for name in key)
            once = " AND replaces IS NULL AND NEW.replaces IS NULL"
            same.append(f"({words}{once if key == ('content_sha256',) else ''})")
        there = f"EXISTS (SELECT 1 FROM {table} WHERE {' OR '.join(same)})"
        stays = f"WHEN {there} BEGIN SELECT RAISE(IGNORE); END"
        op.execute(f"CREATE TRIGGER {table}_insert BEFORE INSERT ON {table} {stays}")
