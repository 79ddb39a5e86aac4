"""Which cell of a grid is the head of which column: one value a row, or a matrix of values."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Final

from rotcal_ros.foundation.errors import ConfigurationError, UndecidedError
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.table_columns import (
    ANGLE,
    IN_BRACKETS,
    LENGTH,
    TIME,
    TableColumn,
    folded,
    meaning,
    plain,
    quantity_of,
    undecided,
)
from rotcal_ros.foundation.table_reading import Use
from rotcal_ros.foundation.tables import Header
from rotcal_tables.sheets.files import Cell, Sheet
from rotcal_tables.sheets.numerals import parse_measure
from rotcal_tables.sheets.words import (
    ACTUAL,
    DIRECTION,
    REFERENCE,
    REVERSED,
    RUN,
    SETTING,
    TABLE_ANGLE,
    Heading,
    heading_columns,
    is_commanded,
    is_direction_word,
    parse_label,
    units_of,
    units_of_quantity,
)

TEXT_COLUMNS: Final = frozenset({"kind", "tracker_station"})
"""Columns that hold words."""
POSITION_COLUMNS: Final = frozenset({TABLE_ANGLE, DIRECTION, RUN})
"""What may stand for a position, or beside it."""
DEVIATION_COLUMNS: Final = frozenset({ACTUAL, REFERENCE, REVERSED})
"""What may stand for a deviation: measured angles, or a difference of another sign."""
_ARROW: Final = re.compile(r"([↑↓←→↻↺⟳⟲])|[_/]")
_SIGNED: Final = re.compile(r"(?<!\S)([+-])(?=\d)|(?<=\w)([+-])(?!\S)")
"""A direction before the number of a run, or at the end of a word."""
_OF_ISO: Final = frozenset({"x", "e", "δ"})
"""Letters for a deviation, as x of ISO 230-2."""
_LETTER: Final = r"[\s_\-:.]+|(?<=\b[^\W\d_])(?=\d)"
"""What parts words at the head of a matrix, and the letter of X1 from its number."""
_COARSE: Final = ("deg", "gon", "dms")
"""Units of table angles rather than of deviations."""
MATRIX_CORNER: Final = re.compile(r"[\\|/]")
"""What stands in the corner of a matrix between the names of its rows and columns."""
_NO_MEASURE: Final = re.compile(r"[%‰]|\|[^|]+\|")
"""What heads a share, or absolute values, which have lost their sign."""
_NO_UNIT: Final = ("", "-", "1")
"""What stands for none in a line of units."""
_SYMBOL: Final = re.compile(
    r"[Δ∆δ]?(?:[^\W\d_]|theta|phi|alpha|beta|gamma|epsilon|delta)[\W_]*[^\W_]{0,3}[\W_]*",
    re.IGNORECASE,
)
"""A letter of any script, or the name of a Greek one, with an index."""
_WORDS: Final = 120
"""Characters by which tables side by side are told apart."""
_HIGHEST: Final = 4
"""Most rows of a head: two of names, one of units, one of symbols."""
_LOOKED_AT: Final = 100
"""Rows in which the head of a table is searched for."""
_ALL_IN: Final = re.compile(
    r"(?:units?|einheit(?:en)?|unites?|单位|單位|単位)\s*[:=]\s*(\S+)|"
    r"(?:all|alle|toutes?|tous)\b.*\b(?:in|en)\s+(\S+)",
    re.IGNORECASE,
)


class Caption(str):
    """The text at the head of a column, of one cell or of two, one above the other.

    ``cells`` are their texts, ``address`` is by what a person names the column: its text, or its
    number where no cell, or more than one, has that text.
    """

    __slots__ = ("address", "cells")
    address: str
    cells: tuple[str, ...]

    @classmethod
    def of(cls, cells: Sequence[str], place: int, *, alone: bool) -> Caption:
        """Return the caption of a column with its ``place``, from 0."""
        caption = cls(" over ".join(cells))
        caption.cells = tuple(cells)
        caption.address = caption if alone and len(cells) == 1 else f"#{place + 1}"
        return caption

    def __repr__(self) -> str:
        """Return the texts of the cells, each in quotes."""
        return " over ".join(map(repr, self.cells))


@dataclass(frozen=True, slots=True)
class MatrixCells:
    """Cells of a matrix that belong together: ``labels`` by column, and a use per value.

    The first label is what tells the columns of the matrix apart.
    """

    labels: Mapping[str, Cell]
    uses: Mapping[str, Use]
    label_use: Use


@dataclass(frozen=True)
class Layout:
    """How a grid is understood: the ``header`` of ours that its columns fill, and from where.

    ``uses`` maps names of columns, or TABLE_ANGLE, DIRECTION, RUN, to their places; ``matrix`` are
    the cells of a matrix, empty for a list. ``aside``: headings that are not needed; ``missing``:
    columns without any; ``doubled``: a column and the headings that mean it. ``first``: index of
    the first row of values, ``form`` the row of its head; ``head`` are the headings at their
    ``places``. ``others`` are the columns
    aside that measure angles. ``length_unit``: stated above the table. ``beside``: tables side by
    side that may all be meant, by their numbers.
    """

    sheet: Sheet
    header: Header
    uses: Mapping[str, Use]
    matrix: tuple[MatrixCells, ...] = ()
    aside: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    doubled: tuple[str, tuple[Use, ...]] | None = None
    first: int = 0
    head: tuple[str, ...] = ()
    places: tuple[int, ...] = ()
    length_unit: str = ""
    others: tuple[Use, ...] = ()
    form: tuple[str, ...] = ()
    beside: Mapping[str, Layout] = field(default_factory=dict)

    @property
    def rank(self) -> tuple[bool, int, int, int, int, int]:
        """How well it is understood: whole, by how many columns, how few missing and left over.

        Of equal ones that with units.
        """
        values = len(self.uses) + len({next(iter(cells.labels)) for cells in self.matrix})
        units = sum(bool(use.units) for use in self.uses.values())
        missing, aside = len(self.missing), len(self.aside)
        return not missing, values, -missing, len(self.matrix), -aside, units


def find_best_layout(
    found: Iterable[Sheet],
    headers: Sequence[Header],
    named: Mapping[str, str],
    where: str,
    table: str = "",
) -> Layout | None:
    """Return how the grids are understood best; None where no column is known in any.

    ``named`` maps columns to the headings that a person has given them, ``table`` is the number of
    one of several side by side. Raises DataError where two sheets, or tables, are understood as
    well as each other, or two headings mean the same column.
    """
    layouts = [
        layout for sheet in found for layout in [_of_sheet(sheet, headers, named, table)] if layout
    ]
    if table and not layouts:
        raise ConfigurationError(
            f"{where}: sheet.table: no table {table!r} has such columns: those side by side count "
            "from 1"
        )
    if not layouts:
        return None
    best = max(layouts, key=lambda layout: layout.rank)
    if best.beside:
        raise undecided(
            f"{where}: {len(best.beside)} tables stand side by side",
            "sheet.table",
            [(number, _first_words(layout)) for number, layout in best.beside.items()],
            [
                line
                for layout in best.beside.values()
                for line in preview_columns(layout, layout.uses.values())
            ],
        )
    if best.doubled:
        raise _rivals(where, best, *best.doubled)
    equal = [layout for layout in layouts if layout.rank == best.rank and layout.sheet.name]
    if len(equal) > 1 and not best.missing:
        names = [layout.sheet.name for layout in equal]
        raise undecided(
            f"{where}: the sheets {' and '.join(names)} have the same columns",
            "sheet.name",
            tuple(zip(names, names, strict=True)),
        )
    return best


def _rivals(where: str, layout: Layout, name: str, uses: Sequence[Use]) -> UndecidedError:
    """Return the question which of several headings is a column."""
    *most, last = [repr(use.text) for use in uses]
    return undecided(
        f"{where}: {', '.join(most)} and {last} may {'both' if len(uses) == 2 else 'all'} be the "
        f"column {name}",
        "sheet.columns",
        [(meaning(name, use.text), use.text) for use in uses],
        preview_columns(layout, uses),
    )


def preview_columns(layout: Layout, uses: Iterable[Use]) -> list[str]:
    """Return columns below each other, in the words of the file: first and largest value."""
    lines = []
    for use in uses:
        rows = layout.sheet.rows[layout.first :]
        cells = [cells[use.place] for _, cells in rows if use.place < len(cells)]
        found = [cell for cell in cells if cell_magnitude(cell) is not None]
        if found:
            largest = max(found, key=lambda cell: abs(cell_magnitude(cell) or 0.0))
            lines.append(
                f"column {use.place + 1} {use.text!r}: first {_text(found[0])}, "
                f"largest {_text(largest)}"
            )
    return lines


def cell_texts(cells: Iterable[Cell]) -> tuple[str, ...]:
    """Return the cells of a row that are not empty, as texts."""
    return tuple(str(cell) for cell in cells if cell != "")


def _first_words(layout: Layout) -> str:
    """Return what stands above the values of a table, its title among it."""
    rows = layout.sheet.rows[: layout.first]
    return ", ".join(text for _, cells in rows for text in cell_texts(cells))[:_WORDS]


def number_columns(sheets: Iterable[Sheet], named: Collection[str] = ()) -> list[Sheet]:
    """Return those sheets that are columns of numbers without names, below #1, #2 and so on.

    Texts may stand in other columns than those ``named`` by #1, #2 alone.
    """
    found, places = [], [_place(text) for text in named]
    for sheet in sheets:
        rows = [row for row in sheet.rows if len(cell_texts(row[1])) > 1]  # without titles
        width = max((len(cells) for _, cells in rows), default=0)
        cells = [cell for _, cells in rows for cell in cells if cell != ""]
        first = [cell_magnitude(cell) for _, row in rows[:1] for cell in row]
        stated = len(places) > 1 and all(0 <= k < len(first) and first[k] is not None
                                         for k in places)  # fmt: skip
        if width and (stated or all(cell_magnitude(cell) is not None for cell in cells)):
            head = tuple(f"#{place + 1}" for place in range(width))
            found.append(replace(sheet, rows=((0, head), *rows)))
    return found


def upright_sheet(sheet: Sheet) -> Sheet:
    """Return a sheet whose rows are columns of ours, each with its name in front, turned."""
    rows = [cells for _, cells in sheet.rows]
    names = [heading_columns(Heading.of(_text(cells[0]))) for cells in rows if cells[0]]
    numbers = [cell_magnitude(cell) is not None for cells in rows for cell in cells[1:]]
    if not (1 < len(rows) == len(names) and all(names) and len(numbers) > 2 and all(numbers)):
        return sheet
    return replace(sheet, rows=tuple(enumerate(zip(*rows, strict=True), start=1)))


def cell_magnitude(cell: Cell) -> float | None:
    """Return the size of what stands in a cell, in whatever unit; None for words."""
    for mark in (".", ","):
        if measure := parse_measure(cell, mark, ANGLE):
            return float(measure.value)
    return None


def _of_sheet(
    sheet: Sheet, headers: Sequence[Header], named: Mapping[str, str], table: str
) -> Layout | None:
    """Return the layout of a sheet, or of the one of several tables side by side that fits."""
    whole = None if table else _of_rows(sheet, headers, named)
    if whole and not whole.missing and not whole.doubled:
        return whole
    found = {
        str(number): layout
        for number, part in enumerate(_apart(sheet), start=1)
        if table in ("", str(number)) and (layout := _of_rows(part, headers, named))
        and (table or not (layout.missing or layout.doubled))
    }  # fmt: skip
    first = next(iter(found.values()), None)
    if first is None:
        return whole
    head = next(n for n, cells in first.sheet.rows if cell_texts(cells) == first.form)
    form = cell_texts(dict(sheet.rows)[head])
    return replace(first, form=form, beside=found if len(found) > 1 else {})


def _apart(sheet: Sheet) -> list[Sheet]:
    """Return the tables side by side on a sheet: of columns between those without any cell.

    Rows without numbers, as titles, may go over all of them.
    """
    rows = [
        cells for _, cells in sheet.rows if any(cell_magnitude(cell) is not None for cell in cells)
    ]
    filled = {place for cells in rows for place, cell in enumerate(cells) if cell != ""}
    starts = [p for p in sorted(filled) if p - 1 not in filled]
    ends = [p for p in sorted(filled) if p + 1 not in filled]
    tables = []
    for a, b in zip(starts, ends, strict=True):
        inside = [
            (n, ("",) * a + cells[a : b + 1]) for n, cells in sheet.rows if any(cells[a : b + 1])
        ]
        form = phrase("{0}, columns {1} to {2}", sheet.form, a + 1, b + 1)
        tables.append(replace(sheet, form=form, rows=tuple(inside)))
    return tables


def _of_rows(sheet: Sheet, headers: Sequence[Header], named: Mapping[str, str]) -> Layout | None:
    """Return the layout of the row that has most of the columns, the first of such rows."""
    best: Layout | None = None
    for row in range(min(len(sheet.rows), _LOOKED_AT)):
        for heads, below in _heads(sheet, row):
            if len(heads) < 2 or not _above_numbers(sheet, row + below, named):
                continue
            for header in headers:
                layout = _of_heads(sheet, header, heads, named)
                if layout and (best is None or layout.rank > best.rank):
                    best = replace(layout, first=row + below, form=cell_texts(sheet.rows[row][1]))
    if best is None:
        return None
    return replace(best, length_unit=_stated_unit(sheet, best.first))


def _place(text: str) -> int:
    """Return the place, from 0, of a column that a person named by #1, #2; -1 for another."""
    return int(text[1:]) - 1 if re.fullmatch(r"#\d{1,4}", text) else -1


