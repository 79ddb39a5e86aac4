"""Plain tables of our own form: comma-separated, one header line, ``#`` begins a comment line.

Metres and radians; indices count from 0. Every error names file and row. The columns depend on the
method: see the ``table`` modules of ``methods``. ``sheets`` makes one of a table in another form.
"""

from __future__ import annotations

import csv
import hashlib
import io
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence, Sized
from dataclasses import dataclass
from math import isfinite
from os import PathLike
from pathlib import Path
from typing import Any, Final

from rotcal_ros.foundation import untrusted
from rotcal_ros.foundation.dataframes import arrow
from rotcal_ros.foundation.errors import BagError, DataError

Header = tuple[str, ...]

_WORKBOOKS: Final = (".xlsx", ".xlsm", ".xlsb", ".xls", ".ods")
PARQUET: Final = ".parquet"
_MOST_CELLS: Final = 20_000_000
"""Of a Parquet file, which may unpack to far more than it has bytes."""
_TEXTS: Final = (".csv", ".txt", ".tsv", ".dat", ".asc", ".prn", "")
_OTHERS: Final = (".mcap", ".db3", ".zstd", ".json", ".yaml", ".yml", ".html")
"""Endings of files that are not tables."""
_SEPARATED: Final = re.compile(r"\S *[,;\t|] *\S|\S\s{2,}\S|^(\S+ )+[-+.\d]\S*$", re.MULTILINE)
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
            raise DataError(
                f"{self.place}: {name} must be a whole number from 0, found {text!r}: "
                "correct the row, or leave it out"
            )
        return int(text)

    def number(self, name: str) -> float:
        """Return a cell as a finite number."""
        text = self.cells[name]
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not isfinite(value):
            raise DataError(
                f"{self.place}: {name} must be a finite number, found {text!r}: correct the row, "
                "or leave it out"
            )
        return value

    def metres(self, name: str, farthest: float = _FARTHEST) -> float:
        """Return a cell as a finite number of metres of plausible size."""
        value = self.number(name)
        if abs(value) > farthest:
            raise DataError(
                f"{self.place}: {name} is {value:g} m, more than {farthest:g} m; are these "
                "millimetres? State the unit in the head of the column, as [mm]"
            )
        return value

    def radians(self, name: str, largest: float) -> float:
        """Return a cell as a finite number of radians of plausible size."""
        value = self.number(name)
        if abs(value) > largest:
            raise DataError(
                f"{self.place}: {name} is {value:g} rad, more than {largest:g}; are these "
                "arcseconds? State the unit in the head of the column, as [arcsec]"
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
                    f"({','.join(self.header)}), found {len(cells)}: correct the line, or leave "
                    "it out"
                )
            row = dict(zip(self.header, cells, strict=True))
            rows.append(Row(f"{self.path}, row {number}", row))
        if not rows:
            raise DataError(
                f"{self.path}: the table has a header but no rows: add what was measured below it"
            )
        return rows


def is_table(path: Path) -> bool:
    """Return whether ``path`` is a table: a workbook, or a text with several columns."""
    ending = path.suffix.lower()
    if ending in (".csv", PARQUET) or ending in _WORKBOOKS:
        return True
    if ending in _OTHERS or not untrusted.is_plain_file(path):
        return False
    with untrusted.open_plain(path) as file:
        begin = file.read(_LOOK)
    # UTF-16 without a mark, of letters that ASCII has: every second byte is zero
    zeros = sorted(begin[parity::2].count(0) for parity in (0, 1))
    utf16 = begin.startswith((b"\xff\xfe", b"\xfe\xff")) or (
        zeros[0] == 0 and zeros[1] > len(begin) // 4
    )
    if utf16 or begin.startswith(untrusted.WORKBOOKS):
        return ending in _TEXTS
    text = begin.decode("utf-8-sig", errors="replace")
    return "\0" not in text and _SEPARATED.search(text) is not None


def is_workbook(path: Path) -> bool:
    """Return whether ``path`` is a file of a spreadsheet program, by its first bytes."""
    if not untrusted.is_plain_file(path):
        return False
    with untrusted.open_plain(path) as file:
        return file.read(8).startswith(untrusted.WORKBOOKS)


def read_own_form(source: Path | Table, headers: Sequence[Header]) -> Table | None:
    """Return a table of our own form; None for others.

    Raises BagError when the file cannot be read, DataError for a line that is no CSV.
    """
    if not has_own_form(source, headers):
        return None
    return source if isinstance(source, Table) else read_table(source)


def has_own_form(source: Path | Table, headers: Sequence[Header]) -> bool:
    """Return whether a table has our own form: UTF-8, commas, one of ``headers`` first.

    Raises BagError when the file cannot be read.
    """
    if isinstance(source, Table):
        return source.header in headers
    with (
        untrusted.read_errors_as(source, BagError, "the table "),
        untrusted.open_plain(source) as file,
    ):
        begin = file.read(_LOOK)
    begins = begin.decode("utf-8-sig", errors="replace").splitlines()
    first = next((line for line in begins if line.strip() and line.lstrip()[0] != "#"), "")
    return tuple(cell.strip() for cell in first.split(",")) in headers


