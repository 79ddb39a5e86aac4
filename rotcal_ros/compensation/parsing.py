"""Parses a controller's files: every error names file and row."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from re import Match

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import BagError


def only_file(files: Mapping[str, str], suffix: str) -> tuple[str, str]:
    """Return name and text of the one file ending with ``suffix``; raises BagError."""
    found = [name for name in files if name.upper().endswith(suffix.upper())]
    if len(found) != 1:
        raise BagError(
            f"{len(found)} files end with {suffix}, expected one, among {', '.join(files) or '-'}"
        )
    return found[0], files[found[0]]


def parse_rows(name: str, lines: list[str], columns: int, separator: str | None) -> Floats:
    """Return :func:`numbers` of at least two rows whose first column ascends."""
    data = numbers(name, lines, columns, separator)
    if len(data) < 2:
        raise BagError(f"{name}: {len(data)} rows, expected at least 2")
    falling = np.diff(data[:, 0]) <= 0.0
    if np.any(falling):
        row = int(np.argmax(falling)) + 2
        raise BagError(f"{name}, row {row}: the position does not ascend from the row before")
    return data


def numbers(name: str, lines: list[str], columns: int, separator: str | None) -> Floats:
    """Return the numbers (n, columns) of ``lines``; BagError names file and row."""
    rows = []
    for row, line in enumerate(lines, start=1):
        cells = line.split(separator)
        if len(cells) != columns:
            raise BagError(f"{name}, row {row}: {len(cells)} columns, expected {columns}")
        rows.append([number(cell, f"{name}, row {row}") for cell in cells])
    return np.array(rows, dtype=np.float64).reshape(-1, columns)


def matches(name: str, text: str, pattern: str, example: str) -> Iterator[tuple[str, Match[str]]]:
    """Yield place and match of every line of ``text``; BagError for a line unlike ``example``."""
    for row, line in enumerate(text.splitlines(), start=1):
        match = re.fullmatch(pattern, line.strip())
        if match is None:
            raise BagError(f"{name}, line {row}: {line!r} is not a line such as {example}")
        yield f"{name}, line {row}", match


def number(text: str, where: str) -> float:
    """Return ``text`` as a finite number, or raise BagError naming ``where``."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise BagError(f"{where}: found {text.strip()!r}, expected a number")
    return value


def integer(text: str, where: str) -> int:
    """Return ``text`` as a whole number, or raise BagError naming ``where``."""
    try:
        return int(text)
    except ValueError as error:
        raise BagError(f"{where}: found {text.strip()!r}, expected a whole number") from error