def _above_numbers(sheet: Sheet, first: int, named: Mapping[str, str]) -> bool:
    """Return whether columns that a person named by #1, #2 have a number in a row."""
    cells = dict(enumerate(sheet.rows[first][1])) if first < len(sheet.rows) else {}
    places = [place for text in named.values() if (place := _place(text)) >= 0]
    return not places or any(cell_magnitude(cells.get(place, "")) is not None for place in places)


def _heads(sheet: Sheet, row: int) -> Iterator[tuple[dict[int, Heading], int]]:
    """Yield the headings of a row by place, with the number of rows that they take.

    Alone, and as the first of two rows, as in merged cells, where the second says more than units
    and symbols. Without the first it may be where that leaves no column below it without heading.
    """
    rows = [cells for _, cells in sheet.rows[row : row + _HIGHEST]]
    texts = {place: (_text(cell),) for place, cell in enumerate(rows[0]) if cell != ""}
    heads = {place: Heading.of(text) for place, (text,) in texts.items()}
    below = rows[1] if len(rows) > 1 else ()
    second = {place: _text(cell) for place, cell in enumerate(below) if cell != ""}
    more = bool(second) and not (_units_in(below) or _are_symbols(below, texts))
    numbers = [place for place, cell in enumerate(below) if cell_magnitude(cell) is not None]
    ways = [text for place, text in second.items() if place not in numbers]
    numbered = heads and len(below) > min(heads) and below[min(heads)] == ""  # runs below ways
    two = heads and more and (numbered or not numbers)
    wider = not numbers and second.keys() - texts.keys()
    if not (two and (wider or (ways and all(map(is_direction_word, ways))))):
        yield _with_units(heads, texts, rows, 1)
    if two:
        above, joined, both = -1, dict[int, Heading](), dict[int, tuple[str, ...]]()
        for place in range(len(below)):
            above = place if place in heads else above
            text = second.get(place, "")
            alone = units_of(text.strip("[]() "))
            own = Heading(text, "", alone) if alone else Heading.of(text)
            upper = heads.get(above, Heading(""))
            both[place] = tuple(part.text for part in (upper, own) if part.text)
            joined[place] = Heading(
                "", f"{upper.name} {own.name}".strip(), own.units or upper.units
            )
        joined = {place: head for place, head in joined.items() if both[place]}
        yield _with_units(joined, both, rows, 2)


