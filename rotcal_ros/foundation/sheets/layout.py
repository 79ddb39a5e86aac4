"""Which cell of a grid is the head of which column: one value a row, or a matrix of values."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from rotcal_ros.foundation.errors import DataError, Question
from rotcal_ros.foundation.sheets.files import Cell, Sheet
from rotcal_ros.foundation.sheets.words import (
    ANGLE,
    DIRECTION,
    IN_BRACKETS,
    LENGTH,
    RUN,
    TABLE_ANGLE,
    TIME,
    Heading,
    answer,
    columns_of,
    folded,
    label_of,
    plain,
    quantity_of,
    units_of,
)
from rotcal_ros.foundation.tables import Header

_SUFFIXES: Final = {"_m": LENGTH, "_rad": ANGLE, "_s": TIME}
TEXTS: Final = frozenset({"kind", "tracker_station"})
"""Columns that hold words."""
BESIDE: Final = frozenset({TABLE_ANGLE, DIRECTION, RUN})
"""What may stand for a position, or beside it."""
CORNER: Final = re.compile(r"[\\|/]")
"""What stands in the corner of a matrix between the names of its rows and columns."""
_NO_UNIT: Final = ("", "-", "1")
"""What stands for none in a line of units."""
_LOOKED_AT: Final = 100
"""Rows in which the head of a table is searched for."""
_ALL_IN: Final = re.compile(
    r"(?:units?|einheit(?:en)?|unites?|单位|單位|単位)\s*[:=]\s*(\S+)|"
    r"(?:all|alle|toutes?|tous)\b.*\b(?:in|en)\s+(\S+)",
    re.IGNORECASE,
)


@dataclass(frozen=True, slots=True)
class TableColumn:
    """A column of ours: ``name`` without unit, what it measures; empty: a number or a text."""

    header: str
    name: str
    quantity: str

    @classmethod
    def of(cls, header: str) -> TableColumn:
        """Return the column with the name ``header``, as length_m."""
        suffix = next((suffix for suffix in _SUFFIXES if header.endswith(suffix)), "")
        return cls(header, header.removesuffix(suffix), _SUFFIXES.get(suffix, ""))


@dataclass(frozen=True, slots=True)
class Use:
    """Where a column is: ``place`` of its cell in a row, from 0, and the units of its heading."""

    place: int
    text: str
    units: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Cells:
    """Cells of a matrix that belong together: a ``label`` of ``column``, and a use per value."""

    column: str
    label: Cell
    uses: Mapping[str, Use]


@dataclass(frozen=True)
class Layout:
    """How a grid is understood: the ``header`` of ours that its columns fill, and from where.

    ``uses`` maps names of columns, or TABLE_ANGLE, DIRECTION, RUN, to their places; ``matrix`` are
    the cells of a matrix, empty for a list. ``aside``: headings that are not needed; ``missing``:
    columns without any; ``doubled``: a column and two headings that mean it. ``first``: index of
    the first row of values. ``length_unit``: stated above the table.
    """

    sheet: Sheet
    header: Header
    uses: Mapping[str, Use]
    matrix: tuple[Cells, ...] = ()
    aside: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    doubled: tuple[str, str, str] | None = None
    first: int = 0
    head: tuple[str, ...] = ()
    length_unit: str = ""

    @property
    def rank(self) -> tuple[bool, int, int, int, int]:
        """How well it is understood: whole, by how many columns, how few missing and left over.

        Of equal ones that with units.
        """
        values = len(self.uses) + len({cells.column for cells in self.matrix})
        units = sum(bool(use.units) for use in self.uses.values())
        return not self.missing, values, -len(self.missing), -len(self.aside), units


def best_layout(
    found: Iterable[Sheet], headers: Sequence[Header], named: Mapping[str, str], where: str
) -> Layout | None:
    """Return how the grids are understood best; None where no column is known in any.

    ``named`` maps columns to the headings that a person has given them. Raises DataError where two
    sheets are understood as well as each other, or two headings mean the same column.
    """
    layouts = [
        layout for sheet in found for layout in [_of_sheet(sheet, headers, named)] if layout
    ]
    if not layouts:
        return None
    best = max(layouts, key=lambda layout: layout.rank)
    if best.doubled:
        name, *texts = best.doubled
        raise DataError(
            f"{where}: {texts[0]!r} and {texts[1]!r} may both be the column {name}: say which: "
            f"{answer(name, texts[0])} or {answer(name, texts[1])}",
            question=Question("sheet.columns", tuple((f"{name}={t}", t) for t in texts)),
        )
    equal = [layout for layout in layouts if layout.rank == best.rank and layout.sheet.name]
    if len(equal) > 1 and not best.missing:
        sheets = " and ".join(layout.sheet.name for layout in equal)
        raise DataError(
            f"{where}: the sheets {sheets} have the same columns: say which to read: "
            f"--set sheet.name={equal[0].sheet.name}",
            question=Question("sheet.name", tuple((n.sheet.name, n.sheet.name) for n in equal)),
        )
    return best


def _of_sheet(sheet: Sheet, headers: Sequence[Header], named: Mapping[str, str]) -> Layout | None:
    """Return the layout of the row that has most of the columns, the first of such rows."""
    best: Layout | None = None
    for row in range(min(len(sheet.rows), _LOOKED_AT)):
        for heads, below in _heads(sheet, row):
            if len(heads) < 2:
                continue
            for header in headers:
                layout = _of_heads(sheet, header, heads, named)
                if layout and (best is None or layout.rank > best.rank):
                    best = replace(layout, first=row + below)
    if best is None:
        return None
    return replace(best, length_unit=_stated_unit(sheet, best.first))


def _heads(sheet: Sheet, row: int) -> Iterator[tuple[dict[int, Heading], int]]:
    """Yield the headings of a row by place, with the number of rows that they take.

    Alone, with the units of the row below, and as the second of two rows, as in merged cells.
    """
    cells = sheet.rows[row][1]
    heads = {place: Heading.of(_text(cell)) for place, cell in enumerate(cells) if cell != ""}
    below = sheet.rows[row + 1][1] if row + 1 < len(sheet.rows) else ()
    bare = [cell.strip("[]() ") if isinstance(cell, str) else "" for cell in below]
    units = {place: units_of(text) for place, text in enumerate(bare) if text not in _NO_UNIT}
    if units and all(units.values()):
        for place, found in units.items():
            if place in heads:
                heads[place] = replace(heads[place], units=found)
        yield heads, 2
        return
    yield heads, 1
    second = [_text(cell) for cell in below]
    if heads and second and all(isinstance(cell, str) for cell in below):
        filled, joined = "", dict[int, Heading]()
        for place, text in enumerate(second):
            filled = _text(cells[place]) or filled if place < len(cells) else filled
            joined[place] = Heading.of(f"{filled} {text}".strip())
        yield {place: head for place, head in joined.items() if head.text}, 2


def _of_heads(
    sheet: Sheet,
    header: Header,
    heads: Mapping[int, Heading],
    named: Mapping[str, str],
) -> Layout | None:
    columns = [TableColumn.of(name) for name in header]
    wanted = {column.name: column for column in columns}
    uses, doubled = dict[str, Use](), None
    for place, head in heads.items():
        meant = _meant(head, wanted, named)
        name = next((name for name in meant if name not in uses), "")
        if name:
            uses[name] = Use(place, head.text, head.units)
        elif meant and meant[0] not in (DIRECTION, RUN):
            doubled = doubled or (meant[0], uses[meant[0]].text, head.text)
    corner = None if uses else _corner(heads, wanted, named)
    if corner:
        uses[corner.name] = Use(min(heads), heads[min(heads)].text)
    if not uses:
        return None
    missing = [c for c in columns if c.name not in uses and not _by_angle(c, uses)]
    left = {
        place: h for place, h in heads.items() if place not in {u.place for u in uses.values()}
    }
    matrix = _matrix(missing, left, columns, corner.units if corner else ())
    if matrix:
        missing = []
        taken = {use.place for cells in matrix for use in cells.uses.values()}
        left = {place: head for place, head in left.items() if place not in taken}
    return Layout(
        sheet,
        header,
        uses,
        tuple(matrix),
        aside=tuple(head.text for head in left.values()),
        missing=tuple(column.header for column in missing),
        doubled=doubled,
        head=tuple(head.text for head in heads.values()),
    )


def _by_angle(column: TableColumn, uses: Mapping[str, Use]) -> bool:
    return column.name == "position" and TABLE_ANGLE in uses


def _meant(
    head: Heading, wanted: Mapping[str, TableColumn], named: Mapping[str, str]
) -> list[str]:
    """Return which of the wanted columns, or of those beside a position, a heading means."""
    chosen = [name for name, text in named.items() if folded(text) == folded(head.text)]
    if chosen:
        return [name for name in chosen if name in wanted or name in BESIDE]
    quantities = {quantity_of(unit) for unit in head.units}
    own = [
        name
        for name, column in wanted.items()
        if folded(name) == folded(head.name) and (not quantities or column.quantity in quantities)
    ]
    known = [name for name in (*own, *columns_of(head)) if name not in named]
    if "ball" in known:
        known.append("ball_step")
    beside = BESIDE if "position" in wanted else ()
    return [name for name in known if name in wanted or name in beside]


def strange_unit(layout: Layout) -> tuple[str, str, str] | None:
    """Return heading, unit and quantity of a missing column that has no unit of its quantity."""
    wanted = {column.name: column for column in map(TableColumn.of, layout.missing)}
    for text in layout.aside:
        if found := IN_BRACKETS.fullmatch(plain(text)):
            for name in _meant(Heading(text, found[1]), wanted, {}):
                quantity = wanted[name].quantity if name in wanted else ANGLE
                if quantity and name not in (DIRECTION, RUN):
                    return text, found[2], quantity
    return None


def _corner(
    heads: Mapping[int, Heading], wanted: Mapping[str, TableColumn], named: Mapping[str, str]
) -> Heading | None:
    """Return what the rows of a matrix are, where its first cell names rows and columns.

    As in Target / Angle [deg]; with the unit of the columns' labels if these are angles.
    """
    first = heads[min(heads)]
    rows, apart, across = CORNER.sub("/", first.name).partition("/")
    names = _meant(Heading(rows, rows.strip()), wanted, named) if apart else []
    if not names:
        return None
    angles = TABLE_ANGLE in columns_of(Heading(across, across.strip(), first.units))
    return Heading(first.text, names[0], first.units if angles else ())


def _matrix(
    missing: Sequence[TableColumn],
    left: Mapping[int, Heading],
    columns: Sequence[TableColumn],
    label_units: tuple[str, ...],
) -> list[Cells]:
    """Return the cells of a matrix: one key and all values are missing, their heads are labels.

    ``label_units``: of labels that are table angles.
    """
    keys = [column for column in missing if not column.quantity and column.name not in TEXTS]
    values = [column for column in missing if column.quantity not in ("", TIME)]
    if len(keys) != 1 or len(values) + 1 != len(missing) or not values:
        return []
    if {c.name for c in values} != {c.name for c in columns if c.quantity not in ("", TIME)}:
        return []
    key, groups = keys[0], dict[tuple[Cell, int], dict[str, Use]]()
    for place, head in left.items():
        name, text = _value_of(head, values)
        units = label_units or tuple(u for u in head.units if quantity_of(u) == ANGLE)
        if units and name and key.name == "position":
            label: Cell | None = f"{text.rstrip('°')} {units[0]}"
        else:
            label = _label(text, key.name, values) if name else None
        if label is not None:
            of_value = () if units else head.units
            time = sum(name in uses for (other, _), uses in groups.items() if other == label)
            groups.setdefault((label, time), {})[name] = Use(place, head.text, of_value)
    whole = [(label, uses) for (label, _), uses in groups.items() if len(uses) == len(values)]
    return [Cells(key.name, label, uses) for label, uses in whole] if len(whole) > 1 else []


def _value_of(head: Heading, values: Sequence[TableColumn]) -> tuple[str, str]:
    """Return which of the values the head of a matrix's column names, and the label beside it."""
    if len(values) == 1:
        return values[0].name, head.name
    words = [word for word in re.split(r"[\s_\-:.]+", head.name) if word]
    found = [word for word in words if any(folded(word) == value.name for value in values)]
    rest = " ".join(word for word in words if word not in found)
    return (folded(found[0]), rest) if len(found) == 1 else ("", "")


def _label(text: str, key: str, values: Sequence[TableColumn]) -> Cell | None:
    """Return the label of a target, ball or position at the head of a matrix's column.

    A number, alone or behind a word for it; a table angle is a text with its unit.
    """
    found = label_of(text)
    if found is None:
        angle = text.strip().endswith("°") and key == "position"
        return text.strip() if angle else None
    word, number = found
    names = columns_of(Heading(word, word))
    meant = {key, *(value.name for value in values)} | ({"ball"} if key == "ball_step" else set())
    if len(word) <= 1 or meant.intersection(names):
        return float(number)
    return None


def _stated_unit(sheet: Sheet, before: int) -> str:
    """Return the unit of length that a line above the table states for all of it."""
    for _, cells in sheet.rows[:before]:
        texts = [cell for cell in cells if isinstance(cell, str) and cell]
        found = _ALL_IN.search(" ".join(texts)) if len(texts) <= 2 else None
        units = units_of((found[1] or found[2]).strip("[]().,;")) if found else ()
        if len(units) == 1 and quantity_of(units[0]) == LENGTH:
            return units[0]
    return ""


def _text(cell: Cell) -> str:
    return cell if isinstance(cell, str) else f"{cell:g}"
