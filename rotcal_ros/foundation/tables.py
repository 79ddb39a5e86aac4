"""Plain tables: comma-separated, one header line, ``#`` begins a comment line.

Metres and radians; indices count from 0. Every error names file and row. The columns depend on the
method: see the ``table`` modules of ``methods``.
"""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Final

from rotcal_ros.foundation.errors import BagError, DataError
from rotcal_ros.foundation.untrusted import open_plain, plain_file, read_bytes, read_text, why

Header = tuple[str, ...]

_SPREADSHEETS: Final = (".xlsx", ".xlsm", ".xls", ".ods")
_OFFICE: Final = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")
"""First bytes of the files of spreadsheet programs."""
_TEXTS: Final = (".csv", ".txt", ".tsv", ".dat", "")
_OTHERS: Final = (".mcap", ".db3", ".zstd", ".json", ".yaml", ".yml", ".html")
"""Endings of files that are not tables."""
_SEPARATORS: Final = {";": "semicolons", "\t": "tabs"}
_LOOK: Final = 4096
_FARTHEST: Final = 50.0
"""Metres; no target or length of a calibration is farther away."""


@dataclass(frozen=True)
class Row:
    """One line of a table; ``place`` names file and line in error texts."""

    place: str
    cells: Mapping[str, str]

    def index(self, name: str) -> int:
        """Return a cell as an index from 0."""
        text = self.cells[name]
        if not (text.isascii() and text.isdigit()) or len(text) > 9:
            raise DataError(f"{self.place}: {name} must be a whole number from 0, found {text!r}")
        return int(text)

    def number(self, name: str) -> float:
        """Return a cell as a finite number."""
        text = self.cells[name]
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not isfinite(value):
            raise DataError(f"{self.place}: {name} must be a finite number, found {text!r}")
        return value

    def metres(self, name: str, farthest: float = _FARTHEST) -> float:
        """Return a cell as a finite number of metres of plausible size."""
        value = self.number(name)
        if abs(value) > farthest:
            raise DataError(
                f"{self.place}: {name} is {value:g} m, more than {farthest:g} m; are these "
                "millimetres? Tables are in metres"
            )
        return value

    def radians(self, name: str, largest: float) -> float:
        """Return a cell as a finite number of radians of plausible size."""
        value = self.number(name)
        if abs(value) > largest:
            raise DataError(
                f"{self.place}: {name} is {value:g} rad, more than {largest:g}; are these "
                "arcseconds? Tables are in radians"
            )
        return value

    def point(self, farthest: float = _FARTHEST) -> tuple[float, float, float]:
        """Return the columns x_m, y_m, z_m."""
        x, y, z = (self.metres(name, farthest) for name in ("x_m", "y_m", "z_m"))
        return x, y, z


@dataclass(frozen=True)
class Table:
    """A table: its header and the cells of its lines by line number.

    ``path`` is its file, or a name alone for what is ``in_memory``.
    """

    path: Path
    header: Header
    lines: tuple[tuple[int, tuple[str, ...]], ...]
    in_memory: bool = False

    def rows(self) -> list[Row]:
        """Return the lines with their cells by column.

        Raises DataError for a line of another length, and for a table without lines.
        """
        rows = []
        for number, cells in self.lines:
            if len(cells) != len(self.header):
                raise DataError(
                    f"{self.path}, row {number}: expected {len(self.header)} values "
                    f"({','.join(self.header)}), found {len(cells)}"
                )
            row = dict(zip(self.header, cells, strict=True))
            rows.append(Row(f"{self.path}, row {number}", row))
        if not rows:
            raise DataError(f"{self.path}: the table has a header but no rows")
        return rows


def is_table(path: Path) -> bool:
    """Return whether ``path`` is a plain table: ends in .csv, or its first line has columns.

    Raises BagError for a spreadsheet, whatever its name is.
    """
    ending = path.suffix.lower()
    if ending in _OTHERS or not plain_file(path):
        return ending == ".csv"
    with open_plain(path) as file:
        begin = file.read(_LOOK)
    if ending in _SPREADSHEETS or (ending in _TEXTS and begin.startswith(_OFFICE)):
        raise BagError(
            f"{path} is a spreadsheet: save it as CSV (comma-separated, UTF-8) and name that file"
        )
    if ending == ".csv":
        return True
    if b"\0" in begin:
        return False
    text = begin.decode("utf-8-sig", errors="replace")
    first = next((line for line in text.splitlines() if line.strip() and line[0] != "#"), "")
    return any(separator in first for separator in (",", *_SEPARATORS))


def read_table(path: Path) -> Table:
    """Read a table file; raises BagError when that is not possible."""
    try:
        text = read_text(path, "utf-8-sig")
    except UnicodeDecodeError as error:
        raise BagError(
            f"cannot read the table {path}: it is not text in UTF-8: save it as CSV UTF-8 "
            f"({error})"
        ) from error
    except OSError as error:
        raise BagError(f"cannot read the table {path}: {why(error)}") from error
    lines = [
        (number, tuple(cell.strip() for cell in cells))
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
        for cells in csv_rows(line, f"{path}, row {number}")
    ]
    header = lines[0][1] if lines else ()
    for separator, name in _SEPARATORS.items():
        if len(header) == 1 and separator in header[0]:
            raise BagError(
                f"{path}: its columns are separated by {name}: save it with commas between the "
                "columns, and points in the numbers"
            )
    return Table(path, header, tuple(lines[1:]))


def csv_rows(text: str, name: str) -> Iterator[list[str]]:
    """Yield the cells of every row of CSV; DataError names ``name`` and a line that is not CSV."""
    reader = csv.reader(io.StringIO(text))
    try:
        yield from reader
    except csv.Error as error:
        raise DataError(f"{name}, line {reader.line_num}: not a table row: {error}") from error


def require_header(table: Table, headers: Sequence[Header]) -> None:
    """Raise BagError unless the table has one of ``headers``."""
    if table.header not in headers:
        expected = " or ".join(f"'{','.join(header)}'" for header in headers)
        raise BagError(
            f"{table.path}: expected the header line {expected}, found '{','.join(table.header)}'"
        )


def hashes(*tables: Table) -> dict[str, str]:
    """Return the SHA-256 of the files of tables by their names; in memory, of the table as CSV."""
    return {table.path.name: hashlib.sha256(_content(table)).hexdigest() for table in tables}


def _content(table: Table) -> bytes:
    if not table.in_memory:
        return read_bytes(table.path)
    rows = (table.header, *(cells for _, cells in table.lines))
    return "".join(",".join(row) + "\n" for row in rows).encode()
