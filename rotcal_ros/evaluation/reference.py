"""Reference tables: an autocollimator with a polygon, or any ``angle_deg,deviation_arcsec``."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.curves.interpolation import SAME_ANGLE, TURN, wrapped
from rotcal_ros.foundation.curves.measured import MeasuredCurve, period_of
from rotcal_ros.foundation.errors import BagError, DataError
from rotcal_ros.foundation.tables import csv_rows
from rotcal_ros.foundation.units import ARCSEC, DEGREE

COLUMNS: Final = ("angle_deg", "deviation_arcsec", "u_arcsec")


def read_reference(text: str, name: str, std: float | None = None) -> MeasuredCurve:
    """Return the curve in ``text``, the file ``name``: ``angle_deg,deviation_arcsec[,u_arcsec]``.

    Deviation = actual - commanded; u is the standard uncertainty (k = 1) of each value,
    independent of the others; ``std`` (rad) replaces it if the column is absent. A row at 360 deg
    repeats the one at 0 and must equal it within 4 standard uncertainties. Raises BagError for
    other columns, DataError with the wrong line, or if nobody states u.
    """
    reader = csv_rows(text, name)
    head = tuple(cell.strip() for cell in next(reader, []))
    if head not in (COLUMNS, COLUMNS[:2]):
        raise BagError(
            f"{name}: the columns are {', '.join(head) or 'none'}, expected angle_deg, "
            "deviation_arcsec, u_arcsec"
        )
    rows = [
        _numbers(cells, len(head), f"{name}, line {line}")
        for line, cells in enumerate(reader, start=2)
        if cells
    ]
    if len(rows) < 3:
        raise DataError(f"{name}: {len(rows)} rows, expected at least 3")
    data = np.array([[*row, (std or 0.0) / ARCSEC][:3] for row in rows])
    data = data[np.argsort(data[:, 0])]
    angles, deviation, uncertainty = data[:, 0] * DEGREE, data[:, 1] * ARCSEC, data[:, 2] * ARCSEC
    if np.any(np.diff(angles) < SAME_ANGLE):
        twice = angles[np.argmax(np.diff(angles) < SAME_ANGLE)] / DEGREE
        raise DataError(f"{name}: the angle {twice:.6g} deg occurs twice")
    period = period_of(angles)
    if period and abs(angles[-1] - angles[0] - TURN) < SAME_ANGLE:
        gap, limit = (
            abs(deviation[-1] - deviation[0]),
            4.0 * math.hypot(uncertainty[0], uncertainty[-1]),
        )
        if gap > limit + SAME_ANGLE:
            raise DataError(
                f"{name}: the rows at {angles[0] / DEGREE:g} and {angles[-1] / DEGREE:g} deg "
                f"differ by {gap / ARCSEC:.4g} arcsec, expected the same table position to agree"
            )
        angles, deviation, uncertainty = angles[:-1], deviation[:-1], uncertainty[:-1]
    if std is None and head != COLUMNS:
        raise DataError(
            f"{name} states no uncertainty: add a column u_arcsec, or state one for all rows with "
            "--reference-u (standard uncertainty, k = 1)"
        )
    return _sorted(angles, deviation, uncertainty, period, name)


def without_polygon(reading: MeasuredCurve, polygon: MeasuredCurve) -> MeasuredCurve:
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


def _numbers(cells: list[str], columns: int, where: str) -> list[float]:
    if len(cells) != columns:
        raise DataError(f"{where}: {len(cells)} columns, expected {columns}")
    try:
        values = [float(cell) for cell in cells]
    except ValueError as error:
        raise DataError(f"{where}: {error}; expected numbers only") from error
    if not all(map(math.isfinite, values)) or (columns == 3 and values[2] < 0.0):
        raise DataError(f"{where}: {', '.join(cells)}: expected finite numbers, u not negative")
    return values


def _sorted(
    angles: Floats, deviation: Floats, std: Floats, period: float, name: str
) -> MeasuredCurve:
    position = np.array([wrapped(a) for a in angles]) if period else angles
    order = np.argsort(position)
    if np.any(np.diff(position[order]) < SAME_ANGLE):
        raise DataError(f"{name}: more than one turn; give every table position once")
    return MeasuredCurve(position[order], deviation[order], np.diag(std[order] ** 2), period)
