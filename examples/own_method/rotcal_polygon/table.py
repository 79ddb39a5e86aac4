"""Readings as a plain table: ``position,mounting,reading_rad``."""

from __future__ import annotations

from pathlib import Path

from rotcal_polygon.plan import face_at
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.tables import Header, Row, Table, hashes
from rotcal_ros.methods.calibration import prepare
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.measurements import PlannedMeasurements, RowStepFinder

FARTHEST_RAD = 0.02
"""No autocollimator reads more than a degree."""


HEADERS: tuple[Header, ...] = (("position", "mounting", "reading_rad"),)


def read(configuration: Configuration, table: Table, _targets: Path | None) -> PlannedMeasurements:
    """Return the autocollimator's readings by table position and mounting, from 0.

    DataError names file and row of what cannot be.
    """
    calibration, settings = prepare(configuration), configuration.plan
    find, observations = RowStepFinder(calibration.plan), []
    for row in table.rows():
        position, mounting = row.index("position"), row.index("mounting")
        if mounting >= len(settings.first_faces):
            raise DataError(
                f"{row.place}: mounting {mounting} is not in the plan, which has mountings "
                f"0 to {len(settings.first_faces) - 1}"
            )
        step = find(row, position, face_at(settings, mounting, position))
        observations.append(step.observed((_reading(row), 0.0, 0.0)))
    return PlannedMeasurements(calibration, tuple(observations), hashes(table.path))


def _reading(row: Row) -> float:
    value = row.number("reading_rad")
    if abs(value) > FARTHEST_RAD:
        raise DataError(
            f"{row.place}: reading_rad is {value:g} rad, more than {FARTHEST_RAD:g}; are these "
            "arcseconds? Tables are in radians"
        )
    return value
