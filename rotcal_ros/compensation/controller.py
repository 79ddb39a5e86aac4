"""What every controller has in common: one description, and the rules that writers share.

A controller is a writer, a reader and a model of what the real control does with the file; all
three are pure functions. The model is what proves a file before it is called done.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.compensation.resample import averaged
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.curves.interpolation import SAME_ANGLE, TURN
from rotcal_ros.errors import BagError, ConfigurationError
from rotcal_ros.observations import Approach
from rotcal_ros.units import ARCSEC, DEGREE

EVERY_TURN: Final = (-TURN, 2.0 * TURN)
"""Travel (rad) over which a control that wraps by itself is proven."""


@dataclass(frozen=True)
class Controller:
    """One kind of controller.

    ``settings`` is a frozen dataclass with a default for every field. ``write(table, settings,
    stem)`` returns file names and texts, ``read(files, settings)`` what they say, and
    ``correction(said, angle, approach)`` the radians that the control then adds to the command
    at ``angle`` (rad).
    ``resolution(table, settings)`` is the step of the values and ``position_resolution`` that of
    the positions, both in rad; ``one_direction(settings)`` tells that one column serves
    both directions, ``staircase`` that the control does not interpolate. ``travel(settings)`` is
    where the file holds, ``unverified(settings)`` what nobody has confirmed yet.
    """

    name: str
    title: str
    settings: type[Any]
    write: Callable[[CompensationTable, Any, str], dict[str, str]]
    read: Callable[[Mapping[str, str], Any], Any]
    correction: Callable[[Any, Floats, Approach], Floats]
    resolution: Callable[[CompensationTable, Any], float]
    position_resolution: float
    one_direction: Callable[[Any], bool]
    unverified: Callable[[Any], tuple[str, ...]]
    sign: str
    wrap: str
    unit: str
    source: str
    travel: Callable[[Any], tuple[float, float]] = lambda settings: EVERY_TURN
    staircase: bool = False


def columns_deg(table: CompensationTable) -> tuple[Floats, Floats, Floats]:
    """Return angles, forward and reverse correction in degrees; a circle ends with 360.

    Raises ConfigurationError when the rows of a circle do not start at zero.
    """
    angles, up, down = table.angles, table.correction_forward, table.correction_reverse
    if table.closed:
        if abs(angles[0]) > SAME_ANGLE:
            raise ConfigurationError(
                f"the first row of the table stands at {angles[0] / DEGREE:.6g} deg and a "
                "controller's table starts at 0: give a spacing"
            )
        angles = np.append(angles, TURN)
        up, down = np.append(up, up[0]), np.append(down, down[0])
    return angles / DEGREE, up / DEGREE, down / DEGREE


def require_circle(table: CompensationTable, title: str) -> None:
    """Raise ConfigurationError unless ``table`` covers the full circle."""
    if not table.closed:
        first, last = table.angles[[0, -1]] / DEGREE
        raise ConfigurationError(
            f"{title} repeats its table every turn and this one covers only {first:.6g} .. "
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


def mean_deg(table: CompensationTable) -> Floats:
    """Return the mean of both directions in degrees, closed, and zero at the reference angle."""
    return columns_deg(averaged(table))[1]


def require_at_most(count: int, limit: int, what: str, hint: str) -> None:
    """Raise ConfigurationError with the number when ``count`` is above ``limit``."""
    if count > limit:
        raise ConfigurationError(f"{what}: {count}, and the controller holds {limit}: {hint}")


def fixed(value: float, decimals: int) -> str:
    """Return ``value`` with ``decimals`` places and never a negative zero."""
    text = f"{value:.{decimals}f}"
    return text.lstrip("-") if float(text) == 0.0 else text


def periodic(angle_deg: Floats, rows_deg: Floats, values: Floats) -> Floats:
    """Interpolate linearly in ``rows_deg`` 0 .. 360, repeated every turn."""
    return np.asarray(np.interp(np.mod(angle_deg, 360.0), rows_deg, values), dtype=np.float64)


def parse_rows(name: str, lines: list[str], columns: int, separator: str | None) -> Floats:
    """Return the numbers (n, columns) of ``lines``; BagError names file and row."""
    rows = []
    for row, line in enumerate(lines, start=1):
        cells = line.split(separator)
        if len(cells) != columns:
            raise BagError(f"{name}, row {row}: {len(cells)} columns, expected {columns}")
        rows.append([number(cell, f"{name}, row {row}") for cell in cells])
    if len(rows) < 2:
        raise BagError(f"{name}: {len(rows)} rows, expected at least 2")
    data = np.array(rows, dtype=np.float64)
    if np.any(np.diff(data[:, 0]) <= 0.0):
        row = int(np.argmax(np.diff(data[:, 0]) <= 0.0)) + 2
        raise BagError(f"{name}, row {row}: the position does not ascend from the row before")
    return data


def only_file(files: Mapping[str, str], suffix: str) -> tuple[str, str]:
    """Return name and text of the one file ending with ``suffix``; raises BagError."""
    found = [name for name in files if name.upper().endswith(suffix.upper())]
    if len(found) != 1:
        raise BagError(
            f"{len(found)} files end with {suffix}, expected one, among {', '.join(files) or '-'}"
        )
    return found[0], files[found[0]]


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


def _nearby(spacing_deg: float, step_deg: float) -> str:
    whole = [
        k for k in range(2, 3601) if abs(360.0 / k / step_deg - round(360.0 / k / step_deg)) < 1e-6
    ]
    best = sorted(sorted(whole, key=lambda k: abs(360.0 / k - spacing_deg))[:2])
    return " or ".join(f"{360.0 / k:.9g}" for k in best)
