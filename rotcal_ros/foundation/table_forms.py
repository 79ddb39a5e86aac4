"""How a table is read: as one of our own, by a map of its columns, or as a package understands it.

What a person says of a table stands in the group ``sheet`` of settings, or in the file
``table_forms.yaml`` beside the table: a list of heads as they stand there, each with settings of
that group. A table with the same head needs no question then.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path
from typing import Any, Final, cast

import yaml

from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.column_map import ColumnMap
from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.settings import load
from rotcal_ros.foundation.table_columns import AS_IT_STANDS, SheetSettings, TableColumn, folded
from rotcal_ros.foundation.table_reading import FormReader, Known, Reading
from rotcal_ros.foundation.tables import Header, Table, parquet_as_table, read_own_form
from rotcal_ros.foundation.untrusted import is_plain_file, load_yaml, read_errors_as, read_text

FILE: Final = "table_forms.yaml"


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
