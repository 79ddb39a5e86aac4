"""Puts what the yardstick measured into its page, for the site of `make docs`."""

from __future__ import annotations

import json
import re
from pathlib import Path

MEASURED = Path(__file__).resolve().parents[1] / "research" / "yardstick.json"
"""The tables by name: rows of cells, of which the first is the head."""
PLACE = re.compile(r"<!-- `make docs` puts the table of ([a-z ]+) here -->")


def filled(page: str) -> str:
    """Return the page with its tables.

    Raises ValueError for a place without a table, and for a table without a place.
    """
    tables: dict[str, list[list[str]]] = json.loads(MEASURED.read_text(encoding="utf-8"))
    if set(PLACE.findall(page)) != set(tables):
        raise ValueError(f"yardstick.md should have places of the tables {', '.join(tables)}")
    return PLACE.sub(lambda place: _table(*tables[place[1]]), page)


def _table(head: list[str], *rows: list[str]) -> str:
    every = (head, ["---"] * len(head), *rows)
    return "\n".join(f"| {' | '.join(row)} |" for row in every)
