"""How a table is read: as one of our own, by a map of its columns, or as a package understands it.

What a person says of a table stands in the group ``sheet`` of settings, or in the file
``table_forms.yaml`` beside the table: a list of heads as they stand there, each with settings of
that group. A table with the same head needs no question then.

Reads CSV whose columns have our names, in any unit and order, or names that are mapped to ours.

So tables are read where no package for other forms is installed. The map is ``sheet.columns``, as
``length=Weg``; a unit stands behind the name, ``Weg [mm]`` or ``length_mm``, or in ``sheet``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from decimal import Decimal
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple, cast

import yaml

from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.errors import (
    BagError,
    ConfigurationError,
    DataError,
    Question,
    UndecidedError,
)
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.settings import load
from rotcal_ros.foundation.table_columns import (
    AS_IT_STANDS,
    BEHIND,
    COUNTS,
    IN_BRACKETS,
    UNITS,
    SheetSettings,
    TableColumn,
    folded,
    option,
    plain,
    undecided,
    unit_setting,
)
from rotcal_ros.foundation.table_reading import FormReader, Known, Reading, Use, as_planned
from rotcal_ros.foundation.tables import (
    Header,
    Table,
    is_workbook,
    parquet_as_table,
    read_own_form,
    read_table,
)
from rotcal_ros.foundation.untrusted import is_plain_file, load_yaml, read_errors_as, read_text

_OF_ANY_FORM: Final = (
    "angles", "values", "up", "decimal", "name", "names", "table",
    "counts_per_turn", "commanded_counts", "counter", "zero",
)  # fmt: skip
"""Settings of ``sheet`` for what is read by a package only."""
_NO_NUMBERS_ALONE: Final = ("dms", "m:s", COUNTS)
_LIKELY: Final = {"length": ("m", "mm", "um", "in"), "angle": ("deg", "rad", "arcsec")}
FILE: Final = "table_forms.yaml"


class _Head(NamedTuple):
    """The text at the head of a column: its name and its unit, "?" for one that is not known."""

    text: str
    name: str
    unit: str = ""

    @classmethod
    def of(cls, text: str) -> _Head:
        for pattern in (IN_BRACKETS, BEHIND):
            found = pattern.fullmatch(plain(text))
            if found and any(found[2].casefold() in units for units in UNITS.values()):
                return cls(text, found[1], found[2].casefold())
        bracketed = IN_BRACKETS.fullmatch(plain(text))
        return cls(text, bracketed[1], "?") if bracketed else cls(text, plain(text))


class ColumnMap:
    """Reads CSV in commas and UTF-8; refuses all else in one line, with what to do."""

    def read(
        self,
        source: Path | Table,
        headers: Sequence[Header],
        settings: SheetSettings,
        known: Callable[[], Mapping[str, Known]],
    ) -> Reading:
        """Return the table with the longest of our ``headers`` that its columns fill."""
        table = source if isinstance(source, Table) else _comma_separated(source)
        for name in _OF_ANY_FORM:
            if getattr(settings, name) not in ("", ".", 0):  # the decimal mark that is known
                raise ConfigurationError(
                    f"{table.path}: sheet.{name} is not for CSV in commas: leave it "
                    f"out{_other_forms()}"
                )
        named, heads = settings.named(), [_Head.of(text) for text in table.header]
        _require_named(table.path, headers, named, table.header)
        found = {header: _places(table.path, header, heads, named) for header in headers}
        header = max(headers, key=lambda h: (len(found[h]) - len(h), len(h)))
        if len(found[header]) < len(header):
            raise _not_mapped(table, header, found[header])
        table.rows()  # each has a cell for each column
        return _mapped(table, heads, found[header], settings, known())

    def heading_rows(self, path: Path) -> Iterable[tuple[str, ...]]:
        """Return the one row of names."""
        return [_comma_separated(path).header]


def _other_forms() -> str:
    """Return the end of an advice: what else could be done."""
    package = plugins.provider("any", plugins.TABLES)
    return f", or pip install {package}, which reads tables of any form"


def _comma_separated(path: Path) -> Table:
    if is_workbook(path):
        raise BagError(f"{path} is a workbook: save it as CSV UTF-8{_other_forms()}")
    try:
        return read_table(path)
    except (BagError, DataError) as error:
        raise type(error)(f"{error}{_other_forms()}") from error


def _require_named(
    path: Path, headers: Sequence[Header], named: Mapping[str, str], texts: Sequence[str]
) -> None:
    """Raise for a column that nobody knows, or a heading that is not there.

    What names neither a column of ours nor one of the file is for another table.
    """
    ours = {TableColumn.of(name).name for header in headers for name in header}
    there = {folded(text) for text in texts} | {f"#{n}" for n, _ in enumerate(texts, start=1)}
    for name, text in named.items():
        is_there = (text if text.startswith("#") else folded(text)) in there
        if name not in ours and is_there:
            raise ConfigurationError(
                f"{path}: sheet.columns: no column {name!r}{plugins.name_hint(name, ours)}"
            )
        if name in ours and not is_there:
            raise BagError(
                f"{path}: sheet.columns: no column is called {text!r}"
                f"{plugins.name_hint(text, texts)}"
            )


def _places(
    path: Path, header: Header, heads: Sequence[_Head], named: Mapping[str, str]
) -> dict[TableColumn, int]:
    """Return where the columns of a header are, those that are there."""
    found, mapped = dict[TableColumn, int](), set[int]()
    for text in named.values():
        mapped |= {place for place, head in enumerate(heads) if _is_called(head, place, text)}
    for column in map(TableColumn.of, header):
        text = named.get(column.name, "")
        at = [
            place
            for place, head in enumerate(heads)
            if (_is_called(head, place, text) if text else
                place not in mapped and _is_named(head, column))
        ]  # fmt: skip
        if len(at) > 1:
            answers = [(f"{column.name}=#{n + 1}", f"column {n + 1}") for n in at]
            raise undecided(
                f"{path}: {len(at)} columns may be {column.name}", "sheet.columns", answers
            )
        if at:
            found[column] = at[0]
    return found


def _is_named(head: _Head, column: TableColumn) -> bool:
    """Return whether a heading is our name of a column; numbers of positions have no unit."""
    known = bool(column.quantity) or not head.unit
    return known and folded(head.name) == folded(column.name)


def _is_called(head: _Head, place: int, text: str) -> bool:
    return text == f"#{place + 1}" or folded(text) == folded(head.text)


def _not_mapped(table: Table, header: Header, found: Mapping[TableColumn, int]) -> BagError:
    """Return what is missing, and the option that says which column it is."""
    missing = [name for name in header if TableColumn.of(name) not in found]
    free = [text for n, text in enumerate(table.header) if text and n not in found.values()]
    advice = ". Save it with commas between the columns"
    if len(table.header) > 1:
        entry = f"{TableColumn.of(missing[0]).name}={free[0] if free else 'ITS NAME'}"
        advice = f". State one with another name by {option('sheet.columns', entry)}"
    return BagError(
        f"{table.path}: no column {', '.join(missing)}: found "
        f"{', '.join(map(repr, table.header)) or 'nothing'}; expected CSV with the columns "
        f"'{','.join(header)}', in any unit and order{advice}{_other_forms()}"
    )


def _mapped(
    table: Table,
    heads: Sequence[_Head],
    places: Mapping[TableColumn, int],
    settings: SheetSettings,
    known: Mapping[str, Known],
) -> Reading:
    """Return the rows in metres, radians, seconds, and with numbers from 0."""
    columns, theirs, uses, remarks = [], dict[str, str](), dict[str, Use](), list[str]()
    for column, place in places.items():
        head, cells = heads[place], tuple(row[place] for _, row in table.lines)
        uses[column.name] = Use(place, head.text, (head.unit,) if head.unit else ())
        theirs[column.header] = repr(head.text)
        if column.quantity:
            unit = _unit(table, column, head, settings)
            cells = tuple(_in_si(cell, UNITS[column.quantity][unit]) for cell in cells)
            if not head.unit:
                theirs[column.header] = phrase("{0} in {1}", repr(head.text), unit)
        elif column.name in known:
            firsts = "0" if folded(head.name) == "ballstep" else settings.counted_from or "01"
            where = str(table.path)
            cells, from_one = _numbers(where, column.name, cells, known[column.name], firsts)
            remarks += [phrase("{0} counts from 1", column.name)] if from_one else []
        columns.append(cells)
    lines = zip((number for number, _ in table.lines), zip(*columns, strict=True), strict=True)
    header = tuple(column.header for column in places)
    return Reading(
        Table(table.path, header, tuple(lines)),
        phrase("text in {0}, {1} between the columns", "utf-8", phrase("commas")),
        theirs,
        tuple(text for n, text in enumerate(table.header) if n not in places.values()),
        remarks=tuple(remarks),
        uses=uses,
        head=table.header,
        form_head=table.header,
    )


def _numbers(
    where: str, name: str, cells: tuple[str, ...], known: Known, firsts: str
) -> tuple[tuple[str, ...], bool]:
    """Return numbers from 0, and whether they counted from 1; what is none as it stands."""
    given = [cell for cell in cells if cell]
    if not all(cell.isascii() and cell.isdigit() and len(cell) < 10 for cell in given):
        return cells, False
    planned = tuple(range(len(given))) if known.listed else known.numbers
    numbers, from_one = as_planned(where, name, [*map(int, given)], planned, firsts)
    found = iter(numbers)
    return tuple(str(next(found)) if cell else "" for cell in cells), from_one


def _unit(table: Table, column: TableColumn, head: _Head, settings: SheetSettings) -> str:
    """Return the unit that a heading states, or else the settings; ask where neither does."""
    setting = unit_setting(column.name, column.quantity)
    unit = head.unit or str(getattr(settings, setting.removeprefix("sheet.")))
    known = UNITS[column.quantity]
    if unit in _NO_NUMBERS_ALONE or (unit and unit not in known):
        raise BagError(
            f"{table.path}: the unit of {head.text!r} is none of numbers of {column.quantity}: "
            f"write one of {', '.join(u for u in known if u not in _NO_NUMBERS_ALONE)} there, and "
            f"convert the numbers if need be{_other_forms()}"
        )
    if not unit:
        usual = _LIKELY.get(column.quantity, ("s", "ms", "us", "ns"))
        ways = " or ".join(option(setting, each) for each in usual)
        raise UndecidedError(
            f"{table.path}: the column {head.text!r} ({column.name}) states no unit",
            f"say which: {ways} (or write it behind the name, as '{head.text} [{usual[0]}]')",
            question=Question(setting, tuple((each, each) for each in usual)),
        )
    return unit


def _in_si(cell: str, size: Decimal) -> str:
    """Return a number in SI units, exactly; what is none as it stands: it is refused later."""
    try:
        return str(Decimal(cell) * size)
    except ArithmeticError:
        return cell


@cache
def form_reader() -> FormReader:
    """Return what an installed package reads tables with; without any, a map of columns."""
    for name in plugins.names(plugins.TABLES):
        return cast("FormReader", plugins.load(plugins.TABLES, name, "reader of tables"))
    return ColumnMap()


def reads_any_form() -> bool:
    """Return whether a package is installed that reads tables of any form."""
    return bool(plugins.names(plugins.TABLES))


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
    source = parquet_as_table(source)
    own = read_own_form(source, headers)
    if own is not None:
        _require_as_named(own, settings)
        return Reading(own)
    given, in_memory = settings, isinstance(source, Table) and source.in_memory
    if isinstance(source, Path):
        settings = remembered(source, settings)
    found = form_reader().read(source, headers, settings, known)
    return replace(
        found,
        table=replace(found.table, in_memory=in_memory),
        sources=() if settings == given else (phrase("answers of {0}", FILE),),
        stated=settings,
    )


def _require_as_named(own: Table, settings: SheetSettings) -> None:
    """Raise DataError where a column of our own form is stated to be another one."""
    ours = {column: TableColumn.of(column).name for column in own.header}
    for name, text in settings.named().items():
        if ours.get(text, name) != name:
            raise DataError(
                f"{own.path}: {text} is its {ours[text]}, but sheet.columns says {name}={text}: "
                "give the column another heading, or leave this out"
            )


def remembered(path: Path, settings: SheetSettings) -> SheetSettings:
    """Return the settings, and where they are silent what is remembered of such a head.

    Raises ConfigurationError for a file of forms that cannot be read.
    """
    forms = _forms(path.parent / FILE)
    heads = {*form_reader().heading_rows(path)} if forms else set[tuple[str, ...]]()
    known = next((known for head, known in forms if head in heads), AS_IT_STANDS)
    more = {name: value for name, value in _stated(known).items()
            if getattr(settings, name) == getattr(AS_IT_STANDS, name)}  # fmt: skip
    return load(SheetSettings, _stated(settings) | more, str(path)) if more else settings


def of_tables(paths: Sequence[Path], settings: SheetSettings) -> dict[Path, SheetSettings]:
    """Return the settings for each of several tables: columns are those that it has.

    Raises BagError for a column that none of them has.
    """
    if len(paths) < 2 or not settings.columns:
        return dict.fromkeys(paths, settings)
    named, found = settings.named(), dict[Path, SheetSettings]()
    for path in paths:
        texts = {folded(text) for head in form_reader().heading_rows(path) for text in head}
        there = tuple(f"{name}={t}" for name, t in named.items() if folded(t) in texts)
        found[path] = replace(settings, columns=there)
    every = {entry for own in found.values() for entry in own.columns}
    for name, text in named.items():
        if f"{name}={text}" not in every:
            names = " and ".join(map(str, paths))
            raise BagError(f"{names}: sheet.columns: no column is called {text!r} in any of them")
    return found


def remember(path: Path, head: Sequence[str], settings: SheetSettings) -> Path:
    """Remember the settings for tables with such a head, beside ``path``; return the file."""
    file = path.parent / FILE
    forms = [*(form for form in _forms(file) if form[0] != tuple(head)), (tuple(head), settings)]
    entries = [{"head": list(head), "sheet": _stated(known)} for head, known in forms]
    text = yaml.safe_dump(entries, allow_unicode=True, sort_keys=False, default_flow_style=None)
    write_atomically(file, f"# How tables with these heads are read (rotcal, --remember).\n{text}")
    return file


def _stated(settings: SheetSettings) -> dict[str, Any]:
    values = asdict(settings).items()
    return {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in values
        if value != getattr(AS_IT_STANDS, name)
    }


def _forms(file: Path) -> list[tuple[tuple[str, ...], SheetSettings]]:
    if not is_plain_file(file):
        return []
    with read_errors_as(file, ConfigurationError):
        entries = load_yaml(read_text(file), str(file))
    if not isinstance(entries, list) or not all(isinstance(e, dict) for e in entries):
        raise ConfigurationError(f"{file}: expected a list of forms: correct it, or remove it")
    return [
        (
            tuple(map(str, entry.get("head", ()))),
            load(SheetSettings, entry.get("sheet"), str(file)),
        )
        for entry in entries
    ]
