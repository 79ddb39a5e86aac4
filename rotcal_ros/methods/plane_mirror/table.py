"""Tracker points as a plain table: ``position,tracker_station,kind,nest,x_m,y_m,z_m``.

A last column ``time_s`` may tell when each row was measured; without it the rows stand in the
order in which they were measured.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.raw_data import RawData, hash_of
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.tables import Header, Row, Table, hashes
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.measurements import measured_in_words
from rotcal_ros.methods.method import Trials
from rotcal_ros.methods.plane_mirror.calibration import configured, solve_points
from rotcal_ros.methods.plane_mirror.plan import position_angles
from rotcal_ros.methods.plane_mirror.solver import mirror_trials
from rotcal_ros.methods.plane_mirror.solver.problem import PlaneMirrorProblem

COLUMNS: Final = {"position": "table_position"}
HEADER: Final[Header] = ("position", "tracker_station", "kind", "nest", "x_m", "y_m", "z_m")
TIMED: Final[Header] = (*HEADER, "time_s")
KINDS: Final = {"direct": PointKind.DIRECT, "mirrored": PointKind.MIRRORED, "nest": PointKind.NEST}
_FARTHEST: Final = 1000.0
"""Metres; beyond any tracker."""


@dataclass(frozen=True)
class TrackerPoints:
    """Points of a table, rows beyond any plan included; ``sha256`` maps file names to hashes."""

    configuration: Configuration
    table: Table
    sha256: Mapping[str, str]

    def __repr__(self) -> str:
        """Return in one line what was measured."""
        return measured_in_words(self, f"{len(self.table.lines)} points")

    def solve(self) -> Result:
        """Return the result."""
        points = self._points()
        return replace(solve_points(self.configuration, points), raw_data=_raw(points))

    def trials(self) -> Trials:
        """Prepare Monte Carlo trials about the points."""
        return mirror_trials(configured(self._points(), self.configuration))

    def _points(self) -> PlaneMirrorProblem:
        return read_points(self.table, np.array(position_angles(self.configuration.plan)))


def read(configuration: Configuration, table: Table, _targets: Table | None) -> TrackerPoints:
    """Return the points of any stations and nests, whose rows need not be steps of a plan."""
    return TrackerPoints(configuration, table, hashes(table))


def read_points(table: Table, angles: Floats) -> PlaneMirrorProblem:
    """Return the problem in a table for commanded ``angles`` (N,) in rad.

    Positions count from 0 into ``angles``; nest rows may leave theirs empty. Tracker stations are
    any labels, in the order of their first row: the order in which the tracker was moved. The
    order of the rows of a station is that of measuring, unless ``time_s`` tells.
    Coordinates are metres in the tracker's own frame. DataError names the row.
    """
    stations: dict[str, int] = {}
    rows, points, seconds = [], [], []
    for row in table.rows():
        kind, station = _kind_and_station(row)
        position = -1 if kind is PointKind.NEST else row.index("position")
        number = stations.setdefault(station, len(stations))
        rows.append((position, number, kind, row.index("nest")))
        points.append(row.point(_FARTHEST))
        if table.header == TIMED:
            seconds.append(row.number("time_s"))
    position_of, station_of, kind_of, nest_of = np.array(rows, dtype=np.int64).T
    return PlaneMirrorProblem(
        angles=angles,
        position=position_of,
        station=station_of,
        kind=kind_of,
        nest=nest_of,
        xyz=np.array(points),
        station_names=tuple(stations),
        source=str(table.path),
        lines=tuple(line for line, _ in table.lines),
        time=np.array(seconds) if seconds else None,
    )


def _raw(points: PlaneMirrorProblem) -> RawData:
    """Return the hashes of the points as they stand in the table."""
    named = zip(points.xyz.tolist(), points.kind, strict=True)
    return RawData(tuple(hash_of(xyz, int(kind)) for xyz, kind in named))


def _kind_and_station(row: Row) -> tuple[PointKind, str]:
    word, station = row.cells["kind"], row.cells["tracker_station"]
    if word not in KINDS:
        raise DataError(f"{row.place}: kind {word!r}, expected {', '.join(KINDS)}")
    if not station:
        raise DataError(f"{row.place}: the tracker station is missing")
    return KINDS[word], station
