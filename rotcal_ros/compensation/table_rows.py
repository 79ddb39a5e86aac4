"""Rows of a table for writers: columns in degrees, and the demands of a controller's file."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from rotcal_ros.compensation.resample import averaged
from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.curves.interpolation import SAME_ANGLE, TURN
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.units import ARCSEC, DEGREE


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
    return columns_deg(averaged(table))[1]


def fixed(value: float, decimals: int) -> str:
    """Return ``value`` with ``decimals`` places and never a negative zero."""
    text = f"{value:.{decimals}f}"
    return text.lstrip("-") if float(text) == 0.0 else text


def with_line(files: Mapping[str, str], suffix: str, place: int, line: str) -> dict[str, str]:
    """Return ``files`` with a further ``line`` at ``place`` in those that end with ``suffix``."""
    texts = dict(files)
    for name in (name for name in files if name.endswith(suffix)):
        lines = files[name].splitlines(keepends=True)
        texts[name] = "".join([*lines[:place], f"{line}\n", *lines[place:]])
    return texts


def every_turn(first: int, turns: int, angles: Floats, *values: Floats) -> tuple[Floats, ...]:
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