def _with_units(
    heads: Mapping[int, Heading],
    texts: Mapping[int, tuple[str, ...]],
    rows: Sequence[Sequence[Cell]],
    taken: int,
) -> tuple[dict[int, Heading], int]:
    """Return headings with the units of the rows below, and how many rows all of that takes."""
    units = dict[int, tuple[str, ...]]()
    for cells in rows[taken:]:
        found = _units_in(cells)
        if (found and units) or not (found or _are_symbols(cells, texts)):
            break
        units, taken = units or found, taken + 1
    counts = Counter(folded(" ".join(texts[place])) for place in heads)
    return {
        place: replace(
            head,
            text=Caption.of(
                texts[place], place, alone=counts[folded(" ".join(texts[place]))] == 1
            ),
            units=units.get(place, head.units),
        )
        for place, head in heads.items()
    }, taken


def _units_in(cells: Sequence[Cell]) -> dict[int, tuple[str, ...]]:
    """Return the units in a row of nothing else by their places; none for any other row."""
    bare = [cell.strip("[]() ") if isinstance(cell, str) else "" for cell in cells]
    units = {place: units_of(text) for place, text in enumerate(bare) if text not in _NO_UNIT}
    return units if all(units.values()) else {}


def _are_symbols(cells: Sequence[Cell], above: Mapping[int, tuple[str, ...]]) -> bool:
    """Return whether a row holds nothing but symbols, as x, P_i, Δα, below different headings."""
    found = {place: str(cell) for place, cell in enumerate(cells) if cell != ""}
    own = [above.get(place) for place in found]
    return bool(found) and len({*own} - {None}) == len(found) and all(
        _SYMBOL.fullmatch(text) and not is_direction_word(text) for text in found.values()
    )  # fmt: skip


