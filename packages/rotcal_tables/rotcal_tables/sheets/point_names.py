"""Names of points that say what was measured: ``P3_N2`` is ball 2 at position 3 by a pattern.

Programs of trackers and measuring machines export a name and coordinates. A person says once what
the parts of the name are, ``P{position}_N{ball}``; they become columns of their own.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import permutations
from typing import Final

from rotcal_ros.foundation.errors import ConfigurationError, UndecidedError
from rotcal_ros.foundation.table_columns import TableColumn, undecided
from rotcal_ros.foundation.tables import Header
from rotcal_tables.sheets.files import Cell, Sheet
from rotcal_tables.sheets.words import known_columns

_PLACE: Final = re.compile(r"\{(\w+)\}")
_NUMBERS: Final = re.compile(r"\d+")
_LEAST: Final = 3
"""Names that show a pattern."""


def split_point_names(sheet: Sheet, pattern: str) -> Sheet:
    """Return a sheet with a column for each part of the names; as it is where none has them.

    The column of the names is left empty. Raises ConfigurationError for a pattern that is none.
    """
    names = _PLACE.findall(pattern)
    if not names or len({*names}) < len(names) or not {*names} <= {*known_columns()}:
        raise ConfigurationError(
            f"sheet.names: {pattern!r}: expected a name with columns in it, as "
            f"P{{position}}_N{{ball}}; columns are {', '.join(known_columns())}"
        )
    parts = re.split(r"\{\w+\}", pattern)
    shape = re.compile("([^\\W_]+)".join(map(re.escape, parts)), re.IGNORECASE)
    places = {k for _, cells in sheet.rows for k, cell in enumerate(cells)
              if isinstance(cell, str) and shape.fullmatch(cell)}  # fmt: skip
    if not places:
        return sheet
    at, width = min(places), max(len(cells) for _, cells in sheet.rows)
    rows = list[tuple[int, tuple[Cell, ...]]]()
    first = next(k for k, (_, cells) in enumerate(sheet.rows) if _match(shape, cells, at))
    above = [k for k, (_, cells) in enumerate(sheet.rows[:first]) if cells[at : at + 1] != ("",)]
    head = above[-1] if above else -1
    for k, (number, cells) in enumerate(sheet.rows):
        found = _match(shape, cells, at)
        more = names if k == head else found.groups() if found else [""] * len(names)
        bare = cells if not found and k != head else (*cells[:at], "", *cells[at + 1 :])
        rows.append((number, (*bare, *[""] * (width - len(bare)), *more)))
    if head < 0:
        rows.insert(0, (0, (*(f"#{place + 1}" for place in range(width)), *names)))
    return replace(sheet, rows=tuple(rows))


def ask_name_pattern(
    where: str, found: Sequence[Sheet], headers: Sequence[Header]
) -> UndecidedError | None:
    """Return the question what the two numbers in names of points are; None: there are none."""
    keys = dict.fromkeys(
        tuple(c.name for c in map(TableColumn.of, header) if not c.quantity) for header in headers
    )
    pairs = [pair for each in keys if len(each) == 2 for pair in permutations(each)]
    for name, count in _alike(found):
        first, second = _NUMBERS.finditer(name)
        answers = [
            (
                f"{name[: first.start()]}{{{a}}}{name[first.end() : second.start()]}{{{b}}}"
                f"{name[second.end() :]}",
                f"{name} is {a} {first[0]}, {b} {second[0]}",
            )
            for a, b in pairs
        ]
        if answers:
            return undecided(
                f"{where}: {count} names as {name} seem to say what was measured",
                "sheet.names",
                answers,
            )
    return None


def _match(shape: re.Pattern[str], cells: Sequence[object], at: int) -> re.Match[str] | None:
    cell = cells[at] if at < len(cells) else ""
    return shape.fullmatch(cell) if isinstance(cell, str) else None


def _alike(found: Sequence[Sheet]) -> Iterator[tuple[str, int]]:
    """Yield a name with two numbers, and how many there are that differ in these alone."""
    for sheet in found:
        width = max((len(cells) for _, cells in sheet.rows), default=0)
        for at in range(width):
            names = [str(cells[at]) for _, cells in sheet.rows if at < len(cells)]
            names = [n for n in names if len(_NUMBERS.findall(n)) == 2 and n[:1].isalpha()]
            if len(names) >= _LEAST and len({_NUMBERS.sub("#", n) for n in names}) == 1:
                yield names[0], len(names)
