"""What the files of controllers have in common: rows to write, parsing, and the usual rule.

Columns are in degrees; an error of parsing names file and row. The rule of most controls is linear
between the rows of one turn, the same in every turn.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from re import Match

import numpy as np

from rotcal_ros.compensation.table import CompensationTable, average_directions
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.curves.interpolation import SAME_ANGLE
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import ARCSEC, DEGREE, TURN


def columns_deg(table: CompensationTable) -> tuple[Floats, Floats, Floats]:
    """Return angles, forward and reverse correction in degrees; a circle ends with 360.

    Raises ConfigurationError when the rows of a circle do not start at zero.
    """
    angles, up, down = table.angles, table.correction_forward, table.correction_reverse
    if table.closed:
        if abs(angles[0]) > SAME_ANGLE:
            raise ConfigurationError(
                f"the first row of the table is at {angles[0] / DEGREE:.6g} deg and a "
                "controller's table starts at 0: give a spacing"
            )
        angles = np.append(angles, TURN)
        up, down = np.append(up, up[0]), np.append(down, down[0])
    return angles / DEGREE, up / DEGREE, down / DEGREE


def mean_deg(table: CompensationTable) -> Floats:
    """Return the mean of both directions in degrees, closed, and zero at the reference angle."""
    return columns_deg(average_directions(table))[1]


def fixed(value: float, decimals: int) -> str:
    """Return ``value`` with ``decimals`` places and never a negative zero."""
    text = f"{value:.{decimals}f}"
    return text.lstrip("-") if float(text) == 0.0 else text


def backlash_note(about: str, amount: float, table: CompensationTable) -> str:
    """Say what becomes of a backlash ``amount`` (rad) that the control takes off from above.

    ``about`` names it; the files of ``table`` put it out of force.
    """
    if not amount:
        return ""
    if table.adds_to:
        return (
            f"{about} is not added, since a table was in force in the measurement: if that table "
            "had one column for both directions, measure without a table"
        )
    return (
        f"{about} is in the table: {-amount / ARCSEC:+.6g} arcsec in the reverse column, because "
        "it acted in the measurement. If it was another one then, state it"
    )


def repeat_for_turns(
    first: int, turns: int, angles: Floats, *values: Floats
) -> tuple[Floats, ...]:
    """Repeat ``angles`` (n,), 0 .. 360 deg, and the values there for ``turns`` turns.

    Turn ``first`` is the first, and 1 is 360 .. 720 deg. For controls that do not wrap an axis.
    """
    rows = len(angles) - 1
    number = first + np.append(np.repeat(np.arange(turns), rows), turns - 1)
    repeated = [np.append(np.tile(column[:-1], turns), column[-1]) for column in (angles, *values)]
    return repeated[0] + 360.0 * number, *repeated[1:]


def require_circle(table: CompensationTable, title: str) -> None:
    """Raise ConfigurationError unless ``table`` covers the full circle."""
    if not table.closed:
        first, last = table.angles[[0, -1]] / DEGREE
        raise ConfigurationError(
            f"{title} takes a table of a whole turn, and this one covers only {first:.6g} .. "
            f"{last:.6g} deg: measure the full circle, or use linuxcnc or csv, which take an arc"
        )


def even_interval_deg(table: CompensationTable, title: str, step_deg: float) -> float:
    """Return the spacing of an evenly spaced circle, a whole number of ``step_deg`` degrees.

    Raises ConfigurationError, naming spacings nearby that do, when the rows are not even.
    """
    require_circle(table, title)
    n = len(table.angles)
    spacing = 360.0 / n
    if np.max(np.abs(table.angles / DEGREE - spacing * np.arange(n))) > 1e-7:
        widest = float(np.max(np.diff(table.angles))) / DEGREE
        raise ConfigurationError(
            f"{title} needs evenly spaced rows from 0 to 360 deg, and the rows here (up to "
            f"{widest:.6g} deg apart) are not: choose a spacing that divides 360, such as "
            f"{_nearby(widest, step_deg)}"
        )
    if abs(spacing / step_deg - round(spacing / step_deg)) > 1e-6:
        raise ConfigurationError(
            f"{title} holds its spacing in whole steps of {step_deg:g} deg and {n} rows are "
            f"{spacing:.9g} deg apart: choose a spacing such as {_nearby(spacing, step_deg)}"
        )
    return float(round(spacing / step_deg) * step_deg)


def require_zero_at_start(table: CompensationTable, title: str, resolution: float) -> None:
    """Raise ConfigurationError unless the forward correction at 0 deg rounds to zero."""
    start = float(table.correction_forward[0])
    if abs(start) > resolution / 2.0:
        raise ConfigurationError(
            f"{title} counts its corrections from the machine's zero, and the table is "
            f"{start / ARCSEC:.4g} arcsec there: move the reference angle to 0 deg"
        )


def require_at_most(count: int, limit: int, what: str, hint: str) -> None:
    """Raise ConfigurationError with the number when ``count`` is above ``limit``."""
    if count > limit:
        raise ConfigurationError(f"{what}: {count}, and the controller holds {limit}: {hint}")


def _nearby(spacing_deg: float, step_deg: float) -> str:
    whole = [
        k for k in range(2, 3601) if abs(360.0 / k / step_deg - round(360.0 / k / step_deg)) < 1e-6
    ]
    best = sorted(sorted(whole, key=lambda k: abs(360.0 / k - spacing_deg))[:2])
    return " or ".join(f"{360.0 / k:.9g}" for k in best)


def only_file(files: Mapping[str, str], suffix: str) -> tuple[str, str]:
    """Return name and text of the one file ending with ``suffix``; raises BagError."""
    found = [name for name in files if name.upper().endswith(suffix.upper())]
    if len(found) != 1:
        raise BagError(
            f"{len(found)} files end with {suffix}, expected one, among {', '.join(files) or '-'}"
        )
    return found[0], files[found[0]]


def parse_rows(name: str, lines: list[str], columns: int, separator: str | None) -> Floats:
    """Return :func:`parse_numbers` of at least two rows whose first column ascends."""
    data = parse_numbers(name, lines, columns, separator)
    if len(data) < 2:
        raise BagError(f"{name}: {len(data)} rows, expected at least 2")
    falling = np.diff(data[:, 0]) <= 0.0
    if np.any(falling):
        row = int(np.argmax(falling)) + 2
        raise BagError(f"{name}, row {row}: the position does not ascend from the row before")
    return data


def parse_numbers(name: str, lines: list[str], columns: int, separator: str | None) -> Floats:
    """Return the numbers (n, columns) of ``lines``; BagError names file and row."""
    rows = []
    for row, line in enumerate(lines, start=1):
        cells = line.split(separator)
        if len(cells) != columns:
            raise BagError(f"{name}, row {row}: {len(cells)} columns, expected {columns}")
        rows.append([parse_number(cell, f"{name}, row {row}") for cell in cells])
    return np.array(rows, dtype=np.float64).reshape(-1, columns)


def match_lines(
    name: str, text: str, pattern: str, example: str
) -> Iterator[tuple[str, Match[str]]]:
    """Yield place and match of every line of ``text``; BagError for a line unlike ``example``."""
    for row, line in enumerate(text.splitlines(), start=1):
        match = re.fullmatch(pattern, line.strip())
        if match is None:
            raise BagError(f"{name}, line {row}: {line!r} is not a line such as {example}")
        yield f"{name}, line {row}", match


def parse_number(text: str, where: str) -> float:
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


def interpolate_periodically(angle: Floats, rows_deg: Floats, values: Floats | Ints) -> Floats:
    """Interpolate ``values`` at ``rows_deg`` 0 .. 360 linearly at ``angle`` (rad) of any turn."""
    within = np.mod(np.asarray(angle) / DEGREE, 360.0)
    return np.asarray(np.interp(within, rows_deg, values), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class PeriodicTable:
    """The numbers (n,) that ``file`` holds for each direction at rows (n,) 0 .. 360 deg.

    The correction is ``unit`` (rad) times the number; ``unit`` is negative when the file holds
    actual - commanded. Raises BagError unless the rows ascend from 0 to 360 and the table closes.
    """

    file: str
    rows_deg: Floats
    forward: Floats | Ints
    reverse: Floats | Ints
    unit: float

    def __post_init__(self) -> None:
        rows = self.rows_deg
        if len(rows) < 2 or np.any(np.diff(rows) <= 0.0) or (rows[0], rows[-1]) != (0.0, 360.0):
            raise BagError(f"{self.file}: expected positions that ascend from 0 to 360 deg")
        for column in (self.forward, self.reverse):
            if len(column) != len(rows):
                raise BagError(f"{self.file}: {len(column)} values for {len(rows)} positions")
            if column[0] != column[-1]:
                raise BagError(
                    f"{self.file} does not close: it holds {column[0]} at 0 and {column[-1]} at "
                    "360 deg, expected the same"
                )

    def correction(self, angle: Floats, approach: Approach) -> Floats:
        """Return the radians that the control adds to the command at ``angle`` (rad)."""
        column = self.forward if approach is Approach.POSITIVE else self.reverse
        return interpolate_periodically(angle, self.rows_deg, column) * self.unit


@dataclass(frozen=True, eq=False)
class UnrolledTable:
    """Numbers (n,) at rows (n,), degrees, of a control that does not wrap; beyond, ends are held.

    The correction is ``unit`` (rad) times the number of the direction.
    """

    rows_deg: Floats
    forward: Floats
    reverse: Floats
    unit: float

    @classmethod
    def evenly(
        cls,
        file: str,
        even: tuple[float, float],
        columns: tuple[Floats, Floats],
        travel: tuple[float, float],
        unit: float,
    ) -> UnrolledTable:
        """Return the table of rows that are ``even``: first one and distance, degrees.

        Raises BagError unless they cover ``travel`` (rad) exactly.
        """
        (begin, spacing), count = even, len(columns[0])
        first, last = (end / DEGREE for end in travel)
        if count < 3 or begin != first or abs(begin + spacing * (count - 1) - last) > 1e-3:
            raise BagError(
                f"{file}: {count} points every {spacing:g} deg from {begin:g}, expected "
                f"{first:g} .. {last:g} deg"
            )
        rows = begin + spacing * np.arange(count, dtype=np.float64)
        return cls(np.asarray(rows, dtype=np.float64), *columns, unit)

    def correction(self, angle: Floats, approach: Approach) -> Floats:
        """Return the radians that are added to the command at ``angle`` (rad, not wrapped)."""
        column = self.forward if approach is Approach.POSITIVE else self.reverse
        at = np.asarray(angle) / DEGREE
        return np.asarray(np.interp(at, self.rows_deg, column) * self.unit, dtype=np.float64)