def _of_heads(
    sheet: Sheet,
    header: Header,
    heads: Mapping[int, Heading],
    named: Mapping[str, str],
) -> Layout | None:
    columns = [TableColumn.of(name) for name in header]
    wanted = {column.name: column for column in columns}
    uses, rivals = dict[str, Use](), dict[str, list[Use]]()
    others = {place: head for place, head in heads.items() if place != min(heads)}
    alone = not any(_meant(head, place, wanted, named) for place, head in others.items())
    corner = _corner(heads, wanted, named) if alone else None
    signed = _with_both_signs(heads)
    for place, head in (others if corner else heads).items():
        meant = [] if place in signed else _meant(head, place, wanted, named)
        name = next((name for name in meant if name not in uses), "")
        measures = wanted[name].quantity if name in wanted else ANGLE
        use = Use(place, head.text, units_of_quantity(head.units, measures))
        if name:
            uses[name] = use
        elif meant and meant[0] not in (DIRECTION, RUN):
            rivals.setdefault(meant[0], [uses[meant[0]]]).append(use)
    if corner:
        uses[corner.name] = Use(min(heads), heads[min(heads)].text)
    uses = _with_roles(uses, wanted, named)
    rivals = {name: found for name, found in rivals.items() if name in {*uses, *wanted}}
    left = {
        place: h for place, h in heads.items() if place not in {u.place for u in uses.values()}
    }
    missing = [c for c in columns if c.name not in uses and not _otherwise(c, uses)]
    alike = {heads[min(heads)].units, *(head.units for head in others.values())} - {()}
    units = heads[min(heads)].units if min(heads) in left and len(alike) < 2 else ()
    matrix = _matrix(missing, left, columns, uses, corner.units if corner else units)
    if matrix:
        missing = []
        taken = {use.place for cells in matrix for use in cells.uses.values()}
        left = {place: head for place, head in left.items() if place not in taken}
        of_runs = TABLE_ANGLE in matrix[0].labels and RUN not in uses
        if of_runs and min(left, default=-1) == min(heads):
            uses[RUN] = Use(min(heads), left.pop(min(heads)).text)  # of the rows, if they say so
    elif not uses:
        return None
    return Layout(
        sheet,
        header,
        uses,
        tuple(matrix),
        aside=tuple(head.text for head in left.values()),
        missing=tuple(column.header for column in missing),
        others=tuple(
            Use(place, head.text, head.units)
            for place, head in left.items()
            if len(head.units) == 1 and quantity_of(head.units[0]) == ANGLE
        ),
        doubled=next(((name, tuple(found)) for name, found in rivals.items()), None),
        head=tuple(head.text for head in heads.values()),
        places=tuple(heads),
    )


