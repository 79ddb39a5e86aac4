"""The plain table that a method reads, made of whatever table of numbers somebody has.

Every value becomes a text in metres or seconds, every number counts from 0; the reader of the
method then checks it as one of our own tables.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from decimal import Decimal
from itertools import pairwise
from math import pi, remainder
from pathlib import Path
from typing import Final, TypeAlias

from rotcal_ros.foundation.errors import (
    ConfigurationError,
    DataError,
    Question,
    UndecidedError,
)
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.table_columns import (
    ANGLE,
    COUNTS,
    LENGTH,
    SMALL_ANGLES,
    TIME,
    UNITS,
    SheetSettings,
    TableColumn,
    folded,
    meaning,
    option,
    quantity_of,
    undecided,
    unit_setting,
)
from rotcal_ros.foundation.table_reading import Known, Pass, Reading, Use, as_planned
from rotcal_ros.foundation.tables import Header, Table
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_tables.sheets.counters import (
    median_counts_per_turn,
    possible_counts_per_turn,
    usual_counts_near,
)
from rotcal_tables.sheets.deviations import NEAR_COMMANDED, AngleColumn, StatedDeviations
from rotcal_tables.sheets.files import Cell, Sheet, TimeCell, read_sheets
from rotcal_tables.sheets.layout import (
    TEXT_COLUMNS,
    Layout,
    cell_magnitude,
    cell_texts,
    find_best_layout,
    number_columns,
    preview_columns,
    upright_sheet,
)
from rotcal_tables.sheets.numerals import Measure, decimal_marks, parse_measure, to_si
from rotcal_tables.sheets.passes import (
    TableStop,
    assign_passes,
    close_full_turns,
    has_repeated_angles,
    resolve_directions,
)
from rotcal_tables.sheets.point_names import ask_name_pattern, split_point_names
from rotcal_tables.sheets.questions import (
    cell_text,
    check_named_columns,
    check_row_width,
    guess_heading_row,
    is_number,
    unknown_columns_error,
)
from rotcal_tables.sheets.words import (
    ACTUAL,
    DIRECTION,
    NOTHING,
    REVERSED,
    RUN,
    TABLE_ANGLE,
    Heading,
    heading_columns,
    is_blank_word,
    is_descending,
    is_summary_word,
    parse_label,
    point_kind,
    units_of,
)

_WITHOUT_SIGN: Final = frozenset({"u", "expanded", "uncertainty"})
"""Columns that are the same whichever way an encoder counts."""
_OURS: Final = {TABLE_ANGLE: "table angle", ACTUAL: "actual angle"}
"""Columns as messages call them."""
_SMALL: Final = ("arcsec", "urad", "mrad", "deg")
_NO_ANGLE: Final = 400
"""More in a column of angles are hardly degrees or gons of a turn, and may be counts."""
_USUAL: Final = {LENGTH: ("m", "mm", "um", "in"), ANGLE: ("deg", "rad", "gon")}
"""Likely units of deviations and readings, and of other columns."""
_LOOKED_AT: Final = 100
"""Rows among which a head is searched for."""
_SHOWN: Final = 6
"""Columns that are shown side by side."""
_Row: TypeAlias = "tuple[int, Mapping[str, tuple[Cell, Use]]]"
"""Its number, and its cells by column."""
_KINDS: Final = 4
"""Most words of a column that tells kinds of measurements apart."""
_NO_KEYS: Final = frozenset({"position", "segment"})
"""Columns of numbers that do not identify what was measured."""
READ_OUT: Final = 0.01 * DEGREE
"""Noise of a read-out of table angles, rad; angles that differ by more are different ones."""
_CLOSE: Final = 10
"""Times READ_OUT: angles of a table that are nearer than this may be one."""
_SAME_ANGLE: Final = 1e-9
"""Radians by which two readings of the same angle may differ."""


class AnyFormReader:
    """Reads tables of numbers in any form, see :class:`~rotcal_ros.foundation.table_reading`."""

    def read(
        self,
        source: Path | Table,
        headers: Sequence[Header],
        settings: SheetSettings,
        known: Callable[[], Mapping[str, Known]],
    ) -> Reading:
        """Return the table with one of our ``headers``."""
        if isinstance(source, Table):
            path, found = source.path, [Sheet("DataFrame", ((0, source.header), *source.lines))]
        else:
            path, found = source, [g for g in read_sheets(source) if settings.name in ("", g.name)]
        if not found:
            names = [grid.name for grid in read_sheets(path) if grid.name] or ["a text has none"]
            raise ConfigurationError(
                f"{path}: there is no sheet {settings.name!r} (sheet.name): choose one of "
                f"{', '.join(names)}"
            )
        named, raw = settings.named(), found
        if settings.names:
            found = [split_point_names(grid, settings.names) for grid in raw]
        if any(text.startswith("#") for text in named.values()):
            found = number_columns(found, named.values()) or found
        found = list(map(upright_sheet, found))
        layout = find_best_layout(found, headers, named, str(path), settings.table)
        check_named_columns(
            path, headers, named, layout.head if layout else guess_heading_row(found)
        )
        if layout is None or layout.missing:
            asked = None if settings.names else ask_name_pattern(str(path), raw, headers)
            if asked and _is_whole_by_names(asked, raw, headers, named):
                raise asked
            raise unknown_columns_error(path, headers, layout, found, named)
        check_row_width(path, layout)
        if settings.names:  # a table is known by its head as it stands in the file
            at = next((n for n, cells in layout.sheet.rows if cell_texts(cells) == layout.form), 0)
            as_read = next((g for g in raw if g.form == layout.sheet.form), raw[0])
            layout = replace(layout, form=cell_texts(dict(as_read.rows).get(at, ())))
        return _Rows(path, layout, settings, known()).read()

    def heading_rows(self, path: Path) -> Iterator[tuple[str, ...]]:
        """Yield the first rows of all sheets, or of all ways to part the columns of a text."""
        for grid in read_sheets(path):
            yield from (cell_texts(cells) for _, cells in grid.rows[:_LOOKED_AT])


READER: Final = AnyFormReader()


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
        self._seen: tuple[Sequence[_Row], str] = ((), "")

    def read(self) -> Reading:
        """Return the table."""
        layout = self._layout
        rows = [
            (number, values) for number, cells in self._kept() for values in self._spread(cells)
        ]
        if not rows:
            why = "".join(f" (row {row}: {what})" for row, what in self._left_out[:1])
            formulas = ", or save the workbook where its formulas are computed"
            raise DataError(
                f"{self._path}: the table has a header but no rows{why}: add what was measured "
                f"below it{formulas if layout.sheet.name else ''}"
            )
        self._require_one_unit([number for number, _ in rows])
        mark = self._mark([values for _, values in rows])
        self._seen = rows, mark
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
            form_head=layout.form,
        )

    def _require_one_unit(self, kept: Sequence[int]) -> None:
        """Raise DataError where a column of units states several: it says of which number."""
        rows = dict(self._layout.sheet.rows)
        for text, place in zip(self._layout.head, self._layout.places, strict=True):
            cells = [cell_text((*rows[row], *[""] * (place + 1))[place]) for row in kept]
            units = dict.fromkeys(units_of(cell) for cell in cells if cell)
            if text in self._layout.aside and len(units) > 1 and all(units):
                several = ", ".join(dict.fromkeys(cells))
                raise DataError(
                    f"{self._path}: {text!r} states several units, {several}: "
                    "write each behind its number, or convert the numbers to one"
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
        if first and first is texts[0] and is_summary_word(first):
            return phrase("a line about others ({0})", first)
        if len(texts) == 1 and not is_number(texts[0]):
            if str(texts[0])[:1].isdigit():
                return phrase("one cell alone ({0})", str(texts[0])[:40])
            return phrase("a line of text ({0})", str(texts[0])[:40])
        if self._of_runs() and parse_label(cell_text(cells[self._layout.uses[RUN].place])) is None:
            return phrase("no run ({0})", cell_text(cells[self._layout.uses[RUN].place])[:40])
        angle = self._layout.uses.get(TABLE_ANGLE)
        at = cell_text(cells[angle.place]) if angle else ""
        if not (is_blank_word(at) or any(map(str.isdigit, at))):
            return phrase("a line about others ({0})", at[:40])
        values = {c.name for c in self._columns if c.quantity not in ("", TIME)} | {ACTUAL}
        uses = self._layout.uses.items()
        measured = [cells[use.place] for name, use in uses if name in values]
        if any(map(_is_nothing, measured)):
            return phrase("nothing was measured")
        keys = [cells[use.place] for name, use in uses if name not in values]
        if measured and keys and all(map(_is_nothing, keys)):
            return phrase("values that belong to nothing")
        return None

    def _of_runs(self) -> bool:
        """Return whether each row is a run, and the columns are table angles."""
        matrix = self._layout.matrix
        return bool(matrix) and TABLE_ANGLE in matrix[0].labels and RUN in self._layout.uses

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
                use = group.label_use
                yield own | {n: (cell, use) for n, cell in group.labels.items()} | values

    def _mark(self, rows: Sequence[Mapping[str, tuple[Cell, Use]]]) -> str:
        """Return the decimal mark; DataError where no number shows it, or some show another."""
        if self._settings.decimal:
            return self._settings.decimal
        measured = {c.name for c in self._columns if c.quantity} | {TABLE_ANGLE, ACTUAL, REVERSED}
        cells = [cell for row in rows for name, (cell, _) in row.items() if name in measured]
        marks = decimal_marks(cells)
        with_comma = next((c for c in cells if isinstance(c, str) and "," in c), None)
        if len(marks) == 1:
            return next(iter(marks))
        if marks and with_comma is None:
            return "."
        point, comma = (_as_read(with_comma, mark) for mark in ".,")
        found = f"{with_comma} is {point} with a decimal point, and {comma} with a decimal comma"
        if not marks:
            found = "some numbers have decimal points and some decimal commas"
        raise undecided(
            f"{self._path}: {found}",
            "sheet.decimal",
            [(".", f"{with_comma} = {point}"), (",", f"{with_comma} = {comma}")],
        )

    def _column(
        self,
        column: TableColumn,
        rows: Sequence[_Row],
        mark: str,
    ) -> list[str]:
        """Return our cells of a column."""
        name = column.name
        if name == "deviation":
            return self._deviations(rows, mark)
        bare = name in rows[0][1] and not self._by_angles(name)
        if name == "position" and bare and "deviation_rad" in self._layout.header:
            text = self._layout.uses[name].text
            raise undecided(
                f"{self._path}: {text!r} may be table angles or numbers of positions, and the "
                "angles are needed",
                "sheet.columns",
                [(meaning(TABLE_ANGLE, text), "table angles")],
            )
        if name not in rows[0][1] or self._by_angles(name):
            return self._positions(rows, mark)
        cells = [(number, *row[name]) for number, row in rows]
        if column.quantity:
            return [self._in_si(place, name, column.quantity, mark) for place in cells]
        if name in TEXT_COLUMNS:
            return [point_kind(cell_text(c)) if name == "kind" else cell_text(c)
                    for _, c, _ in cells]  # fmt: skip
        numbers = self._numbers(name, [(number, cell_text(cell)) for number, cell, _ in cells])
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
        for text, (number, cell, use) in zip(numbers, cells, strict=True):
            expected = planned.get(int(text or -1))
            if expected is None or _is_nothing(cell):
                continue
            angle = float(self._in_si((number, cell, use), TABLE_ANGLE, ANGLE, mark))
            if abs(remainder(angle - expected, 2.0 * pi)) > self._near(tuple(planned.values())):
                raise self._other_angles(
                    number, angle, expected, f"position {text} is planned at {expected / DEGREE:g}"
                )

    def _near(self, planned: Sequence[float]) -> float:
        """Return by how much (rad) a table angle may be off a planned one that stands for it."""
        return (
            NEAR_COMMANDED * _smallest_step(planned)
            if self._settings.angles == "plan"
            else READ_OUT
        )

    def _other_angles(self, row: int, angle: float, planned: float, what: str = "") -> DataError:
        """Return the question whether the angles of the table count, or those of the plan."""
        found = (
            f"{self._path}, row {row}: the table angle {angle / DEGREE:.9g} degrees is not in the "
            f"plan; {what or f'the nearest there is {planned / DEGREE:.9g}'} degrees"
        )
        if self._settings.angles:
            return DataError(f"{found}: correct the row, or the angles of the plan")
        return undecided(
            found,
            "sheet.angles",
            [
                ("table", f"{angle / DEGREE:.9g} degrees, as the table says"),
                ("plan", f"{planned / DEGREE:.9g} degrees, as the plan says"),
            ],
        )

    def _deviations(self, rows: Sequence[_Row], mark: str) -> list[str]:
        """Return actual - commanded (rad), of the columns that say so."""
        names = {"deviation", ACTUAL, REVERSED, TABLE_ANGLE} & rows[0][1].keys()
        columns = {name: self._angles(name, rows, mark) for name in names}
        commanded = columns[TABLE_ANGLE].values if TABLE_ANGLE in columns else ()
        found, remark = StatedDeviations(
            f"{self._path}: ",
            [number for number, _ in rows],
            columns,
            preview_columns(self._layout, [*self._all_uses(), *self._layout.others][:_SHOWN]),
            _smallest_step([float(angle) for angle in commanded]) if commanded else 2.0 * pi,
            self._others(rows, mark) if "deviation" not in self._settings.named() else (),
            self._settings,
        ).read()
        self._remarks += [remark] if remark else []
        return list(map(str, found))

    def _others(self, rows: Sequence[_Row], mark: str) -> list[AngleColumn]:
        """Return the columns of angles with names of no meaning to us, where all are numbers."""
        cells = dict(self._layout.sheet.rows)
        beside = [
            [(n, {"": (cells[n][use.place], use)}) for n, _ in rows if use.place < len(cells[n])]
            for use in self._layout.others
        ]
        return [
            self._angles("", column, mark)
            for column in beside
            if len(column) == len(rows)
            and all(parse_measure(c[""][0], mark, ANGLE) for _, c in column)
        ]

    def _angles(self, name: str, rows: Sequence[_Row], mark: str) -> AngleColumn:
        """Return a column of angles in rad."""
        use = rows[0][1][name][1]
        cells = [cell_text(row[name][0]) for _, row in rows]
        values = [Decimal(self._in_si((n, *row[name]), name, ANGLE, mark)) for n, row in rows]
        unit = use.units[0] if len(use.units) == 1 else self._unit_elsewhere(use, ANGLE, name)
        size = UNITS[ANGLE][unit or "deg"] / (self._counts(name, use) if unit == COUNTS else 1)
        return AngleColumn(use.text, cells, values, unit or "deg", abs(size))

    def _in_si(self, cell: tuple[int, Cell, Use], name: str, quantity: str, mark: str) -> str:
        number, value, use = cell
        measure = parse_measure(value, mark, quantity)
        if measure is None:
            raise DataError(
                f"{self._path}, row {number}: {_OURS.get(name, name)} must be a number, found "
                f"{cell_text(value)!r}: correct it, or empty the cell where nothing was measured"
            )
        if {"dms", "m:s"} & {measure.unit, *use.units}:
            measure = self._sixtieths(number, value, measure, use, name)
        unit = measure.unit or self._unit(use, quantity, value, name)
        if (of := quantity_of(unit)) != quantity:
            raise DataError(
                f"{self._path}: {use.text!r} is in {unit}, of {of} and not of {quantity}: it is "
                f"no {_OURS.get(name, name)}; state another column, as --set sheet.columns=..."
            )
        found = to_si(measure, unit)
        if unit != COUNTS:
            return str(found)
        counts = self._counts(name, use)  # below 0 where they go against the table
        return str(found / (abs(counts) if name in _WITHOUT_SIGN else counts))

    def _counts(self, name: str, use: Use) -> int:
        """Return how many counts of a column make a turn; a question where nobody says it."""
        settings, commanded = self._settings, name == TABLE_ANGLE
        stated = (commanded and settings.commanded_counts) or settings.counts_per_turn
        if stated:
            return stated
        rows, mark = self._seen
        own = [float(m.value) for _, row in rows if name in row
               and (m := parse_measure(row[name][0], mark, ANGLE))]  # fmt: skip
        shown, about = "", 0.0
        angle = None if commanded else rows[0][1].get(TABLE_ANGLE)
        if angle and (settings.commanded_counts or not self._in_counts(TABLE_ANGLE, angle[1])):
            about = median_counts_per_turn([self._angle(row, mark) for row in rows], own)
            shown = f"; beside the table angles it is about {about:.6g}"
        found = usual_counts_near(about) if about else possible_counts_per_turn(own) if own else ()
        raise undecided(
            f"{self._path}: {use.text!r} is in counts, and how many make a turn of the table is "
            f"not stated{shown}",
            "sheet.counts_per_turn",
            [(str(n), f"{abs(n)} counts{' against the table' * (n < 0)}") for n in found]
            or [("N", "the counts of a turn, as the encoder's sheet states them")],
            preview_columns(self._layout, [use]),
        )

    def _in_counts(self, name: str, use: Use) -> bool:
        return COUNTS in (use.units or (self._unit_elsewhere(use, ANGLE, name),))

    def _sixtieths(self, row: int, value: Cell, measure: Measure, use: Use, name: str) -> Measure:
        """Return degrees or minutes with their 60ths where it is sure which; else ask.

        A time of a workbook, or 12:30:15, may be a time of day; 12.3015 may be degrees; 12:30 may
        be minutes and seconds.
        """
        stated = self._unit_elsewhere(use, ANGLE, name)
        units = {stated} if stated in ("dms", "m:s") else {*use.units, stated} - {""}
        of_time = isinstance(value, TimeCell)
        pair = not of_time and len(re.split(r"[:\s]+", cell_text(value).strip())) == 2
        shifted = Measure(measure.value, "m:s")  # all by one place
        if measure.unit == "dms":
            if "m:s" in units and (pair or (of_time and stated)):
                return shifted
            plainly = not of_time or (measure.value < 1 and not cell_text(value).endswith(":00"))
            sure = not of_time and units <= {"deg", "gon"} and not stated and (units or not pair)
            if "dms" in units or ("m:s" in units and plainly) or sure:
                return measure
            meant = "a time of day, or degrees, minutes and seconds"
            ways = [("dms", measure)] + [("m:s", shifted)] * (pair or of_time)
            answers = [(unit, f"{cell_text(value)} = {float(to_si(m, 'dms')) / ARCSEC:.6g} arcsec")
                       for unit, m in ways]  # fmt: skip
        elif measure.unit or stated or measure.value == int(measure.value):
            return measure
        else:
            meant = "no degrees, minutes and seconds"
            answers = [(unit, f"{cell_text(value)} {unit}") for unit in _SMALL]
        raise undecided(
            f"{self._path}, row {row}: {use.text!r} is {cell_text(value)}, {meant}",
            unit_setting(name, ANGLE),
            answers,
        )

    def _unit(self, use: Use, quantity: str, value: Cell, name: str) -> str:
        """Return the unit of a column; a question, with all readings, if none is stated."""
        stated = self._unit_elsewhere(use, quantity, name)
        if len(use.units) == 1:
            return stated if stated and use.units[0] in ("dms", "m:s") else use.units[0]
        if stated:
            return stated
        rows = self._layout.sheet.rows[self._layout.first :]
        cells = [cells[use.place] for _, cells in rows if 0 <= use.place < len(cells)]
        numbers = [n for n in map(cell_magnitude, cells or [value]) if n is not None]
        largest = Measure(Decimal(repr(max(numbers, key=abs, default=0.0))))
        usual = _SMALL if name in SMALL_ANGLES else _USUAL.get(quantity, tuple(UNITS[quantity]))
        if quantity == ANGLE and name not in SMALL_ANGLES and largest.value > _NO_ANGLE:
            usual = (COUNTS, *usual)
        read = tuple(
            (
                u,
                f"{float(largest.value):.9g} {u}"
                + ("" if u == COUNTS else f" = {float(to_si(largest, u)):.6g} {_si(quantity)}"),
            )
            for u in use.units or usual
        )
        setting = unit_setting(name, quantity)
        ways = " or ".join(option(setting, unit) for unit, _ in read)
        raise UndecidedError(
            f"{self._path}: the column {use.text!r} ({_OURS.get(name, name)}) states no unit: its "
            f"largest value can be {', '.join(words for _, words in read)}",
            f"say which: {ways} (or write it behind the name, as '{use.text} [{usual[0]}]')",
            "\n".join(preview_columns(self._layout, [use])),
            Question(setting, read),
        )

    def _positions(self, rows: Sequence[_Row], mark: str) -> list[str]:
        """Return the numbers of positions by table angles, whole turns aside.

        They are empty for points of nests, which belong to none.
        """
        known = self._known.get("position", Known())
        at = [k for k, (_, row) in enumerate(rows) if not _is_nest(row)]
        stops = close_full_turns([self._stop(*rows[k], self._angle(rows[k], mark)) for k in at])
        angles = _distinct(known.angles) if known.angles else self._own_angles(stops)
        if not known.angles:
            self._angles_deg = tuple(round(angle / DEGREE, 12) for angle in angles)
        planned = known.angles or self._settings.angles == "plan"
        near = self._near(angles) if planned else READ_OUT
        stops = [replace(stop, number=self._nearest(stop, angles, near)) for stop in stops]
        off = max((abs(remainder(h.angle - angles[h.number], 2 * pi)) for h in stops), default=0.0)
        if off > _SAME_ANGLE:
            self._remarks.append(
                phrase("table angles are off by up to {0} degrees", f"{off / DEGREE:.2g}")
            )
        found = self._visits(stops, angles, known)
        self._remarks.append(phrase("positions by their angles"))
        numbers = dict(zip(at, found, strict=True))
        return [str(numbers.get(k, "")) for k in range(len(rows))]

    def _own_angles(self, stops: Sequence[TableStop]) -> tuple[float, ...]:
        """Return the different angles of a table that no plan knows, ascending (rad).

        Some that are apart by more than the noise of a read-out, and far from all others, may be
        one: it is asked, unless ``sheet.angles`` says table, or plan for one.
        """
        read = [stop.angle for stop in stops]
        angles, fewer = _distinct(read, READ_OUT), _distinct(read, _CLOSE * READ_OUT)
        alone = _smallest_step(fewer) > _CLOSE**2 * READ_OUT
        if len(fewer) == len(angles) or not alone or self._settings.angles == "table":
            return angles
        if self._settings.angles == "plan":
            return fewer
        first, second = next((a, b) for a, b in pairwise(angles) if b - a <= _CLOSE * READ_OUT)
        row = next(stop.row for stop in stops if stop.angle == second)
        off = f"{first / DEGREE:.6g} and {second / DEGREE:.6g} degrees"
        raise undecided(
            f"{self._path}, row {row}: the table angles {off} differ by more than the noise of a "
            f"read-out, {READ_OUT / DEGREE:g} degrees",
            "sheet.angles",
            [
                ("table", f"{len(angles)} angles, as the table says"),
                ("plan", f"{len(fewer)} angles: those that are close are one"),
            ],
        )

    def _in_passes(self, rows: Sequence[_Row], numbers: list[str]) -> list[str]:
        """Return numbers of positions, where those given are of angles that are visited again.

        So it is where columns state direction or run, and there are no more numbers than angles.
        """
        known, beside = self._known.get("position", Known()), rows[0][1].keys() & {DIRECTION, RUN}
        angles = _distinct(known.angles)
        if not (beside and all(numbers) and max(map(int, numbers)) < len(angles)):
            return numbers
        stops = [
            self._stop(*row, known.angles[int(n)]) for row, n in zip(rows, numbers, strict=True)
        ]
        stops = [replace(stop, number=self._nearest(stop, angles, pi)) for stop in stops]
        return [str(position) for position in self._visits(stops, angles, known)]

    def _angle(self, row: _Row, mark: str) -> float:
        number, cells = row
        return float(self._in_si((number, *cells[TABLE_ANGLE]), TABLE_ANGLE, ANGLE, mark))

    def _stop(self, number: int, row: Mapping[str, tuple[Cell, Use]], angle: float) -> TableStop:
        """Return that the table stood at ``angle`` (rad) for a row; its number is open yet."""
        keys = [c.name for c in self._columns if not c.quantity and c.name not in _NO_KEYS]
        texts = {name: cell_text(cell) for name, (cell, _) in row.items()}
        way = texts.get(DIRECTION, "")
        down = is_descending(way)
        what = tuple(folded(texts[name]) for name in keys)
        run = texts.get(RUN, "")
        return TableStop(number, angle, 0, what, run, down, way if down is None else "")

    def _nearest(self, stop: TableStop, angles: Sequence[float], near: float) -> int:
        """Return which of the angles a stop is at, the one of its own turn if there are several.

        Raises DataError where it is farther than ``near`` from all.
        """
        off = [abs(remainder(stop.angle - other, 2.0 * pi)) for other in angles]
        best = min(range(len(off)), key=lambda k: (off[k] > near, abs(stop.angle - angles[k])))
        if off[best] > near:
            nearest = angles[min(range(len(off)), key=off.__getitem__)]
            raise self._other_angles(stop.row, stop.angle, nearest)
        return best

    def _visits(
        self, stops: Sequence[TableStop], angles: Sequence[float], known: Known
    ) -> Sequence[int]:
        """Return the position of each stop at ``angles``: by its pass, where a plan comes again.

        Rows in the order of the plan are its steps. Without a plan a position is the number of its
        angle, and the passes are noted.
        """
        if not known.angles:
            if has_repeated_angles(stops):
                self._require_one_kind(stops)
                self._passes(stops)
            return [stop.number for stop in stops]
        numbers = [min(range(len(angles)), key=lambda k: abs(angles[k] - angle))
                   for angle in known.angles]  # fmt: skip
        if [numbers[position] for position in known.order] == [stop.number for stop in stops]:
            return known.order
        if len(numbers) == len(angles):
            return [numbers.index(stop.number) for stop in stops]
        positions, runs = dict[tuple[int, int, bool], int](), Counter[tuple[int, bool]]()
        for position, number in enumerate(numbers):
            down = position in known.downward
            positions[number, runs[number, down], down] = position
            runs[number, down] += 1
        found = self._passes(stops, both=bool(known.downward))
        if self._both_directions and not known.downward:
            raise DataError(
                f"{self._path}: the table goes up and down through its angles, the plan up only: "
                "set plan.bidirectional=true"
            )
        ways = [(stop.number, run, down and bool(known.downward))
                for stop, (run, down) in zip(stops, found, strict=True)]  # fmt: skip
        return [positions.get(way, positions[way[0], 0, way[2]]) for way in ways]

    def _require_one_kind(self, stops: Sequence[TableStop]) -> None:
        """Raise a question where words of no known column part what was measured at one angle.

        They may be those of several axes, or of a reading that its program holds for bad.
        """
        rows, aside = dict(self._layout.sheet.rows), {*self._layout.aside}
        for text, place in zip(self._layout.head, self._layout.places, strict=True):
            kinds = dict[tuple[object, ...], dict[str, int]]()
            for stop in stops if text in aside else ():
                cell = cell_text((*rows[stop.row], *[""] * (place + 1))[place])
                if cell and not is_number(cell):
                    kinds.setdefault((stop.what, stop.number), {}).setdefault(cell, stop.row)
            words = dict.fromkeys(word for at in kinds.values() for word in at)
            parted = next((at for at in kinds.values() if len(at) > 1), {})
            if parted and len(words) <= _KINDS and NOTHING not in self._settings.named():
                raise undecided(
                    f"{self._path}: {text!r} is {' and '.join(words)}, in rows of one angle "
                    f"({', '.join(map(str, parted.values()))}): where these are not runs of one "
                    "measurement, keep the rows of one of them",
                    "sheet.columns",
                    [
                        (meaning(RUN, text), "each is a run"),
                        (meaning(NOTHING, text), "it is no matter"),
                    ],
                )

    def _passes(self, stops: Sequence[TableStop], *, both: bool = False) -> list[Pass]:
        """Return the passes of the stops, and note how many runs they are."""
        stops = resolve_directions(stops, self._settings.up, str(self._path))
        found = assign_passes(stops, str(self._path), both=both)
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
        found = parse_label(text)
        if found is None:
            raise DataError(
                f"{self._path}, row {number}: {name} must be a number"
                f"{', or a name that the table of targets has as well' * (name == 'target')}, "
                f"found {text!r}: correct the row, or leave it out"
            )
        return found[1]

    def _as_planned(self, name: str, numbers: Sequence[int]) -> list[int]:
        """Return numbers as the plan has them; DataError where they can be read in two ways."""
        planned = self._known.get(name, Known()).numbers
        use, firsts = self._layout.uses.get(name), self._settings.counted_from or "01"
        if use and heading_columns(Heading.of(use.text)) == ("ball_step",):
            firsts = firsts.replace("1", "")  # a step is no number of a ball
        found, from_one = as_planned(str(self._path), name, numbers, planned, firsts)
        self._remarks += [phrase("{0} counts from 1", name)] if from_one else []
        return found

    def _theirs(self, column: TableColumn) -> str:
        """Return in words what of theirs a column of ours is."""
        name, quantity, uses = column.name, column.quantity, self._layout.uses
        use = uses.get(name)
        if self._by_angles(name):
            name, quantity, use = TABLE_ANGLE, ANGLE, uses[TABLE_ANGLE]
        if name == "deviation" and use is None and not self._layout.matrix:
            if ACTUAL in uses and TABLE_ANGLE in uses:
                return f"{uses[ACTUAL].text!r} - {uses[TABLE_ANGLE].text!r}"
            use = uses[REVERSED]
        if use is None:
            groups = self._layout.matrix
            shown = [g.uses.get(name) or next(iter(g.uses.values())) for g in groups]
            use, last = shown[0], shown[-1]
            text: str = phrase("the matrix {0} to {1}", repr(use.text), repr(last.text))
        else:
            text = repr(use.text)
        unit = (
            self._unit_elsewhere(use, quantity, name) if quantity and len(use.units) != 1 else ""
        )
        return phrase("{0} in {1}", text, unit) if unit else text

    def _unit_elsewhere(self, use: Use, quantity: str, name: str) -> str:
        """Return the unit that settings, or a line above the table, state for a column."""
        above = self._layout.length_unit if quantity == LENGTH and not use.units else ""
        setting = unit_setting(name, quantity).removeprefix("sheet.")
        return str(getattr(self._settings, setting) or above)


def _is_whole_by_names(
    asked: UndecidedError,
    raw: Sequence[Sheet],
    headers: Sequence[Header],
    named: Mapping[str, str],
) -> bool:
    """Return whether all columns are there, once an answer takes the names of points apart."""
    pattern = asked.question.answers[0][0] if asked.question else ""
    try:
        layout = find_best_layout([split_point_names(s, pattern) for s in raw], headers, named, "")
    except DataError:  # another question comes first
        return True
    return layout is not None and not layout.missing


def _as_read(cell: Cell | None, mark: str) -> str:
    """Return what a cell is where ``mark`` is the decimal mark."""
    measure = None if cell is None else parse_measure(cell, mark, ANGLE)
    return f"{measure.value}" if measure else "no number"


def _distinct(angles: Sequence[float], noise: float = _SAME_ANGLE) -> tuple[float, ...]:
    """Return the different angles, ascending; the middle one of those within ``noise`` (rad)."""
    near: list[list[float]] = []
    for angle in sorted(angles):
        if not near or angle - near[-1][0] > noise:
            near.append([])
        near[-1].append(angle)
    return tuple(each[len(each) // 2] for each in near)


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


def _named_by(cells: Sequence[Cell]) -> set[str]:
    """Return the columns that cells name, if they are two or more names and nothing else."""
    texts = [cell for cell in cells if cell != ""]
    if len(texts) < 2 or any(map(is_number, texts)):
        return set()
    named = [heading_columns(Heading.of(cell_text(cell))) for cell in texts]
    return set().union(*named) if all(named) else set()


def _is_nest(row: Mapping[str, tuple[Cell, Use]]) -> bool:
    return "kind" in row and point_kind(cell_text(row["kind"][0])) == "nest"


def _is_nothing(cell: Cell) -> bool:
    return isinstance(cell, str) and is_blank_word(cell)


def _si(quantity: str) -> str:
    return {LENGTH: "m", ANGLE: "rad", TIME: "s"}[quantity]
