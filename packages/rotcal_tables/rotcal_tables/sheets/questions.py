"""What is asked where the head of a table is not understood: its columns, by their own names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Final

from rotcal_ros.foundation.errors import BagError, ConfigurationError, Question
from rotcal_ros.foundation.plugins import name_hint
from rotcal_ros.foundation.table_columns import (
    ANGLE,
    UNITS,
    TableColumn,
    folded,
    meaning,
    option,
    quantity_of,
)
from rotcal_ros.foundation.table_reading import Use
from rotcal_ros.foundation.tables import Header
from rotcal_tables.sheets.files import Cell, Sheet
from rotcal_tables.sheets.layout import (
    MATRIX_CORNER,
    POSITION_COLUMNS,
    Layout,
    find_unknown_unit,
    number_columns,
    preview_columns,
)
from rotcal_tables.sheets.numerals import parse_measure
from rotcal_tables.sheets.words import (
    ACTUAL,
    REVERSED,
    TABLE_ANGLE,
    Heading,
    column_option,
    known_columns,
)

_LOOKED_AT: Final = 100
"""Rows among which the head of a table that cannot be understood is guessed."""
_PAIR: Final = 2
"""Columns that may be one angle and another, or a reading before and after; more are runs."""
_OFFERED: Final = 4
"""Columns of which a message names the option; a page has a button for all."""


def check_named_columns(
    path: Path, headers: Sequence[Header], named: Mapping[str, str], head: Sequence[str]
) -> None:
    """Raise ConfigurationError for a column that is not known, BagError for a heading too few."""
    ours = {TableColumn.of(name).name for header in headers for name in header}
    ours |= POSITION_COLUMNS if "position" in ours else set()
    ours |= {ACTUAL, REVERSED} if "deviation" in ours else set()
    there = {folded(part) for text in head for part in (text, *MATRIX_CORNER.split(text))}
    for name, text in named.items():
        if name not in ours.union(known_columns()):
            raise ConfigurationError(f"sheet.columns: no column {name!r}{name_hint(name, ours)}")
        numbered = text[:1] == "#" and text[1:].isdigit()
        if name in ours and folded(text) not in there and not numbered:
            raise BagError(
                f"{path}: sheet.columns: no column is called {text!r}{name_hint(text, head)}"
            )


def check_row_width(path: Path, layout: Layout) -> None:
    """Raise BagError for a text whose rows have more numbers than its head has columns.

    So it is where commas part both the columns and the digits.
    """
    rows = layout.sheet.rows
    width, below = max(len(cells) for _, cells in rows[: layout.first]), rows[layout.first :]
    wider = [row for row in below if any(map(is_number, row[1][width:]))]
    if wider and not layout.sheet.name and 2 * len(wider) >= len(below):
        number, cells = wider[0]
        found = ", ".join(map(cell_text, cells[:_OFFERED]))
        raise BagError(
            f"{path}, row {number}: {len(cells)} cells below a head of {width}, {found}: where "
            "numbers have decimal commas, part the columns by semicolons or tabs, or put the "
            "numbers in quotes"
        )


def unknown_columns_error(
    path: Path,
    headers: Sequence[Header],
    layout: Layout | None,
    grids: Sequence[Sheet],
    named: Mapping[str, str],
) -> BagError:
    """Return what is missing, the columns that may be it, and the options that say so."""
    expected = " or ".join(f"'{','.join(header)}'" for header in headers)
    sheet, row = _likely_row(grids)
    bare = (
        Layout(sheet, headers[-1], {}, aside=tuple(row.values()), missing=tuple(headers[-1]))
        if sheet
        else None
    )
    if strange := find_unknown_unit(layout or bare):
        text, unit, quantity = strange
        return BagError(
            f"{path}: {unit!r} in the heading {text!r} is an unknown unit: known for "
            f"{quantity} are {', '.join(UNITS[quantity])}: write one of these there, and convert "
            "the numbers if need be"
        )
    if layout is None:
        return _no_names(path, headers, expected, grids)
    found = ", ".join(f"{name} ({use.text!r})" for name, use in layout.uses.items())
    others = f"; not known: {', '.join(map(repr, layout.aside))}" if layout.aside else ""
    angles = layout.missing[0] == "position" and len(layout.header) == 2
    name = TABLE_ANGLE if angles else TableColumn.of(layout.missing[0]).name
    uses = [Use(place, text) for place, text in zip(layout.places, layout.head, strict=True)]
    key = not TableColumn.of(layout.missing[0]).quantity and name != TABLE_ANGLE
    numbers = [use.text for use in uses if key or preview_columns(layout, [use])]
    likely = [text for text in numbers if text in layout.aside]
    if not likely and key and layout.uses and name != "position":
        return BagError(
            f"{path}: no column {name}: found {found}: add one that says of which {name} a row is"
        )
    likely = likely or numbers
    angle, of_angles = layout.uses.get(TABLE_ANGLE), {use.text for use in layout.others}
    same = {u.text for u in layout.others if angle and u.units == angle.units}
    ours = dict.fromkeys(same, ACTUAL) if name == "deviation" else {}
    ours |= dict.fromkeys(of_angles, TABLE_ANGLE) if name == "position" else {}
    means = [(ours.get(text, name), text) for text in likely]
    ways = means[:_OFFERED] or [(name, "ITS NAME")]
    if len(same) == 1 and name == "deviation" and TABLE_ANGLE not in named:
        # the other may be the commanded one
        ways.append((TABLE_ANGLE, next(iter(same))))
    advice = [column_option(*way) for way in ways]
    runs = "; of runs, write the number and the direction at each head, as Run 1 up"
    return BagError(
        f"{path}: no column {', '.join(layout.missing)}: found {found}{others}. Expected "
        f"'{','.join(layout.header)}', in any unit and order. State a column with another name by "
        f"{' or '.join(advice)}{runs if name == 'deviation' and len(likely) > _PAIR else ''}",
        "\n".join(preview_columns(layout, uses)),
        _which_column(ways if len(ways) > len(likely) else means),
    )


def _no_names(
    path: Path, headers: Sequence[Header], expected: str, grids: Sequence[Sheet]
) -> BagError:
    """Return what to do where no heading is known: the columns, and what they would be in turn."""
    found = f"{path}: no row names the columns: expected {expected}, in any form and language: "
    sheet, row = _likely_row(grids)
    texts = list(row.values())
    plainest = min(headers, key=len)
    names = [TableColumn.of(name).name for name in plainest]
    of_angles = (
        any(quantity_of(unit) == ANGLE for unit in Heading.of(texts[0]).units) if texts else False
    )
    if names[0] == "position" and (of_angles or len(names) == 2):
        names[0] = TABLE_ANGLE
    question = _which_column([(names[0], text) for text in texts])
    if sheet is None or len(texts) < len(names):
        return BagError(f"{found}add a line of names above the numbers", question=question)
    heads = {place: Heading.of(text) for place, text in row.items()}
    units = [head.units for head in heads.values()]
    if names[1:] == ["deviation"] and () != units[0] == units[1]:
        names[1] = ACTUAL
    if len(texts) > len(names):  # one after the other
        names = names[:1]
    columns = [f"{name}={text}" for name, text in zip(names, texts, strict=False)]
    layout = Layout(sheet, plainest, {}, head=tuple(texts))
    uses = [Use(place, head.text, head.units) for place, head in heads.items()]
    return BagError(
        f"{found}say what they are, for instance by {option('sheet.columns', *columns)}",
        "\n".join(preview_columns(layout, uses)),
        question,
    )


def _which_column(means: Sequence[tuple[str, str]]) -> Question | None:
    """Return the question which texts stand at the heads of these columns of ours."""
    answers = tuple((meaning(*each), each[1]) for each in means)
    return Question("sheet.columns", answers) if answers else None


def guess_heading_row(grids: Sequence[Sheet]) -> Sequence[str]:
    """Return the longest row of words that stands over a row of numbers."""
    return list(_likely_row(grids)[1].values())


def _likely_row(grids: Sequence[Sheet]) -> tuple[Sheet | None, dict[int, str]]:
    """Return its sheet and its words by their places; None and nothing where there is no such."""
    rows = [
        (sheet, {at: cell for at, cell in enumerate(cells) if isinstance(cell, str) and cell})
        for sheet in grids
        for (_, cells), (_, below) in pairwise(sheet.rows[:_LOOKED_AT])
        if not any(map(is_number, cells)) and sum(map(is_number, below)) > 1
    ]
    bare = [
        (sheet, dict(enumerate(map(str, sheet.rows[0][1])))) for sheet in number_columns(grids)
    ]
    several = [row for row in rows if len(row[1]) > 1]
    return max(several or bare or rows, key=lambda row: len(row[1]), default=(None, {}))


def cell_text(cell: Cell) -> str:
    """Return a cell as text; a whole number of a workbook without its point."""
    if isinstance(cell, str):
        return cell
    return str(int(cell)) if cell.is_integer() else repr(cell)


def is_number(cell: Cell) -> bool:
    """Return whether a number stands in a cell, with a decimal point or comma."""
    return any(parse_measure(cell, mark) for mark in (".", ","))