def _with_both_signs(heads: Mapping[int, Heading]) -> list[int]:
    """Return the places of headings that differ in a + or - alone, or in arrows."""
    bare = {p: re.sub(r"[+\-↑↓←→\s]", "", head.name) for p, head in heads.items()}
    count = Counter(bare.values())
    return [p for p, text in bare.items() if text != heads[p].name and count[text] > 1]


def _with_roles(
    uses: dict[str, Use], wanted: Mapping[str, TableColumn], named: Mapping[str, str]
) -> dict[str, Use]:
    """Return the uses with commanded and measured angles in the place of what they stand for.

    A column of reference angles is the measured one beside a commanded one, and the commanded
    one beside a measured one. Where no deviation is wanted, measured angles are those of the
    table if no others are.
    """
    reference = uses.pop(REFERENCE, None)
    angle = uses.get(TABLE_ANGLE)
    if reference and ACTUAL in uses and angle is None:
        angle = uses[TABLE_ANGLE] = reference
    elif reference and ACTUAL not in uses and (angle is None or is_commanded(angle.text)):
        uses[ACTUAL] = reference
    elif reference and angle and "deviation" in uses:
        uses[ACTUAL] = reference  # only to be checked
    if "deviation" in wanted:
        if ACTUAL in named and "deviation" not in named:
            uses.pop("deviation", None)
        if "deviation" in named:
            uses.pop(ACTUAL, None)
        return uses
    measured = uses.pop(ACTUAL, None)
    if measured and angle is None and "position" in wanted:
        uses[TABLE_ANGLE] = measured
    return {name: use for name, use in uses.items() if name not in DEVIATION_COLUMNS}


