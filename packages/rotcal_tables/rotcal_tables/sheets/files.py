"""Files as grids of cells: workbooks by python-calamine, texts in any encoding."""

from __future__ import annotations

import csv
import io
import json
import re
import subprocess
import sys
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeAlias

from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.language import noted, phrase
from rotcal_ros.foundation.untrusted import (
    LARGEST_FILE,
    WORKBOOKS,
    load_json,
    read_bytes,
    read_errors_as,
)
from rotcal_tables.sheets import workbook

Cell: TypeAlias = "str | float"
"""A text as it stands there, or what a workbook holds as a number."""


class TimeCell(str):
    """What a workbook holds as a time, in hours, minutes and seconds."""

    __slots__ = ()


READERS: Final = "rotcal_tables.readers"
"""Functions that return the rows of an instrument's file, its head first; None for another."""
_MARKS: Final = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
_OLDER: Final = ("cp1252", "cp850", "gb18030", "cp932", "cp1250", "cp1251", "cp949")
"""Encodings that any bytes may be in: the names of the columns show which one it is."""
_GAP: Final = re.compile(r"\s{2,}|\t")
_COMMENT: Final = re.compile(r"\s*(?:[#%]|//)")
_FORMULA: Final = re.compile(r'="([^"]*)"')
"""A text that a spreadsheet program must not turn into something else."""
_RULE: Final = re.compile(r"[-=:+_ ]*")
"""What lines below a head are drawn with."""
_MOST: Final = 0.6
"""Share of the rows that a separator splits alike, where others are titles, means and notes."""
_STATED: Final = re.compile(r'^"?sep=(.)"?[;,\t]*$', re.IGNORECASE)
SEPARATORS: Final[dict[str, str]] = {
    ",": noted("commas"), ";": noted("semicolons"), "\t": noted("tabs"), "|": noted("bars"),
    "  ": noted("two spaces or more"), " ": noted("spaces"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Sheet:
    """The cells of a sheet or of a text: ``rows`` with their line numbers.

    ``form`` says in words what it is, "sheet Lengths" or "text in utf-8, semicolons"; ``name`` is
    that of the sheet, empty for a text.
    """

    form: str
    rows: tuple[tuple[int, tuple[Cell, ...]], ...]
    name: str = ""


def read_sheets(path: Path) -> list[Sheet]:
    """Return what the file at ``path`` may hold: a grid per sheet, or per way to read a text.

    Raises BagError for a file that cannot be read.
    """
    with read_errors_as(path, BagError, "the table "):
        data = read_bytes(path)
    if data.startswith(WORKBOOKS):
        return _sheets(path, data)
    texts = list(_texts(data))
    if texts and (own := _of_an_instrument(path, texts[0][1]) or _of_json(path, texts[0][1])):
        return [own]
    found = [sheet for encoding, text in texts for sheet in _ways(text, encoding)]
    if not found:
        raise BagError(
            f"cannot read the table {path}: it is neither text nor a workbook (.xlsx, .xls, "
            ".ods): save it as one of these"
        )
    return found


def _of_an_instrument(path: Path, text: str) -> Sheet | None:
    """Return the table in a file of an instrument's program; None for any other text."""
    for name in plugins.names(READERS):
        try:
            rows = plugins.load(READERS, name, "reader of files")(text)
        except BagError as error:
            raise BagError(f"{path}: {error}") from error
        if rows is not None:
            return Sheet(phrase("file of {0}", name), tuple(enumerate(rows, start=1)))
    return None


def _of_json(path: Path, text: str) -> Sheet | None:
    """Return the table in lines of JSON, an object each; None for any other text."""
    if not text.lstrip("\ufeff \r\n").startswith("{"):
        return None
    lines = [(n, line) for n, line in enumerate(text.splitlines(), start=1) if line.strip()]
    try:
        objects = [(number, dict[str, Any](load_json(line))) for number, line in lines]
    except (ValueError, TypeError) as error:
        raise BagError(f"{path}: expected an object of JSON on each line: {error}") from error
    head = dict.fromkeys(name for _, values in objects for name in values)
    rows = [(n, tuple("" if values.get(name) is None else str(values[name]) for name in head))
            for n, values in objects]  # fmt: skip
    return Sheet(phrase("lines of JSON"), ((0, tuple(head)), *rows))


def _sheets(path: Path, data: bytes) -> list[Sheet]:
    with suppress(zipfile.BadZipFile):
        _require_bounded(path, data)
    ran = subprocess.run(
        [sys.executable, "-I", workbook.__file__],
        input=data,
        capture_output=True,
        timeout=2 * workbook.WORK_S,
        check=False,
    )
    if ran.returncode == 1:
        why = ran.stderr.decode(errors="replace").strip().rpartition("\n")[2]
        raise BagError(
            f"cannot read the workbook {path}: {why}: save it again, or save it as CSV and name "
            "that file"
        )
    if ran.returncode:
        raise BagError(
            f"cannot read the workbook {path}: it has more than {workbook.CELLS:,} cells or "
            f"{workbook.CHARACTERS:,} characters, counted up to its last column and row, or takes "
            f"more than {workbook.MEMORY_BYTES:,} bytes of memory: copy the table into a new "
            "workbook, or save it as CSV and name that file"
        )
    read = (json.loads(line) for line in ran.stdout.splitlines())
    return [
        Sheet(phrase("sheet {0}", name), _cells(first, rows), name) for name, first, rows in read
    ]


def _require_bounded(path: Path, data: bytes) -> None:
    """Raise BagError for a workbook that would grow beyond all bounds when it is unpacked."""
    if not data.startswith(WORKBOOKS[0]):
        return
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        size = sum(member.file_size for member in archive.infolist())
    if size > LARGEST_FILE:
        raise BagError(
            f"cannot read the workbook {path}: unpacked it has more than the {LARGEST_FILE:,} "
            "bytes that we read: save it as CSV and name that file"
        )


def _cells(first: int, rows: Sequence[Sequence[Any]]) -> tuple[tuple[int, tuple[Cell, ...]], ...]:
    return tuple(
        (number, tuple(map(_cell, row)))
        for number, row in enumerate(rows, start=first)
        if any(value != "" for value in row)
    )


def _cell(value: Any) -> Cell:
    if isinstance(value, list):
        return TimeCell(*value)
    return value.strip() if isinstance(value, str) else float(value)


def _texts(data: bytes) -> Iterator[tuple[str, str]]:
    """Yield encodings with the text that ``data`` is in each; one alone where that is sure."""
    marked = next((name for mark, name in _MARKS.items() if data.startswith(mark)), None)
    wide = None if marked or b"\0" not in data else _wide(data)
    for encoding in [marked] if marked else [wide] if wide else ["utf-8"]:
        with suppress(UnicodeDecodeError):
            yield encoding, data.decode(encoding)
            return
    if b"\0" not in data:
        for encoding in _OLDER:
            with suppress(UnicodeDecodeError):
                yield encoding, data.decode(encoding)


def _wide(data: bytes) -> str | None:
    """Return UTF-16 of one order or the other, by where the zeros of plain letters are."""
    even, odd = data[:4096:2].count(0), data[1:4096:2].count(0)
    if max(even, odd) < 0.4 * len(data[:4096:2]) or min(even, odd) > 0:
        return None
    return "utf-16-be" if even > odd else "utf-16-le"


def _ways(text: str, encoding: str) -> Iterator[Sheet]:
    """Yield the grids that a text may be, for each separator that occurs in it."""
    if "\0" in text:
        return
    lines = text.splitlines()
    stated = _STATED.match(lines[0]) if lines else None
    separators = [stated[1]] if stated else [s for s in SEPARATORS if s in text]
    for lines_read in _with_comments(lines):
        split = {s: _rows("\n".join(lines_read), s) for s in separators or [","]}
        even = any(_is_even(rows) for s, rows in split.items() if rows and s.strip(" "))
        for separator, rows in split.items():
            if rows is not None and not (even and not separator.strip(" ")):
                rows = rows[1:] if stated else rows
                name = SEPARATORS.get(separator, repr(separator))
                form = phrase("text in {0}, {1} between the columns", encoding, phrase(name))
                yield Sheet(form, tuple(rows))


def _with_comments(lines: Sequence[str]) -> Iterator[list[str]]:
    """Yield lines without comments; then, if it begins with some, with these as its head."""
    bare = ["" if _COMMENT.match(line) else line for line in lines]
    yield bare
    head = next((k for k, line in enumerate(bare) if line.strip()), 0)
    if any(map(_COMMENT.match, lines[:head])):
        yield [_COMMENT.sub("", line, count=1) for line in lines[:head]] + bare[head:]


def _rows(text: str, separator: str) -> list[tuple[int, tuple[Cell, ...]]] | None:
    """Return the lines that are not empty, with their cells; None where that is no CSV."""
    splitting: dict[str, Callable[[str], Sequence[str]]] = {"  ": _GAP.split, " ": str.split}
    if separator in splitting:
        split = splitting[separator]
        numbered = enumerate(text.splitlines(), start=1)
        found = [(number, split(line.strip())) for number, line in numbered]
    else:
        lone = text.count('"') % 2  # a sign of seconds
        reader = csv.reader(
            io.StringIO(text, newline=""),
            delimiter=separator,
            quoting=csv.QUOTE_NONE if lone else csv.QUOTE_MINIMAL,
        )
        try:
            found = [(reader.line_num, cells) for cells in reader]
        except csv.Error:
            return None
    stripped = [
        (number, tuple(_FORMULA.sub(r"\1", cell.strip()) for cell in cells))
        for number, cells in found
    ]
    return [row for row in stripped if any(row[1]) and not _is_rule(row[1])]


def _is_even(rows: Sequence[tuple[int, tuple[Cell, ...]]]) -> bool:
    """Return whether a separator splits a head and most rows below it into as many cells.

    Decimal commas split aligned columns, but no head of words.
    """
    widths = Counter(len(cells) for _, cells in rows)
    width, count = widths.most_common(1)[0]
    head = next(cells for _, cells in rows if len(cells) == width)
    digits = sum(str(cell)[:1].isdigit() for cell in head[:1])
    return width > 1 and not digits and count >= _MOST * len(rows)


def _is_rule(cells: Sequence[str]) -> bool:
    return any("--" in cell or "==" in cell for cell in cells) and all(map(_RULE.fullmatch, cells))
