"""The tables of lengths, ``position,target,length_m``, of stations, and of explicit plans.

A fourth column ``segment`` numbers the unbroken beams. Beside a table of lengths stands
``targets.csv`` with ``target,x_m,y_m,z_m``; an explicit plan lists ``step,table_position,target``.
A table of stations, ``position,x_m,y_m,z_m``, holds what somebody else has made of such lengths;
``d_m`` may state how far each is from the first target.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.tables import (
    Header,
    Row,
    Table,
    read_table,
    require_header,
    table_hashes,
)
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.methods import measurements
from rotcal_ros.methods.calibration import Calibration, prepare, stated_circumstances
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.measurements import PlannedMeasurements, RowStepFinder
from rotcal_ros.methods.method import Measurements, PlanFile, Trials
from rotcal_ros.methods.tracer import turning_readings, turning_table
from rotcal_ros.methods.tracer.lengths import LengthCheck
from rotcal_ros.methods.tracer.plan import check_plan, explicit_plan, plan_of, turning_plan
from rotcal_ros.methods.tracer.settings import TracerSolverSettings
from rotcal_ros.methods.tracer.solver.stations import StationProblem, solve
from rotcal_ros.methods.tracer.turning_table import TurningTables
from rotcal_ros.planning.plan import Plan, Point

SEGMENT: Final = "segment"
HEADERS: Final[tuple[Header, ...]] = (
    ("position", "target", "length_m"),
    ("position", "target", "length_m", SEGMENT),
)
COLUMNS: Final = {"position": "table_position", "target": "target"}
"""Columns of numbers, with the field of a step that each holds."""
DISTANCE: Final = "d_m"
STATIONS: Final[tuple[Header, ...]] = (
    ("position", "x_m", "y_m", "z_m"),
    ("position", "x_m", "y_m", "z_m", DISTANCE),
)
TARGETS: Final = ("target", "x_m", "y_m", "z_m")
PAIRS: Final = ("step", "table_position", "target")
TARGETS_FILE: Final = "targets.csv"
PAIRS_FILE: Final = "pairs.csv"


@dataclass(frozen=True, eq=False)
class StationTable:
    """Coordinates of stations, which somebody else has made of lengths."""

    configuration: Configuration
    problem: StationProblem
    sha256: Mapping[str, str]

    def __repr__(self) -> str:
        """Return in one line what was measured."""
        return measurements.measured_in_words(self, f"{len(self.problem.positions)} stations")

    def solve(self) -> Result:
        """Return the result, under the circumstances that the set-up states."""
        stated = stated_circumstances(self.configuration)
        return replace(solve(self.problem), circumstances=stated)

    def model_of_curves(self) -> None:
        """Return None: the result stands for them, for there are no lengths."""

    def trials(self) -> Trials:
        """Raise ConfigurationError: there are no lengths to draw."""
        raise ConfigurationError(
            f"{', '.join(self.sha256)}: coordinates of stations have no Monte Carlo trials, which "
            "draw lengths: give the table of lengths"
        )


def read(configuration: Configuration, table: Table, targets: Table | None) -> Measurements:
    """Return what a table of lengths, or of stations, holds."""
    if table.header in STATIONS:
        return read_stations(configuration, table)
    if table.header in TURNS.headers:
        return read_turns(TURNS, configuration, table, targets)
    return _read_lengths(configuration, table, targets)


def read_turns(
    form: TurningTables, configuration: Configuration, table: Table, targets: Table | None
) -> PlannedMeasurements:
    """Return the lengths of a table that turned, which a ``table`` holds or its readings make."""
    _require_places(configuration, table, targets)
    raw = table.header in form.readings
    read_them = turning_readings.read if raw else turning_table.read
    return read_them(form, configuration, table, () if targets is None else _points(targets))


def _plan_of_turns(configuration: Configuration, targets: tuple[Point, ...]) -> Plan:
    """Return the plan of turns that a table holds; to its own targets without ``targets``."""
    planned = turning_plan(configuration.plan, targets)
    check_plan(configuration.solver, planned, turning=True)
    return planned


TURNS: Final = TurningTables(_plan_of_turns)


def read_stations(configuration: Configuration, table: Table) -> StationTable:
    """Return the stations by table position, in the order of the positions.

    Raises DataError for a position that is not in the plan, or comes twice.
    """
    angles = prepare(configuration).plan.table_angles
    rows = _numbered(table, "position")
    for position, row in rows.items():
        if position >= len(angles):
            raise DataError(
                f"{row.place}: position {position} is not in the plan, which has 0 to "
                f"{len(angles) - 1}; does the set-up belong to this table?"
            )
    positions, with_distance = sorted(rows), DISTANCE in table.header
    solver: TracerSolverSettings = configuration.solver
    problem = StationProblem(
        stations=np.array([rows[position].point() for position in positions]),
        table_angles=np.array(angles)[positions],
        positions=np.array(positions),
        distances=np.array(
            [rows[position].metres(DISTANCE) for position in positions if with_distance]
        ),
        error_motion_std=solver.error_motion_std_m,
        significance=solver.test_significance,
    )
    return StationTable(configuration, problem, table_hashes(table))


def _read_lengths(
    configuration: Configuration, table: Table, targets: Table | None
) -> PlannedMeasurements:
    """Return lengths by table position and target; a table shows no scatter, so there is none.

    Segments that the table names have a zero each, unless the set-up asks
    for one per station.
    """
    in_segments = SEGMENT in table.header
    if in_segments and configuration.solver.zero == "auto":
        solver = replace(configuration.solver, zero="per_segment")
        configuration = replace(configuration, solver=solver)

    def replanned(planned: Plan, targets: tuple[Point, ...]) -> Plan:
        listed, angles = configuration.plan.listed, planned.table_angles
        if len(set(listed)) < len(listed):  # only the plan shows which pairs come again
            return explicit_plan(configuration.plan, targets)
        return plan_of(angles, targets, [Approach.UNKNOWN] * len(angles))

    return read_lengths(configuration, table, targets, COLUMNS, replanned)


def read_lengths(
    configuration: Configuration,
    table: Table,
    targets: Table | None,
    columns: Mapping[str, str],
    replanned: Callable[[Plan, tuple[Point, ...]], Plan],
) -> PlannedMeasurements:
    """Return the lengths of ``table``, each as the one step of the plan that its row names.

    By its ``columns`` as of a :class:`RowStepFinder`. ``replanned`` makes the plan of the set-up
    to the targets of the table ``targets``, or to its own without it. Raises ConfigurationError
    for targets without places, DataError for a length that cannot be one in metres.
    """
    rows = list(table.rows())
    _require_places(configuration, table, targets)
    planned = prepare(configuration).plan
    tables, places = [table], planned.targets
    if targets is not None:
        tables, places = [table, targets], _points(targets)
    calibration = Calibration(configuration, replanned(planned, places))
    find, check = RowStepFinder(calibration.plan, columns), LengthCheck(calibration.plan)
    in_segments = SEGMENT in table.header
    observations = []
    for row in rows:
        step, segment = find(row), row.index(SEGMENT) if in_segments else 0
        observation = check(replace(step.observed((row.metres("length_m"),)), segment=segment))
        if not observation.accepted:
            raise DataError(f"{row.place}: {observation.reason}")
        observations.append(observation)
    return PlannedMeasurements(calibration, tuple(observations), table_hashes(*tables))


def _require_places(configuration: Configuration, table: Table, targets: Table | None) -> None:
    """Raise ConfigurationError for lengths to targets that are nowhere."""
    if targets is None and not turning_table.places_stated(configuration):
        raise ConfigurationError(
            f"{table.path} needs the places of its targets, and {configuration.source} states "
            f"none: give --targets TARGETS.csv with the columns {','.join(TARGETS)} (in Python "
            "targets=), or state plan.targets_m or plan.box_centre_m, box_size_m and box_points"
        )


def read_targets(path: Path) -> tuple[Point, ...]:
    """Return the target positions (m) in a table of any form, in the order of their numbers."""
    return _points(measurements.read_targets(path, TARGETS).table)


def _points(table: Table) -> tuple[Point, ...]:
    return tuple(row.point() for row in _without_gaps(table, "target", ", in the lengths too"))


def _numbered(table: Table, what: str) -> dict[int, Row]:
    """Return the rows by their numbers in the column ``what``; DataError where one comes twice."""
    found: dict[int, Row] = {}
    for row in table.rows():
        number = row.index(what)
        if number in found:
            raise DataError(f"{row.place}: {what} {number} is listed twice: keep one of the rows")
        found[number] = row
    return found


def _without_gaps(table: Table, what: str, where: str = "") -> list[Row]:
    """Return the rows in the order of their numbers; DataError where one is missing.

    ``where``: else the numbers stand.
    """
    found = _numbered(table, what)
    for number in range(len(found)):
        if number not in found:
            raise DataError(
                f"{table.path}: {what}s are numbered from 0 without gaps, but {what} {number} is "
                f"missing: add its row, or number them anew{where}"
            )
    return [found[number] for number in range(len(found))]


def read_pairs(path: Path) -> tuple[int, ...]:
    """Return table position and target of every step, one after the other, by their numbers.

    Raises BagError for a file that is no such table, DataError for steps that are listed twice
    or missing.
    """
    table = read_table(path)
    require_header(table, (PAIRS,))
    rows = _without_gaps(table, "step")
    return tuple(row.index(name) for row in rows for name in PAIRS[1:])


def write_targets(path: Path, targets: Sequence[Point] | Floats) -> None:
    """Write ``targets`` (m) so that they are read as the same bits."""
    _write(path, TARGETS, [(number, *map(float, point)) for number, point in enumerate(targets)])


def write_pairs(path: Path, pairs: Sequence[tuple[int, int]] | Ints) -> None:
    """Write the pairs (table position, target) of a plan in their order."""
    _write(path, PAIRS, [(number, *map(int, pair)) for number, pair in enumerate(pairs)])


def write_plan_files(
    folder: Path, table_angles: Floats, targets: Floats, pairs: Ints
) -> dict[str, Any]:
    """Write ``targets`` (n, 3), m, and ``pairs`` (k, 2) into ``folder``, which may be new.

    Returns the settings of the group ``plan`` that measures them at ``table_angles``, rad.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_targets(folder / TARGETS_FILE, targets)
    write_pairs(folder / PAIRS_FILE, pairs)
    return {
        "table_angles_deg": [round(angle / DEGREE, 12) for angle in table_angles.tolist()],
        "targets_file": TARGETS_FILE,
        "pairs_file": PAIRS_FILE,
    }


def _write(path: Path, header: Sequence[str], rows: Sequence[tuple[float, ...]]) -> None:
    lines = [",".join(header), *(",".join(map(repr, row)) for row in rows)]
    write_atomically(path, "\n".join(lines) + "\n")


def _coordinates(path: Path) -> tuple[float, ...]:
    return tuple(value for point in read_targets(path) for value in point)


PLAN_FILES: Final[Mapping[str, PlanFile]] = {
    "targets_file": PlanFile("targets_m", _coordinates),
    "pairs_file": PlanFile("pairs", read_pairs),
}