def _otherwise(column: TableColumn, uses: Mapping[str, Use]) -> bool:
    """Return whether other columns stand for one."""
    if column.name == "deviation":
        return TABLE_ANGLE in uses and not uses.keys().isdisjoint(DEVIATION_COLUMNS)
    return column.name == "position" and TABLE_ANGLE in uses


def _meant(
    head: Heading, place: int, wanted: Mapping[str, TableColumn], named: Mapping[str, str]
) -> list[str]:
    """Return which of the wanted columns, or of those beside them, a heading means."""
    chosen = [n for n, text in named.items()
              if text == f"#{place + 1}" or folded(text) == folded(head.text)]  # fmt: skip
    beside = (POSITION_COLUMNS if "position" in wanted else frozenset()) | (
        DEVIATION_COLUMNS if wanted.keys() & {"deviation", "position"} else frozenset()
    )
    if chosen:
        return [name for name in chosen if name in wanted or name in beside]
    if _NO_MEASURE.search(head.text):
        return []
    quantities = {quantity_of(unit) for unit in head.units}
    own = [
        name
        for name, column in wanted.items()
        if folded(name) == folded(head.name) and (not quantities or column.quantity in quantities)
    ]
    known = [name for name in (*own, *heading_columns(head)) if name not in named]
    if "deviation" not in wanted and "target" in known and not head.units:
        known = ["target"]
    if "ball" in known:
        known.append("ball_step")
    return [name for name in known if name in wanted or name in beside]