def read_table(path: Path) -> Table:
    """Read a table file; raises BagError when that is not possible."""
    try:
        text = untrusted.read_text(path, "utf-8-sig")
    except UnicodeDecodeError as error:
        raise BagError(
            f"cannot read the table {path}: it is not text in UTF-8: save it as CSV UTF-8 "
            f"({error})"
        ) from error
    except OSError as error:
        raise BagError(f"cannot read the table {path}: {untrusted.cause_of(error)}") from error
    lines = [
        (number, tuple(cell.strip() for cell in cells))
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
        for cells in csv_rows(line, f"{path}, row {number}")
    ]
    return Table(path, lines[0][1] if lines else (), tuple(lines[1:]))


def parquet_as_table(source: Path | Table) -> Path | Table:
    """Return a Parquet file as its table, everything else as it is.

    Raises BagError for one that cannot be read, ConfigurationError without pyarrow.
    """
    if isinstance(source, Table) or source.suffix.lower() != PARQUET:
        return source
    pa, parquet = arrow()
    try:
        with untrusted.open_plain(source) as raw, parquet.ParquetFile(raw) as file:
            known = file.metadata
            if known.num_rows * known.num_columns > _MOST_CELLS:
                raise BagError(f"{source} has {known.num_rows} rows, too many for a table")
            columns = file.read().to_pydict()
    except (OSError, pa.ArrowException) as error:
        raise BagError(f"cannot read the table {source}: {error}") from error
    lines = enumerate(tuple(map(_cell, row)) for row in zip(*columns.values(), strict=True))
    return Table(source, tuple(columns), tuple(lines))


def csv_rows(text: str, name: str) -> Iterator[list[str]]:
    """Yield the cells of every row of CSV; DataError names ``name`` and a line that is not CSV."""
    reader = csv.reader(io.StringIO(text))
    try:
        yield from reader
    except csv.Error as error:
        raise DataError(
            f"{name}, line {reader.line_num}: not a table row: {error}: look for a quotation mark "
            "that is not closed"
        ) from error


def require_header(table: Table, headers: Sequence[Header]) -> None:
    """Raise BagError unless the table has one of ``headers``."""
    if table.header not in headers:
        expected = " or ".join(f"'{','.join(header)}'" for header in headers)
        raise BagError(
            f"{table.path}: expected the header line {expected}, found '{','.join(table.header)}'"
        )


def table_hashes(*tables: Table) -> dict[str, str]:
    """Return the SHA-256 of the files of tables by their names; in memory, of the table as CSV."""
    return {table.path.name: hashlib.sha256(_content(table)).hexdigest() for table in tables}


def _content(table: Table) -> bytes:
    if not table.in_memory:
        return untrusted.read_bytes(table.path)
    rows = (table.header, *(cells for _, cells in table.lines))
    return "".join(",".join(row) + "\n" for row in rows).encode()


def as_path_or_table(source: Any, name: str) -> Path | Table:
    """Return a file as its path, what is in memory as a table called ``name``.

    In memory it is a DataFrame, a mapping of columns, or a list of rows: mappings, or sequences
    below a row of names.

    Raises BagError for what is neither.

    >>> as_path_or_table([("angle", "deviation"), (0, 1.5)], "mine").header
    ('angle', 'deviation')
    """
    if isinstance(source, str | PathLike):
        return Path(source)
    columns, rows = _columns_and_rows(source, name)
    lines = enumerate(tuple(map(_cell, row)) for row in rows)
    return Table(Path(name), tuple(map(str, columns)), tuple(lines), in_memory=True)


def _columns_and_rows(source: Any, name: str) -> tuple[Iterable[Any], Iterable[Any]]:
    match source:
        case _ if hasattr(source, "iter_rows"):
            return source.columns, source.iter_rows()
        case _ if hasattr(source, "itertuples"):
            return source.columns, source.itertuples(index=False, name=None)
        case Mapping() if len({len(v) for v in source.values() if isinstance(v, Sized)}) == 1:
            return source, zip(*source.values(), strict=True)
        case [Mapping() as first, *_] if all(isinstance(row, Mapping) for row in source):
            return first, ([row.get(column) for column in first] for row in source)
        case [[str(), *_] as first, *rows] if all(isinstance(r, list | tuple) for r in rows):
            return first, rows
    raise BagError(
        f"{name}: {type(source).__name__} is no table: give a file, a DataFrame, a dict of "
        "columns of one length, or a list of rows below a row of their names"
    )


def _cell(value: object) -> str:
    """Return a cell as CSV has it: floats to the last bit, whole numbers without a point.

    Whole numbers become floats where a column has an empty cell.
    """
    text = str(value).strip()
    if text in ("None", "nan", "NaT", "<NA>"):
        return ""
    return text.removesuffix(".0") if isinstance(value, float) else text
