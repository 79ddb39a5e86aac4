"""What a person says of tables of one form: settings, and the file that remembers them.

The file ``table_forms.yaml`` lies beside the tables: a list of heads as they stand there, each
with the settings of the group ``sheet``. A table with the same head needs no question then.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import yaml

from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.settings import expert, load, setting
from rotcal_ros.foundation.sheets.files import Cell, sheets
from rotcal_ros.foundation.sheets.words import ANGLE, LENGTH, TIME, UNITS, TableColumn, folded
from rotcal_ros.foundation.untrusted import load_yaml, plain_file, read_text, reading

FILE: Final = "table_forms.yaml"
_LOOKED_AT: Final = 100
"""Rows among which a head is searched for."""


@dataclass(frozen=True)
class SheetSettings:
    """How a table of numbers is read, where the table does not say so itself."""

    length_unit: str = setting(
        "", doc="unit of lengths whose column states none", choices=("", *UNITS[LENGTH])
    )
    angle_unit: str = setting(
        "", doc="unit of table angles whose column states none", choices=("", *UNITS[ANGLE])
    )
    reading_unit: str = expert(
        "", doc="unit of deviations and other readings of angles whose column states none",
        choices=("", *UNITS[ANGLE]),
    )  # fmt: skip
    angles: str = expert(
        "", doc="table angles that count where table and plan differ: those of table or plan",
        choices=("", "table", "plan"),
    )  # fmt: skip
    values: str = expert(
        "", doc="what stands beside commanded angles: deviations, or positions (actual angles)",
        choices=("", "deviations", "positions"),
    )  # fmt: skip
    up: str = expert("", doc="direction in which the table angle grows, as the table calls it")
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
    table: str = expert("", doc="which of several tables side by side on a sheet, from 1")

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


def texts_of(cells: Iterable[Cell]) -> tuple[str, ...]:
    """Return the cells of a row that are not empty, as texts."""
    return tuple(str(cell) for cell in cells if cell != "")


def remembered(path: Path, settings: SheetSettings) -> SheetSettings:
    """Return the settings, and where they are silent what is remembered of such a head.

    Raises ConfigurationError for a file of forms that cannot be read.
    """
    forms = _forms(path.parent / FILE)
    grids = sheets(path) if forms else []
    heads = {texts_of(cells) for grid in grids for _, cells in grid.rows[:_LOOKED_AT]}
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
        rows = (cells for grid in sheets(path) for _, cells in grid.rows[:_LOOKED_AT])
        texts = {folded(text) for cells in rows for text in texts_of(cells)}
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