def find_unknown_unit(layout: Layout | None) -> tuple[str, str, str] | None:
    """Return heading, unit and quantity of a missing column that has no unit of its quantity."""
    if layout is None:
        return None
    wanted = {column.name: column for column in map(TableColumn.of, layout.missing)}
    for text in layout.aside:
        if found := IN_BRACKETS.fullmatch(plain(text)):
            for name in _meant(Heading(text, found[1]), -1, wanted, {}):
                quantity = wanted[name].quantity if name in wanted else ANGLE
                known = {quantity_of(unit) for unit in units_of(found[2])}
                if quantity and quantity not in known and name not in (DIRECTION, RUN):
                    return text, found[2], quantity
    return None


def _corner(
    heads: Mapping[int, Heading],
    wanted: Mapping[str, TableColumn],
    named: Mapping[str, str],
) -> Heading | None:
    """Return what the rows of a matrix are, where its first cell names rows and columns.

    As in Target / Angle [deg]; with the unit of the columns' labels if these are angles.
    """
    first = heads[min(heads)]
    rows, apart, across = MATRIX_CORNER.sub("/", first.name).partition("/")
    names = _meant(Heading(rows, rows.strip()), -1, wanted, named) if apart else []
    if not names:
        return None
    angles = TABLE_ANGLE in heading_columns(Heading(across, across.strip(), first.units))
    return Heading(first.text, names[0], first.units if angles else ())


def _matrix(
    missing: Sequence[TableColumn],
    left: Mapping[int, Heading],
    columns: Sequence[TableColumn],
    uses: Mapping[str, Use],
    label_units: tuple[str, ...],
) -> list[MatrixCells]:
    """Return the cells of a matrix: one key and all values are missing, their heads are labels.

    A label is any word with a number, the same word for all, or a table angle; a direction may
    stand beside it. Where no key is missing, it is the run. ``label_units``: of labels that are
    table angles.
    """
    names = {column.name for column in columns}
    keys = [
        column.name
        for column in missing
        if not column.quantity and column.name not in TEXT_COLUMNS
    ]
    values = [column for column in missing if column.quantity not in ("", TIME)]
    if not keys and "position" in names:
        keys = [DIRECTION if RUN in uses else RUN]
    if len(keys) != 1 or not values:
        return []
    measured = {column.name for column in columns if column.quantity not in ("", TIME)}
    if {c.name for c in missing} - {*keys} != measured or measured != {c.name for c in values}:
        return []
    kinds = {ACTUAL: ANGLE, **{value.name: value.quantity for value in values}}
    words = dict[str, dict[tuple[object, int], tuple[dict[str, Cell], dict[str, Use]]]]()
    for place, head in left.items():
        name, text = _value_of(head, values)
        word, labels = _labels(text, keys[0], label_units or head.units, values, head.units)
        if not (name and labels):
            continue
        units = units_of_quantity(head.units, kinds[name])
        own = () if " " in str(labels.get(TABLE_ANGLE, "")) else units
        if any(quantity_of(unit) != kinds[name] for unit in own):
            continue
        groups, key = words.setdefault(folded(word), {}), tuple(labels.items())
        name = (
            ACTUAL
            if name == "deviation" and ACTUAL in heading_columns(Heading(word, word))
            else name
        )
        time = sum(name in found for (other, _), (_, found) in groups.items() if other == key)
        again: dict[str, Cell] = {RUN: float(time)} if keys[0] == RUN and RUN not in labels else {}
        of_label = groups.setdefault((key, time), (labels | again, {}))[1]
        of_label[name] = Use(place, head.text, own)
    found = {
        word: [MatrixCells(labels, of, Use(-1, next(iter(of.values())).text))
               for labels, of in groups.values() if len(of) == len(values)]
        for word, groups in words.items()
    }  # fmt: skip
    whole = {
        word: cells
        for word, cells in found.items()
        if len(cells) > 1 and (uses or all(DIRECTION in each.labels for each in cells))
        and _may_be(keys[0], word)
    }  # fmt: skip
    known = {
        w: c for w, c in whole.items() if keys[0] in heading_columns(Heading(w, w)) or len(w) < 2
    }
    return next(iter(whole.values())) if len(whole) == 1 else _only(known)


