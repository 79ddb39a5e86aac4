"""A table in two forms: for people at a terminal, perhaps a narrow one, and as CSV in a pipe.

Numbers are rounded in both: two digits of U, the value to the same place. All digits are in JSON
and in files. At a terminal a table that is too wide is split into tables below each other, each
with the first column, so that no digit and no unit is ever cut. If standard output is not a
terminal it gets CSV alone; all words for people go to standard error.
"""

from __future__ import annotations

import csv
import shutil
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from textwrap import wrap
from typing import Any, Final

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.escapes import printable, table_cell
from rotcal_ros.foundation.gum_numbers import uncertainty, value, value_with_uncertainty
from rotcal_ros.report.terminal.console import tell

BORDER: Final = 1
PADDING: Final = 3
"""Characters that a column takes besides its cells: a blank on each side, and a line."""


@dataclass(frozen=True)
class Column:
    """One column: its ``heading`` names the unit, ``cells`` hold numbers in it, texts, or None.

    ``digits`` is the format of the numbers, e.g. ``+.3f``; ``to``, instead, are expanded
    uncertainties: each number is shown to the place of the second digit of its own. ``std``, if
    given, are the standard uncertainties of the cells: at a terminal the expanded ones (k = 2)
    follow each cell, in CSV they are a column of their own. They are shown only if ``valid``.
    """

    heading: str
    cells: Sequence[Any] | Floats | Ints
    digits: str = ""
    to: Floats | None = None
    std: Floats | None = None
    valid: bool = True

    def shown(self) -> list[str]:
        """Return the cells as people read them."""
        write = value_with_uncertainty if self.std is not None and self.valid else value
        if (expanded := self._expanded) is None:
            return [_shown(cell, self.digits) for cell in self.cells]
        return [
            "" if cell is None else write(float(cell), float(u))
            for cell, u in zip(self.cells, expanded, strict=True)
        ]

    @property
    def _expanded(self) -> Floats | None:
        return self.to if self.std is None else COVERAGE_FACTOR * self.std

    def is_text(self) -> bool:
        """Return whether the cells are words, which may be wrapped at blanks."""
        return all(isinstance(cell, str) for cell in self.cells)

    def least_width(self) -> int:
        """Return the width (characters) below which the column would be cut."""
        texts = [printable(self.heading), *self.shown()]
        if self.is_text():
            texts = [word for text in texts for word in text.split()]
        return max(map(len, texts), default=0)

    def plain(self) -> Iterator[tuple[str, Sequence[str]]]:
        """Yield heading and cells of each column in CSV; no program takes a text for a formula."""
        yield (
            table_cell(self.heading),
            [
                table_cell(cell) if isinstance(cell, str) else text.lstrip("+")
                for cell, text in zip(self.cells, replace(self, valid=False).shown(), strict=True)
            ],
        )
        if self.std is not None:
            name, _, unit = self.heading.partition("/")
            expanded = COVERAGE_FACTOR * self.std
            yield (
                table_cell(f"U({name}) (k = {COVERAGE_FACTOR:g})/{unit}"),
                [uncertainty(float(u)) if self.valid else "" for u in expanded],
            )


@dataclass(frozen=True)
class TitledTable:
    """A table with its title; ``key`` distinguishes it where the tables of a verb are joined."""

    columns: Sequence[Column]
    title: str = ""
    key: str = ""


def is_terminal() -> bool:
    """Return whether standard output is a terminal."""
    return sys.stdout.isatty()


def print_table(columns: Sequence[Column], title: str = "") -> None:
    """Print one table."""
    print_tables([TitledTable(columns, title)])


def print_tables(tables: Sequence[TitledTable], key: str = "") -> None:
    """Print tables of the same columns; in CSV they are one, whose first column is ``key``."""
    if is_terminal():
        for table in tables:
            _print_stacked(table)
        return
    writer = csv.writer(sys.stdout, lineterminator="\n")
    for number, table in enumerate(tables):
        plain = [pair for column in table.columns for pair in column.plain()]
        first = [key] if key else []
        if number == 0:
            writer.writerow([*first, *(heading for heading, _ in plain)])
        for row in zip(*(cells for _, cells in plain), strict=True):
            writer.writerow([*([table_cell(table.key)] if key else []), *row])


def print_words(*texts: str, colour: str = "") -> None:
    """Print lines for people, wrapped at a terminal; on standard error in a pipe."""
    if not is_terminal():
        tell(*texts, colour=colour, err=True)
        return
    width = shutil.get_terminal_size().columns
    for text in texts:
        lines = wrap(printable(text), width, break_long_words=False, break_on_hyphens=False)
        tell(*lines or [""], colour=colour)


def split_columns(columns: Sequence[Column], width: int) -> list[list[Column]]:
    """Return ``columns`` in groups that fit into ``width`` characters, each with the first one."""
    key, *others = columns
    least = BORDER + key.least_width() + PADDING
    groups: list[list[Column]] = []
    taken = width + 1
    for column in others:
        needed = column.least_width() + PADDING
        if taken + needed > width:
            groups.append([key])
            taken = least
        groups[-1].append(column)
        taken += needed
    return groups or [[key]]


def _print_stacked(table: TitledTable) -> None:
    # rich takes longer to load than a short verb takes to run.
    from rich.console import Console
    from rich.table import Table

    width = shutil.get_terminal_size().columns
    # What does not fit even alone is left to the terminal, which breaks lines and cuts nothing.
    console = Console(
        highlight=False, markup=False, emoji=False, width=max(width, _widest(table.columns))
    )
    if table.title:
        print_words(table.title)
    for group in split_columns(table.columns, width):
        drawn = Table()
        for column in group:
            text = column.is_text()
            drawn.add_column(
                printable(column.heading), justify="left" if text else "right", no_wrap=not text,
                min_width=column.least_width(),
            )  # fmt: skip
        for row in zip(*(column.shown() for column in group), strict=True):
            drawn.add_row(*row)
        console.print(drawn)


def _widest(columns: Sequence[Column]) -> int:
    key, *others = columns
    least = BORDER + key.least_width() + PADDING
    return least + max((column.least_width() + PADDING for column in others), default=0)


def _shown(cell: Any, digits: str) -> str:
    if cell is None:
        return ""
    return printable(cell) if isinstance(cell, str) else format(cell, digits)


def column_of(heading: str, values: Iterable[Any], unit: float = 1.0, digits: str = "") -> Column:
    """Return a column of ``values`` in SI, shown in ``unit``; None stays."""
    return Column(heading, [None if v is None else v / unit for v in values], digits)
