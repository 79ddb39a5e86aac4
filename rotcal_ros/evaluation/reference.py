"""Reference tables: an autocollimator with a polygon, or any deviations over angles.

Our own form is ``angle_deg,deviation_arcsec[,u_arcsec]``; :func:`read_deviations` reads others.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from rotcal_ros.foundation.curves.interpolation import SAME_ANGLE, wrap_to_turn
from rotcal_ros.foundation.curves.measured import MeasuredCurve, period_of
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.table_columns import (
    AS_IT_STANDS,
    SheetSettings,
    TableColumn,
    meaning,
    undecided,
)
from rotcal_ros.foundation.table_forms import read_any
from rotcal_ros.foundation.table_questions import asking_at_once
from rotcal_ros.foundation.table_reading import Reading
from rotcal_ros.foundation.tables import Header, Row, Table, require_header
from rotcal_ros.foundation.units import ARCSEC, DEGREE, TURN

COLUMNS: Final = ("angle_deg", "deviation_arcsec", "u_arcsec")
_EITHER: Final = "uncertainty_rad"
UNCERTAINTIES: Final = {"u_rad": 1.0, "expanded_rad": 0.5, _EITHER: 1.0}
"""Columns of a standard uncertainty, an expanded one, one that may be either -> the factor."""
_WITHOUT: Final[Header] = ("angle_rad", "deviation_rad")
_HEADERS: Final[tuple[Header, ...]] = (*((*_WITHOUT, u) for u in UNCERTAINTIES), _WITHOUT)
"""Other forms than ours."""
_CAPITAL: Final = re.compile(r"U\b")
"""The heading of an expanded uncertainty, in the notation of the GUM."""


def read_deviations(
    source: Path | Table,
    std: float | None = None,
    sheet: SheetSettings = AS_IT_STANDS,
    announce: Callable[[Reading], object] = str,
) -> MeasuredCurve:
    """Return the curve in a table of any form: deviations over angles, both in any unit.

    An expanded uncertainty is taken as U with k = 2. ``sheet`` says what the table leaves open,
    ``announce`` is given how it was understood. ``std`` and errors as of :func:`read_reference`.
    """
    reading = asking_at_once(lambda stated, _: _read(source, stated), sheet, announce)
    announce(reading)
    stated = reading.table.header[2:]
    factor = UNCERTAINTIES[stated[0]] if stated else 1.0
    rows = []
    for row in reading.table.rows():
        angle, deviation, *u = _numbers(row)
        rows.append((angle, deviation, u[0] * factor if u else (std or 0.0)))
    name = str(reading.table.path)
    return _curve(rows, name, stated=bool(stated) or std is not None)


def _read(source: Path | Table, sheet: SheetSettings) -> Reading:
    reading = read_any(source, _HEADERS, sheet)
    if reading.table.header[2:]:
        require_known_factor(reading)
    return reading


def require_known_factor(reading: Reading) -> None:
    """Raise DataError for an uncertainty, last of the columns, that is of no known factor."""
    if reading.stated.named().keys() & {"u", "expanded"}:
        return
    named = reading.table.header[-1]
    use = reading.uses.get(TableColumn.of(named).name)
    text = named if use is None else use.text
    if named == _EITHER or (named == "u_rad" and _CAPITAL.match(text)):
        raise undecided(
            f"{reading.table.path}: the column {text!r} may hold standard uncertainties (k = 1) "
            "or expanded ones (k = 2)",
            "sheet.columns",
            [(meaning("u", text), "k = 1"), (meaning("expanded", text), "k = 2")],
        )


def read_reference(table: Table, std: float | None = None) -> MeasuredCurve:
    """Return the curve in a table of our own form: ``angle_deg,deviation_arcsec[,u_arcsec]``.

    Deviation = actual - commanded; u is the standard uncertainty (k = 1) of each value,
    independent of the others; ``std`` (rad) replaces it if the column is absent. A row at 360 deg
    repeats the one at 0 and must equal it within 4 standard uncertainties. Raises BagError for
    other columns, DataError with the wrong row, or if u is not stated.
    """
    require_header(table, (COLUMNS, COLUMNS[:2]))
    rows = []
    for row in table.rows():
        angle, deviation, *u = _numbers(row)
        in_arcsec = u[0] if u else (std or 0.0) / ARCSEC
        rows.append((angle * DEGREE, deviation * ARCSEC, in_arcsec * ARCSEC))
    return _curve(rows, str(table.path), stated=std is not None or table.header == COLUMNS)


def _numbers(row: Row) -> list[float]:
    """Return angle, deviation and uncertainty, if there is one; DataError for a negative one."""
    numbers = [row.number(name) for name in row.cells]
    if numbers[2:] and numbers[2] < 0.0:
        raise DataError(
            f"{row.place}: the uncertainty is negative: {numbers[2]:g}: correct the row"
        )
    return numbers


def _curve(
    rows: Sequence[tuple[float, float, float]], name: str, *, stated: bool
) -> MeasuredCurve:
    """Return the curve of angles, deviations and standard uncertainties (rad).

    ``stated``: somebody has stated the uncertainties.
    """
    if len(rows) < 3:
        raise DataError(f"{name}: {len(rows)} rows, expected at least 3")
    angles, deviation, uncertainty = np.array(sorted(rows, key=lambda row: row[0])).T
    if np.any(np.diff(angles) < SAME_ANGLE):
        twice = angles[np.argmax(np.diff(angles) < SAME_ANGLE)] / DEGREE
        raise DataError(
            f"{name}: the angle {twice:.6g} deg occurs twice: keep one of the rows, or their mean "
            "(`rotcal iso230` evaluates repeated runs)"
        )
    period = period_of(angles)
    if period and abs(angles[-1] - angles[0] - TURN) < SAME_ANGLE:
        gap = abs(deviation[-1] - deviation[0])
        if gap > 4.0 * math.hypot(uncertainty[0], uncertainty[-1]) + SAME_ANGLE:
            raise DataError(
                f"{name}: the rows at {angles[0] / DEGREE:g} and {angles[-1] / DEGREE:g} deg "
                f"differ by {gap / ARCSEC:.4g} arcsec, expected the same table position to agree"
            )
        angles, deviation, uncertainty = angles[:-1], deviation[:-1], uncertainty[:-1]
    if not stated:
        raise DataError(
            f"{name} states no uncertainty: add a column u_arcsec, or state one for all rows with "
            "--reference-u (standard uncertainty, k = 1)"
        )
    position = np.array([wrap_to_turn(a) for a in angles]) if period else angles
    order = np.argsort(position)
    if np.any(np.diff(position[order]) < SAME_ANGLE):
        raise DataError(f"{name}: more than one turn; give every table position once")
    covariance = np.diag(uncertainty[order] ** 2)
    return MeasuredCurve(position[order], deviation[order], covariance, period)


def subtract_polygon(reading: MeasuredCurve, polygon: MeasuredCurve) -> MeasuredCurve:
    """Return ``reading`` without the calibrated face errors of the polygon.

    ``polygon`` gives, for each table angle, the error of the face that then faces the
    autocollimator: actual - nominal direction of its normal, counter-clockwise positive. The
    reading is the sum of both. Raises DataError when a face is missing.
    """
    rows = []
    for angle in reading.angles:
        near = np.abs(np.mod(polygon.angles - angle + TURN / 2, TURN) - TURN / 2)
        rows.append(int(np.argmin(near)))
        if near[rows[-1]] > 1e-6:
            raise DataError(
                f"the polygon has no face for {angle / DEGREE:.6g} deg: its calibration must list "
                "every angle of the reading"
            )
    faces = polygon.covariance[np.ix_(rows, rows)]
    return replace(
        reading,
        deviation=reading.deviation - polygon.deviation[rows],
        covariance=reading.covariance + faces,
    )