def _may_be(key: str, word: str) -> bool:
    """Return whether a word at the head of a matrix may name the key: a run is no setting."""
    named = {RUN, SETTING}.intersection(heading_columns(Heading(word, word)))
    return key in named or not named


def _only(words: Mapping[str, list[MatrixCells]]) -> list[MatrixCells]:
    return next(iter(words.values())) if len(words) == 1 else []


def _value_of(head: Heading, values: Sequence[TableColumn]) -> tuple[str, str]:
    """Return which of the values the head of a matrix's column names, and the label beside it."""
    if len(values) == 1:  # Run 1 up deviation
        parts = head.name.split()
        left = [
            part for part in parts if values[0].name not in heading_columns(Heading(part, part))
        ]
        label = " ".join(left)
        says = any(map(str.isalpha, label)) and any(map(str.isdigit, label))
        return values[0].name, label if says else head.name
    words = [word for word in re.split(_LETTER, head.name) if word]
    found = [word for word in words if any(folded(word) == value.name for value in values)]
    rest = " ".join(word for word in words if word not in found)
    return (folded(found[0]), rest) if len(found) == 1 else ("", "")


def _labels(
    text: str,
    key: str,
    units: Sequence[str],
    values: Sequence[TableColumn],
    head_units: Sequence[str] = (),
) -> tuple[str, dict[str, Cell]]:
    """Return the word of a label, and what it says by column; nothing where it says nothing.

    That is a number behind any word, or a table angle, and perhaps a direction.
    """
    if key == RUN:
        text = _SIGNED.sub(r" \1\2 ", text)
    parts = [part.strip("()[],;") for part in _ARROW.sub(r" \1 ", text).split()]
    way, rest = dict[str, Cell](), " ".join(parts)
    spans = [
        slice(i, j)
        for i, j in combinations(range(len(parts) + 1), 2)
        if is_direction_word(" ".join(parts[i:j])) and not parts[j - 1][-1:].isdigit()
    ]
    longest = max(spans, key=lambda span: span.stop - span.start, default=slice(0, 0))
    if spans and all(longest.start <= s.start and s.stop <= longest.stop for s in spans):
        way = {DIRECTION: " ".join(parts[longest])}
        rest = " ".join([*parts[: longest.start], *parts[longest.stop :]])
    bare = rest.rstrip("°").strip()
    if key == "position" and cell_magnitude(bare) is not None:
        angles = [unit for unit in units if quantity_of(unit) == ANGLE]
        theirs = angles and (values[0].quantity != ANGLE or angles[0] in _COARSE)
        unit = "°" if bare != rest else f" {angles[0]}" if theirs else ""
        small = head_units and head_units[0] not in _COARSE and values[0].quantity == ANGLE
        if unit or ((way or values[0].name == "deviation") and not small):
            return "", {TABLE_ANGLE: f"{bare}{unit}", **way}
    nothing_else = rest in {"", *_OF_ISO} or "deviation" in heading_columns(Heading(rest, rest))
    if way and nothing_else and key in (DIRECTION, RUN):
        return rest, way
    found = parse_label(rest)
    if not found or (key == "position" and values[0].name == "deviation"):
        return "", {}  # positions without angles have no deviations
    if not way and is_direction_word(found[0]):  # up1
        return "", {key: float(found[1]), DIRECTION: found[0]}
    return found[0], {key: float(found[1]), **way}


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
