"""Tracker points as a plain table: ``position,tracker_station,kind,nest,x_m,y_m,z_m``."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from rotcal_ros.catalogue.configuration import Configuration
from rotcal_ros.catalogue.plane_mirror.calibration import solve_points
from rotcal_ros.errors import DataError
from rotcal_ros.methods.plane_mirror.problem import PlaneMirrorProblem
from rotcal_ros.observations import PointKind
from rotcal_ros.planning.table_angles import table_angles
from rotcal_ros.results import Result
from rotcal_ros.tables import Header, Table, hashes

HEADER: Final = ("position", "tracker_station", "kind", "nest", "x_m", "y_m", "z_m")
KINDS: Final = {
    "direct": PointKind.DIRECT,
    "mirrored": PointKind.MIRRORED,
    "nest": PointKind.NEST,
}


@dataclass(frozen=True)
class TrackerPoints:
    """Points of a table, rows beyond any plan included; ``sha256`` maps file names to hashes."""

    configuration: Configuration
    text: str
    name: str
    sha256: Mapping[str, str]

    def solve(self) -> Result:
        """Return the result."""
        angles = np.array(table_angles(self.configuration.plan))
        return solve_points(self.configuration, read_points(self.text, self.name, angles))


class MirrorTable:
    """Reads the points of a laser tracker: any stations and nests, any order of rows."""

    headers: tuple[Header, ...] = (HEADER,)

    def read(
        self, configuration: Configuration, table: Table, _targets: Path | None
    ) -> TrackerPoints:
        """Return the points, whose rows need not be steps of a plan."""
        return TrackerPoints(configuration, table.text, str(table.path), hashes(table.path))


def read_points(text: str, name: str, angles: ArrayLike, **settings: Any) -> PlaneMirrorProblem:
    """Return the problem in ``text``, the file ``name``, for commanded ``angles`` (N,) in rad.

    Positions count from 0 into ``angles``; nest rows may leave theirs empty. Tracker stations are
    any labels, in the order of their first row: the order in which the tracker was moved.
    ``#`` begins a comment line.
    Coordinates are metres in the tracker's own frame. ``settings`` (``noise``, ``way``, ...) go to
    :class:`~rotcal_ros.methods.plane_mirror.problem.PlaneMirrorProblem`. DataError names the line.
    """
    reader = csv.reader(
        "" if line.lstrip().startswith("#") else line
        for line in io.StringIO(text.removeprefix("\ufeff"))
    )
    first = next((cells for cells in reader if any(cells)), [])
    head = tuple(cell.strip() for cell in first)
    if head != HEADER:
        raise DataError(
            f"{name}: the columns are {', '.join(head) or 'missing'}, expected {', '.join(HEADER)}"
        )
    stations: dict[str, int] = {}
    rows, points, lines = [], [], []
    for cells in reader:
        if not any(cell.strip() for cell in cells):
            continue
        where = f"{name}, line {reader.line_num}"
        position, station, kind, nest, point = _row([cell.strip() for cell in cells], where)
        rows.append((position, stations.setdefault(station, len(stations)), kind, nest))
        points.append(point)
        lines.append(reader.line_num)
    if not rows:
        raise DataError(f"{name}: no points below the header")
    position_of, station_of, kind_of, nest_of = np.array(rows, dtype=np.int64).T
    return PlaneMirrorProblem(
        angles=np.asarray(angles, dtype=np.float64),
        position=position_of,
        station=station_of,
        kind=kind_of,
        nest=nest_of,
        xyz=np.array(points),
        station_names=tuple(stations),
        source=name,
        lines=tuple(lines),
        **settings,
    )


def write_points(problem: PlaneMirrorProblem) -> str:
    """Return the table of a problem; every coordinate round-trips to the last bit."""
    words = {kind: word for word, kind in KINDS.items()}
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(HEADER)
    for row, point in enumerate(problem.xyz.tolist()):
        kind = PointKind(int(problem.kind[row]))
        position = "" if kind is PointKind.NEST else int(problem.position[row])
        station = problem.station_name(int(problem.station[row]))
        coordinates = [repr(value) for value in point]
        writer.writerow([position, station, words[kind], int(problem.nest[row]), *coordinates])
    return out.getvalue()


def _row(
    cells: list[str], where: str
) -> tuple[int, str, PointKind, int, tuple[float, float, float]]:
    if len(cells) != len(HEADER):
        raise DataError(f"{where}: {len(cells)} columns, expected {len(HEADER)}")
    kind = KINDS.get(cells[2])
    if kind is None:
        raise DataError(f"{where}: kind {cells[2]!r}, expected {', '.join(KINDS)}")
    if not cells[1]:
        raise DataError(f"{where}: the tracker station is missing")
    position = -1 if kind is PointKind.NEST else _whole(cells[0], "position", where)
    x, y, z = (_coordinate(cell, where) for cell in cells[4:])
    return position, cells[1], kind, _whole(cells[3], "nest", where), (x, y, z)


def _whole(cell: str, what: str, where: str) -> int:
    if not (cell.isascii() and cell.isdigit()) or len(cell) > 9:
        raise DataError(f"{where}: {what} {cell!r}, expected a whole number from 0")
    return int(cell)


def _coordinate(cell: str, where: str) -> float:
    try:
        value = float(cell)
    except ValueError as error:
        raise DataError(f"{where}: coordinate {cell!r} is not a number") from error
    if not math.isfinite(value):
        raise DataError(f"{where}: coordinate {cell!r} is not a finite number")
    if abs(value) > 1000.0:
        raise DataError(
            f"{where}: coordinate {cell} m is beyond any tracker; are the points in millimetres? "
            "The columns are metres"
        )
    return value
