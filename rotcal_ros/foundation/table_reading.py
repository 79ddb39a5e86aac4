"""How a table is read: as one of our own, by a map of its columns, or as a package understands it.

What a person says of a table stands in the group ``sheet`` of settings, or in the file
``table_forms.yaml`` beside the table: a list of heads as they stand there, each with settings of
that group. A table with the same head needs no question then.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, Final, Protocol, TypeAlias, cast

import yaml

from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.settings import load
from rotcal_ros.foundation.table_columns import AS_IT_STANDS, SheetSettings, folded, undecided
from rotcal_ros.foundation.tables import Header, Table, own_table
from rotcal_ros.foundation.untrusted import load_yaml, plain_file, read_text, reading

FILE: Final = "table_forms.yaml"
Pass: TypeAlias = "tuple[int, bool]"
"""Number of the run, from 0, and whether it goes down."""


@dataclass(frozen=True, slots=True)
class Use:
    """Where a column is: ``place`` of its cell in a row, from 0, and the units of its heading."""

    place: int
    text: str
    units: tuple[str, ...] = ()


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
    where the table came to its angles more than once. ``sources`` say where targets and table
    angles are from, ``stated`` what a person said of the table; ``form_head`` is its head as it
    stands, by which tables of the same form are known.
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
    sources: tuple[str, ...] = ()
    stated: SheetSettings = AS_IT_STANDS
    form_head: tuple[str, ...] = ()

    def line(self) -> str:
        """Return it in one line; empty for a table of our own form that states everything."""
        if not self.form:
            sources = "; ".join(self.sources)
            return f"{self.table.path} (our own form): {sources}" if sources else ""
        columns = ", ".join(f"{ours} = {theirs}" for ours, theirs in self.columns.items())
        parts = [f"{self.table.path} ({self.form}): {columns}", *self.remarks, *self.sources]
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
            return [
                f"{self.table.path}: a table of our own form, read as it stands: {header}",
                *(f"  {source}" for source in self.sources),
            ]
        return [
            f"{self.table.path}: {self.form}, {len(self.table.lines)} rows",
            *(f"  {ours:<16} {theirs}" for ours, theirs in self.columns.items()),
            *(f"  {remark}" for remark in (*self.remarks, *self.sources)),
            *([f"  not needed: {', '.join(self.aside)}"] if self.aside else []),
            *(f"  row {row} left out: {why}" for row, why in self.left_out),
            *(line for other in self.beside for line in other.lines()),
        ]


class FormReader(Protocol):
    """Reads tables of another form than ours."""

    def read(
        self,
        source: Path | Table,
        headers: Sequence[Header],
        settings: SheetSettings,
        known: Callable[[], Mapping[str, Known]],
    ) -> Reading:
        """Return the table with one of our ``headers``; see :func:`read_any`."""

    def heads(self, path: Path) -> Iterable[tuple[str, ...]]:
        """Yield the rows that may be the head of the table: the cells that are not empty."""


@cache
def form_reader() -> FormReader:
    """Return what an installed package reads tables with; without any, a map of columns."""
    for name in plugins.names(plugins.TABLES):
        return cast("FormReader", plugins.load(plugins.TABLES, name, "reader of tables"))
    from rotcal_ros.foundation.column_map import ColumnMap

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
    own = own_table(source, headers)
    if own is not None:
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


def as_planned(
    where: str, name: str, numbers: Sequence[int], planned: Sequence[int], firsts: str
) -> tuple[list[int], bool]:
    """Return numbers as the plan has them, and whether they count from 1.

    They are those of the plan as they stand, or its first, second and so on; ``firsts``: "0", "1"
    or "01", from what they may count. Raises UndecidedError where both may be.
    """
    if not planned or not numbers:
        return list(numbers), False
    ways = {"0": {n: n for n in planned}, "1": dict(enumerate(planned, start=1))}
    able = [first for first in firsts if ways[first].keys() >= set(numbers)]
    if len(able) > 1:
        readings = (f"counted from 0, {planned[0]} was not measured",
                    "counted from 1, the last was not")  # fmt: skip
        raise undecided(
            f"{where}: {name} {min(numbers)} to {max(numbers)}: {'; '.join(readings)}",
            "sheet.counted_from",
            tuple(zip("01", readings, strict=True)),
        )
    way = ways[able[0]] if able else {}
    return [way.get(n, n) for n in numbers], able == ["1"]


def remembered(path: Path, settings: SheetSettings) -> SheetSettings:
    """Return the settings, and where they are silent what is remembered of such a head.

    Raises ConfigurationError for a file of forms that cannot be read.
    """
    forms = _forms(path.parent / FILE)
    heads = {*form_reader().heads(path)} if forms else set[tuple[str, ...]]()
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
        texts = {folded(text) for head in form_reader().heads(path) for text in head}
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
    if not plain_file(file):
        return []
    with reading(file, ConfigurationError):
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
