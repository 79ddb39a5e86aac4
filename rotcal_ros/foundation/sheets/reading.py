"""The plain table that a method reads, made of whatever table of numbers somebody has.

Every value becomes a text in metres or seconds, every number counts from 0; the reader of the
method then checks it as one of our own tables.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import pi, remainder
from pathlib import Path
from typing import Final, TypeAlias

from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError, Question
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.plugins import nearest
from rotcal_ros.foundation.settings import expert, setting
from rotcal_ros.foundation.sheets.files import Cell, Sheet, sheets
from rotcal_ros.foundation.sheets.layout import (
    BESIDE,
    CORNER,
    TEXTS,
    Layout,
    TableColumn,
    Use,
    best_layout,
    strange_unit,
)
from rotcal_ros.foundation.sheets.numerals import Measure, decimal_marks, in_si, parse
from rotcal_ros.foundation.sheets.passes import Halt, Pass, closed, is_repeated, passes
from rotcal_ros.foundation.sheets.words import (
    ANGLE,
    DIRECTION,
    LENGTH,
    RUN,
    SMALL_ANGLES,
    TABLE_ANGLE,
    TIME,
    UNITS,
    Heading,
    answer,
    columns_of,
    folded,
    is_down,
    is_nothing,
    is_summary,
    kind_of,
    known_columns,
    label_of,
)
from rotcal_ros.foundation.tables import Header, Table, own_table
from rotcal_ros.foundation.units import DEGREE

UNIT_SETTINGS: Final = {LENGTH: "length_unit", ANGLE: "angle_unit", TIME: "time_unit"}
"""Quantity -> the setting of its unit, for columns that state none."""
_LOOKED_AT: Final = 100
"""Rows among which the head of a table that cannot be understood is guessed."""
_Row: TypeAlias = "tuple[int, Mapping[str, tuple[Cell, Use]]]"
"""Its number, and its cells by column."""
_NO_KEYS: Final = frozenset({"position", "segment"})
"""Columns of numbers that do not identify what was measured."""
_NEAR: Final = 0.25
"""Share of the smallest step of the table within which an angle is the planned one."""
_SAME_ANGLE: Final = 1e-9
"""Radians by which two readings of the same angle may differ."""


@dataclass(frozen=True)
class SheetSettings:
    """How a table of numbers is read, where the table does not say so itself."""

    length_unit: str = setting(
        "", doc="unit of lengths whose column states none", choices=("", *UNITS[LENGTH])
    )
    angle_unit: str = setting(
        "", doc="unit of angles whose column states none", choices=("", *UNITS[ANGLE])
    )
    time_unit: str = expert(
        "", doc="unit of times whose column states none", choices=("", *UNITS[TIME])
    )
    decimal: str = expert(
        "", doc="decimal mark, a point or a comma; empty: as the numbers show",
        choices=("", ".", ","),
    )  # fmt: skip
    counted_from: str = expert(
        "", doc="number of the first position and of the first target; empty: as the numbers show",
        choices=("", "0", "1"),
    )  # fmt: skip
    columns: tuple[str, ...] = setting(
        (), doc="columns by the text at their head where that says nothing, as length=Messwert"
    )
    name: str = expert("", doc="sheet of a workbook that is read; empty: the one that fits")

    def named(self) -> dict[str, str]:
        """Return column of ours -> text at its head; ConfigurationError for an entry without."""
        found = {}
        for entry in self.columns:
            name, _, text = (part.strip() for part in entry.partition("="))
            if not name or not text:
                raise ConfigurationError(
                    f"sheet.columns: {entry!r}: expected COLUMN=TEXT, as length=Weg"
                )
            found[TableColumn.of(name).name] = text
        return found


AS_IT_STANDS: Final = SheetSettings()
"""For a table that states everything itself."""


@dataclass(frozen=True)
class Known:
    """What a number in a table may be: ``numbers`` of the plan, ascending, perhaps with gaps.

    ``labels`` maps other names to them; ``angles`` (rad) are those of the positions, ``downward``
    those of them that are reached from above, ``order`` all in the order of the plan. ``listed``:
    no plan knows them, the table lists them all, as one of targets does. ``source`` is the table
    that the labels are from.
    """

    numbers: tuple[int, ...] = ()
    labels: Mapping[str, int] = field(default_factory=dict)
    angles: tuple[float, ...] = ()
    downward: frozenset[int] = frozenset()
    order: tuple[int, ...] = ()
    listed: bool = False
    source: Reading | None = None


@dataclass(frozen=True)
class Reading:
    """A table as it was read, and how that was understood, in words.

    ``columns`` maps our columns to theirs; ``left_out`` are the numbers of rows with why;
    ``remarks`` say what was counted or turned. ``labels`` maps the labels of the first column to
    their numbers. ``angles_deg`` are the table's own, ascending, where no plan had any, with how
    many ``runs`` go through them, in ``both_directions`` or in one. ``form`` is empty for a table
    of our own form, which is read as it stands. ``beside``: other tables that were read for it.
    ``uses`` maps our columns without their units, or TABLE_ANGLE, to where they are, unless that
    is a matrix; ``head`` are the texts at the head of the table. ``passes`` are those of the rows
    where the table came to its angles more than once.
    """

    table: Table
    form: str = ""
    columns: Mapping[str, str] = field(default_factory=dict)
    aside: tuple[str, ...] = ()
    left_out: tuple[tuple[int, str], ...] = ()
    remarks: tuple[str, ...] = ()
    labels: Mapping[str, int] = field(default_factory=dict)
    angles_deg: tuple[float, ...] = ()
    runs: int = 1
    both_directions: bool = False
    beside: tuple[Reading, ...] = ()
    uses: Mapping[str, Use] = field(default_factory=dict)
    head: tuple[str, ...] = ()
    passes: tuple[Pass, ...] = ()

    def line(self) -> str:
        """Return it in one line; empty for a table of our own form."""
        if not self.form:
            return ""
        columns = ", ".join(f"{ours} = {theirs}" for ours, theirs in self.columns.items())
        parts = [f"{self.table.path} ({self.form}): {columns}", *self.remarks]
        if self.aside:
            parts.append(f"not needed: {', '.join(self.aside)}")
        if self.left_out:
            rows = "row" if len(self.left_out) == 1 else "rows"
            parts.append(f"{len(self.left_out)} {rows} left out (--explain)")
        return "; ".join(parts)

    def lines(self) -> list[str]:
        """Return it in full, for ``--explain``."""
        if not self.form:
            header = ", ".join(self.table.header)
            return [f"{self.table.path}: a table of our own form, read as it stands: {header}"]
        return [
            f"{self.table.path}: {self.form}, {len(self.table.lines)} rows",
            *(f"  {ours:<16} {theirs}" for ours, theirs in self.columns.items()),
            *(f"  {remark}" for remark in self.remarks),
            *([f"  not needed: {', '.join(self.aside)}"] if self.aside else []),
            *(f"  row {row} left out: {why}" for row, why in self.left_out),
            *(line for other in self.beside for line in other.lines()),
        ]


def read_any(
    source: Path | Table,
    headers: Sequence[Header],
    settings: SheetSettings,
    known: Callable[[], Mapping[str, Known]] = dict,
) -> Reading:
    """Return a table, or that in a file, with one of our ``headers``, and how it was understood.

    ``known`` gives the numbers that a column may have, by the name of the column; it is asked only
    for a table that is not of our own form. Raises BagError for a file that is no table,
    DataError, with what to do, where something can be read in two ways or not at all.
    """
    own = own_table(source, headers)
    if own is not None:
        return Reading(own)
    named = settings.named()
    if isinstance(source, Table):
        path, found = source.path, [Sheet("DataFrame", ((0, source.header), *source.lines))]
    else:
        path, found = source, [g for g in sheets(source) if settings.name in ("", g.name)]
    if not found:
        names = [grid.name for grid in sheets(path) if grid.name] or ["a text has none"]
        raise ConfigurationError(
            f"{path}: there is no sheet {settings.name!r} (sheet.name): choose one of "
            f"{', '.join(names)}"
        )
    layout = best_layout(found, headers, named, str(path))
    _require_named(path, headers, named, layout.head if layout else _likely_head(found))
    if layout is None or layout.missing:
        raise _not_understood(path, headers, layout, found)
    reading = _Rows(path, layout, settings, known()).read()
    in_memory = isinstance(source, Table) and source.in_memory
    return replace(reading, table=replace(reading.table, in_memory=in_memory))


def _require_named(
    path: Path, headers: Sequence[Header], named: Mapping[str, str], head: Sequence[str]
) -> None:
    """Raise ConfigurationError for a column that is not known, BagError for a heading too few."""
    ours = {TableColumn.of(name).name for header in headers for name in header}
    ours |= BESIDE if "position" in ours else set()
    there = {folded(part) for text in head for part in (text, *CORNER.split(text))}
    for name, text in named.items():
        if name not in ours.union(known_columns()):
            raise ConfigurationError(f"sheet.columns: no column {name!r}{nearest(name, ours)}")
        if name in ours and folded(text) not in there:
            raise BagError(
                f"{path}: sheet.columns: no column is called {text!r}{nearest(text, head)}"
            )


def _not_understood(
    path: Path, headers: Sequence[Header], layout: Layout | None, grids: Sequence[Sheet]
) -> BagError:
    expected = " or ".join(f"'{','.join(header)}'" for header in headers)
    if layout is None:
        return BagError(
            f"{path}: no row names the columns: expected {expected}, in any form and language: "
            "add a line of names above the numbers",
            question=_which_column(headers[0][0], _likely_head(grids)),
        )
    if strange := strange_unit(layout):
        text, unit, quantity = strange
        return BagError(
            f"{path}: {unit!r} in the heading {text!r} is an unknown unit: known for "
            f"{quantity} are {', '.join(UNITS[quantity])}: write one of these there, and convert "
            "the numbers if need be"
        )
    found = ", ".join(f"{name} ({use.text})" for name, use in layout.uses.items())
    others = f"; not known: {', '.join(map(repr, layout.aside))}" if layout.aside else ""
    name = TableColumn.of(layout.missing[0]).name
    return BagError(
        f"{path}: no column {', '.join(layout.missing)}: found {found}{others}. Expected "
        f"'{','.join(layout.header)}', in any unit and order. State a column with another name by "
        f"{answer(name, 'ITS NAME')}",
        question=_which_column(layout.missing[0], layout.aside),
    )


def _which_column(header: str, texts: Sequence[str]) -> Question | None:
    """Return the question which of these texts stands at the head of a column of ours."""
    name = TableColumn.of(header).name
    return Question("sheet.columns", tuple((f"{name}={t}", t) for t in texts)) if texts else None


def _likely_head(grids: Sequence[Sheet]) -> Sequence[str]:
    """Return the longest row of words that stands over a row of numbers."""
    rows = [
        [cell for cell in cells if isinstance(cell, str) and cell]
        for sheet in grids
        for (_, cells), (_, below) in pairwise(sheet.rows[:_LOOKED_AT])
        if not any(map(_is_number, cells)) and sum(map(_is_number, below)) > 1
    ]
    return max(rows, key=len, default=())


class _Rows:
    """Turns the rows of one layout into those of our table."""

    def __init__(
        self, path: Path, layout: Layout, settings: SheetSettings, known: Mapping[str, Known]
    ) -> None:
        self._path, self._layout, self._settings, self._known = path, layout, settings, known
        self._columns = [TableColumn.of(name) for name in layout.header]
        self._left_out: list[tuple[int, str]] = []
        self._remarks: list[str] = []
        self._labels: dict[str, int] = {}
        self._angles_deg: tuple[float, ...] = ()
        self._runs, self._both_directions = 1, False
        self._found: tuple[Pass, ...] = ()
        self._strange: list[tuple[int, str]] = []  # directions that are no word for one

    def read(self) -> Reading:
        """Return the table."""
        layout = self._layout
        rows = [
            (number, values) for number, cells in self._kept() for values in self._spread(cells)
        ]
        if not rows:
            why = "".join(f" (row {row}: {what})" for row, what in self._left_out[:1])
            raise DataError(
                f"{self._path}: the table has a header but no rows{why}: add what was measured "
                "below it"
            )
        mark = self._mark([values for _, values in rows])
        columns = [self._column(column, rows, mark) for column in self._columns]
        lines = tuple(
            (number, cells)
            for (number, _), cells in zip(rows, zip(*columns, strict=True), strict=True)
        )
        theirs = {column.header: self._theirs(column) for column in self._columns}
        return Reading(
            Table(self._path, layout.header, lines),
            layout.sheet.form,
            theirs,
            layout.aside,
            tuple(self._left_out),
            (*self._remarks, *([phrase("decimal comma")] if mark == "," else [])),
            self._labels,
            self._angles_deg,
            self._runs,
            self._both_directions,
            tuple(known.source for known in self._known.values() if known.source),
            layout.uses,
            layout.head,
            self._found,
        )

    def _kept(self) -> Iterator[tuple[int, tuple[Cell, ...]]]:
        """Yield the rows of values; note those that are left out, and why."""
        width, begun = max(use.place for use in self._all_uses()) + 1, False
        for number, row in self._layout.sheet.rows[self._layout.first :]:
            cells = (*row, *[""] * (width - len(row)))
            why = self._no_values(cells)
            named = set() if why else _named_by(row)
            if named and begun:
                if named.issuperset(self._layout.uses):
                    raise DataError(
                        f"{self._path}, row {number}: a table with the same columns begins here: "
                        "put both below one head, or each into a file of its own"
                    )
                self._left_out.append((number, phrase("another table begins here")))
                return
            if named:
                why = phrase("the head in other words")
            if why:
                self._left_out.append((number, why))
            else:
                begun = True
                yield number, cells

    def _no_values(self, cells: Sequence[Cell]) -> str | None:
        """Return why a row holds no values; None if it does."""
        texts = [cell for cell in cells if cell != ""]
        if tuple(map(str, texts)) == self._layout.head:
            return phrase("the head of the table again")
        first = next((cell for cell in texts if isinstance(cell, str)), "")
        if first and first is texts[0] and is_summary(first):
            return phrase("a line about others ({0})", first)
        if len(texts) == 1 and not _is_number(texts[0]):
            return phrase("a line of text ({0})", str(texts[0])[:40])
        values = {c.name for c in self._columns if c.quantity not in ("", TIME)}
        uses = self._layout.uses.items()
        measured = [cells[use.place] for name, use in uses if name in values]
        if any(map(_is_nothing, measured)):
            return phrase("nothing was measured")
        keys = [cells[use.place] for name, use in uses if name not in values]
        if measured and keys and all(map(_is_nothing, keys)):
            return phrase("values that belong to nothing")
        return None

    def _all_uses(self) -> list[Use]:
        in_matrix = [use for cells in self._layout.matrix for use in cells.uses.values()]
        return [*self._layout.uses.values(), *in_matrix]

    def _spread(self, cells: Sequence[Cell]) -> Iterator[dict[str, tuple[Cell, Use]]]:
        """Yield the cells of a row by column: once for a list, once per label for a matrix."""
        own = {name: (cells[use.place], use) for name, use in self._layout.uses.items()}
        if not self._layout.matrix:
            yield own
        for group in self._layout.matrix:
            values = {name: (cells[use.place], use) for name, use in group.uses.items()}
            if not any(_is_nothing(cell) for cell, _ in values.values()):
                angle = group.column == "position" and isinstance(group.label, str)
                label = {TABLE_ANGLE if angle else group.column: (group.label, Use(-1, "head"))}
                yield own | label | values

    def _mark(self, rows: Sequence[Mapping[str, tuple[Cell, Use]]]) -> str:
        """Return the decimal mark; DataError where no number shows it, or some show another."""
        if self._settings.decimal:
            return self._settings.decimal
        measured = {c.name for c in self._columns if c.quantity} | {TABLE_ANGLE}
        cells = [cell for row in rows for name, (cell, _) in row.items() if name in measured]
        marks = decimal_marks(cells)
        with_comma = next((c for c in cells if isinstance(c, str) and "," in c), None)
        if len(marks) == 1:
            return next(iter(marks))
        if not marks:
            raise DataError(
                f"{self._path}: some numbers have decimal points and some decimal commas: say "
                "which it is: --set sheet.decimal=. or --set sheet.decimal=,",
                question=_decimal_mark(".", ","),
            )
        if with_comma is None:
            return "."
        read = (parse(with_comma, mark) for mark in (".", ","))
        point, comma = (str(measure and measure.value) for measure in read)
        raise DataError(
            f"{self._path}: {with_comma} is {point} with a decimal point, and {comma} with a "
            "decimal comma: say which: --set sheet.decimal=. or --set sheet.decimal=,",
            question=_decimal_mark(f"{with_comma} = {point}", f"{with_comma} = {comma}"),
        )

    def _column(
        self,
        column: TableColumn,
        rows: Sequence[_Row],
        mark: str,
    ) -> list[str]:
        """Return our cells of a column."""
        name = column.name
        if name not in rows[0][1] or self._by_angles(name):
            return self._positions(rows, mark)
        cells = [(number, *row[name]) for number, row in rows]
        if column.quantity:
            return [self._in_si(place, name, column.quantity, mark) for place in cells]
        if name in TEXTS:
            return [kind_of(_text(c)) if name == "kind" else _text(c)
                    for _, c, _ in cells]  # fmt: skip
        numbers = self._numbers(name, [(number, _text(cell)) for number, cell, _ in cells])
        if name == "position":
            numbers = self._in_passes(rows, numbers)
        if name == "position" and TABLE_ANGLE in rows[0][1]:
            beside = [(number, *row[TABLE_ANGLE]) for number, row in rows]
            self._require_angles(numbers, beside, mark)
        return numbers

    def _by_angles(self, name: str) -> bool:
        """Return whether a column of table angles gives positions, and no plan their numbers."""
        uses, known = self._layout.uses, self._known
        return name == "position" and TABLE_ANGLE in uses and not (name in uses and name in known)

    def _require_angles(
        self, numbers: Sequence[str], cells: Sequence[tuple[int, Cell, Use]], mark: str
    ) -> None:
        """Raise DataError where the table angle beside a position is not the planned one."""
        planned = dict(enumerate(self._known.get("position", Known()).angles))
        if not planned:
            return
        near = _NEAR * _smallest_step(tuple(planned.values()))
        for text, (number, cell, use) in zip(numbers, cells, strict=True):
            expected = planned.get(int(text or -1))
            if expected is None or _is_nothing(cell):
                continue
            angle = float(self._in_si((number, cell, use), "table angle", ANGLE, mark))
            if abs(remainder(angle - expected, 2.0 * pi)) > near:
                raise DataError(
                    f"{self._path}, row {number}: position {text} is planned at "
                    f"{expected / DEGREE:g} degrees, and the table says {_text(cell)}: does the "
                    "set-up belong to this table?"
                )

    def _in_si(self, cell: tuple[int, Cell, Use], name: str, quantity: str, mark: str) -> str:
        number, value, use = cell
        measure = parse(value, mark, quantity)
        if measure is None:
            raise DataError(
                f"{self._path}, row {number}: {name} must be a number, found {_text(value)!r}: "
                "correct it, or empty the cell where nothing was measured"
            )
        si = in_si(measure, measure.unit or self._unit(use, quantity, measure, name))
        return str(si)

    def _unit(self, use: Use, quantity: str, measure: Measure, name: str) -> str:
        """Return the unit of a column; DataError, with all readings, if none is stated."""
        units = use.units
        if len(units) == 1:
            return units[0]
        if name in SMALL_ANGLES:
            raise DataError(
                f"{self._path}: the column {use.text!r} ({name}) states no unit: its first value "
                f"can be {measure.value} arcsec, urad or deg. Write the unit behind its name, as "
                f"'{use.text} [arcsec]'"
            )
        if stated := self._unit_elsewhere(use, quantity):
            return stated
        usual = {LENGTH: ("m", "mm", "um", "in"), ANGLE: ("deg", "rad", "gon")}
        read = tuple(
            (unit, f"{measure.value} {unit} = {float(in_si(measure, unit)):.6g} {_si(quantity)}")
            for unit in units or usual.get(quantity, tuple(UNITS[quantity]))
        )
        setting = f"sheet.{UNIT_SETTINGS[quantity]}"
        raise DataError(
            f"{self._path}: the column {use.text!r} ({name}) states no unit: its first value can "
            f"be {', '.join(words for _, words in read)}. Say which: --set {setting}=UNIT",
            question=Question(setting, read),
        )

    def _positions(self, rows: Sequence[_Row], mark: str) -> list[str]:
        """Return the numbers of positions by table angles, whole turns aside.

        They are empty for points of nests, which belong to none.
        """
        known = self._known.get("position", Known())
        at = [k for k, (_, row) in enumerate(rows) if not _is_nest(row)]
        halts = closed([self._halt(*rows[k], self._angle(rows[k], mark)) for k in at])
        angles = _distinct(known.angles or [halt.angle for halt in halts])
        if not known.angles:
            self._angles_deg = tuple(round(angle / DEGREE, 12) for angle in angles)
        near = _NEAR * _smallest_step(angles)
        halts = [replace(halt, number=self._nearest(halt, angles, near)) for halt in halts]
        found = self._visits(halts, angles, known)
        self._remarks.append(phrase("positions by their angles"))
        numbers = dict(zip(at, found, strict=True))
        return [str(numbers.get(k, "")) for k in range(len(rows))]

    def _in_passes(self, rows: Sequence[_Row], numbers: list[str]) -> list[str]:
        """Return numbers of positions, where those given are of angles that are visited again.

        So it is where columns state direction or run, and there are no more numbers than angles.
        """
        known, beside = self._known.get("position", Known()), rows[0][1].keys() & {DIRECTION, RUN}
        angles = _distinct(known.angles)
        if not (beside and all(numbers) and max(map(int, numbers)) < len(angles)):
            return numbers
        halts = [
            self._halt(*row, known.angles[int(n)]) for row, n in zip(rows, numbers, strict=True)
        ]
        halts = [replace(halt, number=self._nearest(halt, angles, pi)) for halt in halts]
        return [str(position) for position in self._visits(halts, angles, known)]

    def _angle(self, row: _Row, mark: str) -> float:
        number, cells = row
        return float(self._in_si((number, *cells[TABLE_ANGLE]), "table angle", ANGLE, mark))

    def _halt(self, number: int, row: Mapping[str, tuple[Cell, Use]], angle: float) -> Halt:
        """Return that the table stood at ``angle`` (rad) for a row; its number is open yet."""
        keys = [c.name for c in self._columns if not c.quantity and c.name not in _NO_KEYS]
        texts = {name: _text(cell) for name, (cell, _) in row.items()}
        down = is_down(texts.get(DIRECTION, ""))
        if down is None and texts.get(DIRECTION):
            self._strange.append((number, texts[DIRECTION]))
        what = tuple(folded(texts[name]) for name in keys)
        return Halt(number, angle, 0, what, texts.get(RUN, ""), down)

    def _nearest(self, halt: Halt, angles: Sequence[float], near: float) -> int:
        """Return which of the angles a halt is at, the one of its own turn if there are several.

        Raises DataError where it is farther than ``near`` from all.
        """
        off = [abs(remainder(halt.angle - other, 2.0 * pi)) for other in angles]
        best = min(range(len(off)), key=lambda k: (off[k] > near, abs(halt.angle - angles[k])))
        if off[best] > near:
            nearest = angles[min(range(len(off)), key=off.__getitem__)]
            raise DataError(
                f"{self._path}, row {halt.row}: the table angle {halt.angle / DEGREE:.9g} degrees "
                f"is not in the plan; the nearest there is {nearest / DEGREE:g} degrees: correct "
                "the row, or the angles of the plan"
            )
        return best

    def _visits(
        self, halts: Sequence[Halt], angles: Sequence[float], known: Known
    ) -> Sequence[int]:
        """Return the position of each halt at ``angles``: by its pass, where a plan comes again.

        Rows in the order of the plan are its steps. Without a plan a position is the number of its
        angle, and the passes are noted.
        """
        if not known.angles:
            if is_repeated(halts):
                self._passes(halts)
            return [halt.number for halt in halts]
        numbers = [min(range(len(angles)), key=lambda k: abs(angles[k] - angle))
                   for angle in known.angles]  # fmt: skip
        if [numbers[position] for position in known.order] == [halt.number for halt in halts]:
            return known.order
        if len(numbers) == len(angles):
            return [numbers.index(halt.number) for halt in halts]
        positions, runs = dict[tuple[int, int, bool], int](), Counter[tuple[int, bool]]()
        for position, number in enumerate(numbers):
            down = position in known.downward
            positions[number, runs[number, down], down] = position
            runs[number, down] += 1
        found = self._passes(halts, both=bool(known.downward))
        if self._both_directions and not known.downward:
            raise DataError(
                f"{self._path}: the table goes up and down through its angles, the plan up only: "
                "set plan.bidirectional=true"
            )
        ways = [(halt.number, run, down and bool(known.downward))
                for halt, (run, down) in zip(halts, found, strict=True)]  # fmt: skip
        return [positions.get(way, positions[way[0], 0, way[2]]) for way in ways]

    def _passes(self, halts: Sequence[Halt], *, both: bool = False) -> list[Pass]:
        """Return the passes of the halts, and note how many runs they are."""
        for number, text in self._strange[:1]:
            raise DataError(
                f"{self._path}, row {number}: the direction must be up or down, found {text!r}: "
                "write one of these"
            )
        found = passes(halts, str(self._path), both=both)
        self._found = tuple(found)
        runs = self._runs = 1 + max(run for run, _ in found)
        ways = self._both_directions = len({down for _, down in found}) == 2
        self._remarks.append(
            phrase("runs: {0}, up and down", runs) if ways else phrase("runs: {0}", runs)
        )
        return found

    def _numbers(self, name: str, cells: Sequence[tuple[int, str]]) -> list[str]:
        """Return numbers from 0, by what is known of them and by the labels that stand there."""
        known, given = self._known.get(name, Known()), [text for _, text in cells if text]
        if known.listed:
            numbers = _listed(given)
            self._labels = dict(zip(map(folded, given), numbers, strict=True))
        elif known.labels and all(folded(text) in known.labels for text in given):
            numbers = [known.labels[folded(text)] for text in given]
        else:
            numbers = self._as_planned(
                name, [self._digits(name, *cell) for cell in cells if cell[1]]
            )
        found = iter(numbers)
        return [str(next(found)) if text else "" for _, text in cells]

    def _digits(self, name: str, number: int, text: str) -> int:
        """Return the number that a label is, or ends with; DataError without one."""
        found = label_of(text)
        if found is None:
            raise DataError(
                f"{self._path}, row {number}: {name} must be a number"
                f"{', or a name that the table of targets has as well' * (name == 'target')}, "
                f"found {text!r}: correct the row, or leave it out"
            )
        return found[1]

    def _as_planned(self, name: str, numbers: Sequence[int]) -> list[int]:
        """Return numbers as the plan has them: as they stand, or as its first, second and so on.

        Raises DataError where both may be.
        """
        planned = self._known.get(name, Known()).numbers
        if not planned or not numbers:
            return list(numbers)
        ways = {"0": {n: n for n in planned}, "1": dict(enumerate(planned, start=1))}
        use = self._layout.uses.get(name)
        if use and columns_of(Heading.of(use.text)) == ("ball_step",):
            del ways["1"]  # a step is no number of a ball
        able = {first: way for first, way in ways.items() if way.keys() >= set(numbers)}
        chosen = self._settings.counted_from or next(iter(able), "0")
        if len(able) > 1 and not self._settings.counted_from:
            readings = (f"counted from 0, {planned[0]} was not measured",
                        "counted from 1, the last was not")  # fmt: skip
            raise DataError(
                f"{self._path}: {name} {min(numbers)} to {max(numbers)}: {'; '.join(readings)}. "
                "Say which: --set sheet.counted_from=0 or --set sheet.counted_from=1",
                question=Question("sheet.counted_from", tuple(zip("01", readings, strict=True))),
            )
        if chosen == "1" and "1" in able:
            self._remarks.append(phrase("{0} counts from 1", name))
        return [able.get(chosen, {}).get(n, n) for n in numbers]

    def _theirs(self, column: TableColumn) -> str:
        """Return in words what of theirs a column of ours is."""
        quantity, use = column.quantity, self._layout.uses.get(column.name)
        if self._by_angles(column.name):
            quantity, use = ANGLE, self._layout.uses[TABLE_ANGLE]
        if use is None:
            groups = self._layout.matrix
            uses = [g.uses.get(column.name) or next(iter(g.uses.values())) for g in groups]
            use, last = uses[0], uses[-1]
            text: str = phrase("the matrix {0} to {1}", repr(use.text), repr(last.text))
        else:
            text = repr(use.text)
        unit = self._unit_elsewhere(use, quantity) if quantity and len(use.units) != 1 else ""
        return phrase("{0} in {1}", text, unit) if unit else text

    def _unit_elsewhere(self, use: Use, quantity: str) -> str:
        """Return the unit that settings, or a line above the table, state for a column."""
        above = self._layout.length_unit if quantity == LENGTH and not use.units else ""
        return str(getattr(self._settings, UNIT_SETTINGS[quantity]) or above)


def _decimal_mark(point: str, comma: str) -> Question:
    """Return the question for the decimal mark, with what either would mean."""
    return Question("sheet.decimal", ((".", point), (",", comma)))


def _distinct(angles: Sequence[float]) -> tuple[float, ...]:
    """Return the different angles, ascending."""
    kept: list[float] = []
    for angle in sorted(angles):
        if not kept or angle - kept[-1] > _SAME_ANGLE:
            kept.append(angle)
    return tuple(kept)


def _smallest_step(angles: Sequence[float]) -> float:
    """Return the smallest step between different angles on the circle; a turn for one alone."""
    around = _distinct([angle % (2.0 * pi) for angle in angles])
    steps = [b - a for a, b in zip(around, (*around[1:], around[0] + 2.0 * pi), strict=True)]
    return min((step for step in steps if step > 1e-6), default=2.0 * pi)


def _listed(texts: Sequence[str]) -> list[int]:
    """Return numbers of all labels that there are: as they stand, from 1, or in their order."""
    if all(text.isascii() and text.isdigit() and len(text) < 10 for text in texts):
        first = 1 if min(map(int, texts)) == 1 else 0
        return [int(text) - first for text in texts]
    numbers = {label: n for n, label in enumerate(dict.fromkeys(map(folded, texts)))}
    return [numbers[folded(text)] for text in texts]


def _text(cell: Cell) -> str:
    """Return a cell as text; a whole number of a workbook without its point."""
    if isinstance(cell, str):
        return cell
    return str(int(cell)) if cell.is_integer() else repr(cell)


def _is_number(cell: Cell) -> bool:
    return any(parse(cell, mark) for mark in (".", ","))


def _named_by(cells: Sequence[Cell]) -> set[str]:
    """Return the columns that cells name, if they are two or more names and nothing else."""
    texts = [cell for cell in cells if cell != ""]
    named = [columns_of(Heading.of(cell)) for cell in texts if isinstance(cell, str)]
    return set().union(*named) if len(named) == len(texts) > 1 and all(named) else set()


def _is_nest(row: Mapping[str, tuple[Cell, Use]]) -> bool:
    return "kind" in row and kind_of(_text(row["kind"][0])) == "nest"


def _is_nothing(cell: Cell) -> bool:
    return isinstance(cell, str) and is_nothing(cell)


def _si(quantity: str) -> str:
    return {LENGTH: "m", ANGLE: "rad", TIME: "s"}[quantity]
