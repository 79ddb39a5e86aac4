"""Plain tables: measurements from a machine's or a tracker's own program, as CSV.

Metres and radians, one header line, comma-separated, ``#`` begins a comment line:

* tracer: ``station,target,length_m``, and beside it ``targets.csv``: ``target,x_m,y_m,z_m``
* ball plate: ``table_index,ball_step,x_m,y_m,z_m``
* plane mirror: ``position,tracker_station,kind,nest,x_m,y_m,z_m``, kind ``direct``,
  ``mirrored`` or ``nest``

Indices count from 0. What was commanded is in the set-up (the configuration). Every error names
file and row.
"""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from math import isfinite
from pathlib import Path
from typing import Final

from rotcal_ros import catalogue
from rotcal_ros.capture.plausibility import LengthCheck
from rotcal_ros.configuration import Configuration
from rotcal_ros.errors import BagError, DataError
from rotcal_ros.observations import Approach, Observation, PointKind
from rotcal_ros.planning.plan import Plan, Point, Step
from rotcal_ros.results import Result

TRACER: Final = ("station", "target", "length_m")
TARGETS: Final = ("target", "x_m", "y_m", "z_m")
BALL_PLATE: Final = ("table_index", "ball_step", "x_m", "y_m", "z_m")
PLANE_MIRROR: Final = ("position", "tracker_station", "kind", "nest", "x_m", "y_m", "z_m")
TARGETS_FILE: Final = "targets.csv"

_FARTHEST: Final = 50.0
"""Metres; no target or length of such a calibration is farther away."""


@dataclass(frozen=True)
class TableData:
    """A calibration with the observations of a table; ``sha256`` maps file names to hashes."""

    calibration: catalogue.Calibration
    observations: tuple[Observation, ...]
    sha256: Mapping[str, str]

    def solve(self) -> Result:
        """Return the result."""
        return self.calibration.solve(self.observations)


@dataclass(frozen=True)
class WholeTable:
    """The text of a table that its method reads itself: rows beyond any plan are welcome."""

    configuration: Configuration
    text: str
    name: str
    sha256: Mapping[str, str]

    def solve(self) -> Result:
        """Return the result; DataError when the set-up is that of a method with other tables."""
        method = catalogue.find_method(self.configuration)
        if method.solve_table is None:
            raise DataError(
                f"{self.name} is no table of the method {method.name}, which "
                f"{self.configuration.source} sets up: give the set-up that belongs to it"
            )
        return method.solve_table(self.configuration, self.text, self.name)


@dataclass(frozen=True)
class Row:
    """One line of a table; ``place`` names file and line in error texts."""

    place: str
    cells: Mapping[str, str]

    def index(self, name: str) -> int:
        """Return a cell as an index from 0."""
        text = self.cells[name]
        if not (text.isascii() and text.isdigit()):
            raise DataError(f"{self.place}: {name} must be a whole number from 0, found {text!r}")
        return int(text)

    def metres(self, name: str) -> float:
        """Return a cell as a finite number of metres of plausible size."""
        text = self.cells[name]
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not isfinite(value):
            raise DataError(f"{self.place}: {name} must be a finite number, found {text!r}")
        if abs(value) > _FARTHEST:
            raise DataError(
                f"{self.place}: {name} is {value:g} m, more than {_FARTHEST:g} m; are these "
                "millimetres? Tables are in metres"
            )
        return value

    def point(self) -> Point:
        """Return the columns x_m, y_m, z_m."""
        return self.metres("x_m"), self.metres("y_m"), self.metres("z_m")


def read_measurements(
    path: Path, configuration: Configuration, targets: Path | None = None
) -> TableData | WholeTable:
    """Read the table at ``path``; its header says which method it belongs to.

    ``targets`` is the file of target positions of a tracer table, by default ``targets.csv``
    beside it; without one the targets of the set-up are used. Raises BagError when a file
    cannot be read, DataError when its content cannot be what it should be.
    """
    header, rows = _read_table(path, (TRACER, BALL_PLATE, PLANE_MIRROR))
    files = [path]
    if header == PLANE_MIRROR:
        return WholeTable(configuration, _text(path), str(path), _hashes(files))
    calibration = catalogue.prepare(configuration)
    if header == TRACER:
        beside = path.with_name(TARGETS_FILE)
        if targets is None and beside.exists():
            targets = beside
        if targets is not None:
            files.append(targets)
            plan = _plan_of_targets(calibration.plan, read_targets(targets))
            calibration = catalogue.Calibration(configuration, calibration.method, plan)
    find = _Finder(calibration.plan)
    observations = tuple(_observation(find, row, _READERS[header]) for row in rows)
    if header == BALL_PLATE:  # a plate that moved is looked for in the order of the rows
        observations = tuple(replace(o, step=row) for row, o in enumerate(observations))
    _check_lengths(calibration.plan, rows, observations)
    return TableData(calibration, observations, _hashes(files))


def read_targets(path: Path) -> tuple[Point, ...]:
    """Return the target positions (m) of ``targets.csv`` in the order of their numbers."""
    _, rows = _read_table(path, (TARGETS,))
    points: dict[int, Point] = {}
    for row in rows:
        number = row.index("target")
        if number in points:
            raise DataError(f"{row.place}: target {number} is listed twice")
        points[number] = row.point()
    missing = sorted(set(range(max(points) + 1)) - points.keys())
    if missing:
        raise DataError(
            f"{path}: targets are numbered from 0 without gaps, but target {missing[0]} is missing"
        )
    return tuple(points[number] for number in sorted(points))


def _read_table(
    path: Path, headers: tuple[tuple[str, ...], ...]
) -> tuple[tuple[str, ...], list[Row]]:
    """Return the header, one of ``headers``, and the rows of a CSV file."""
    text = _text(path)
    lines = [
        (number, [cell.strip() for cell in cells])
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
        for cells in csv.reader([line])
    ]
    expected = " or ".join(f"'{','.join(header)}'" for header in headers)
    found = tuple(lines[0][1]) if lines else ()
    if found not in headers:
        raise BagError(f"{path}: expected the header line {expected}, found '{','.join(found)}'")
    rows = []
    for number, cells in lines[1:]:
        if len(cells) != len(found):
            raise DataError(
                f"{path}, row {number}: expected {len(found)} values ({','.join(found)}), "
                f"found {len(cells)}"
            )
        rows.append(Row(f"{path}, row {number}", dict(zip(found, cells, strict=True))))
    if not rows:
        raise DataError(f"{path}: the table has a header but no rows")
    return found, rows


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise BagError(f"cannot read the table {path}: {error}") from error


def _hashes(files: list[Path]) -> dict[str, str]:
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def _plan_of_targets(plan: Plan, targets: tuple[Point, ...]) -> Plan:
    """Return the plan with other targets: every target at every table angle."""
    pairs = product(range(len(plan.table_angles)), range(len(targets)))
    steps = tuple(
        Step(
            index=number,
            table_index=station,
            table_angle=plan.table_angles[station],
            approach=Approach.UNKNOWN,
            kind=PointKind.REFLECTOR,
            target=target,
            position=targets[target],
        )
        for number, (station, target) in enumerate(pairs)
    )
    return Plan(plan.method, plan.table_angles, targets, steps)


class _Finder:
    """Finds the step of the plan that a row measures, and refuses the same step twice."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._steps: dict[tuple[int, int, int, PointKind | None], Step] = {}
        for step in plan.steps:
            index, target, station = step.table_index, step.target, step.station
            self._steps[index, target, station, step.kind] = step
            self._steps.setdefault((index, target, station, None), step)
        self._seen: dict[int, str] = {}

    def __call__(
        self, row: Row, table_index: int, target: int, station: int, kind: PointKind | None
    ) -> Step:
        step = self._steps.get((table_index, target, station, kind))
        if step is None:
            what = f", {kind.name.lower()}" if kind else ""
            raise DataError(
                f"{row.place}: position {table_index}, target {target}, tracker station "
                f"{station}{what} is not in the plan, which has positions 0 to "
                f"{len(self._plan.table_angles) - 1} and targets {self._targets()}; does the "
                "set-up belong to this table?"
            )
        if step.index in self._seen:
            raise DataError(
                f"{row.place}: position {table_index}, target {target} was measured already "
                f"({self._seen[step.index]}); keep one of the two rows"
            )
        self._seen[step.index] = row.place
        return step

    def _targets(self) -> str:
        """Return the targets of the plan in words; the balls of a plate have gaps."""
        known = sorted({step.target for step in self._plan.steps})
        if known == list(range(len(known))):
            return f"0 to {known[-1]}"
        return ", ".join(map(str, known))


Reader = Callable[[_Finder, Row], tuple[Step, PointKind, tuple[float, ...]]]


def _tracer(find: _Finder, row: Row) -> tuple[Step, PointKind, tuple[float, ...]]:
    step = find(row, row.index("station"), row.index("target"), 0, PointKind.REFLECTOR)
    return step, step.kind, (row.metres("length_m"),)


def _ball_plate(find: _Finder, row: Row) -> tuple[Step, PointKind, tuple[float, ...]]:
    step = find(row, row.index("table_index"), row.index("ball_step"), 0, None)
    return step, PointKind.CENTRE, row.point()


_READERS: Final[Mapping[tuple[str, ...], Reader]] = {
    TRACER: _tracer,
    BALL_PLATE: _ball_plate,
}


def _observation(find: _Finder, row: Row, read: Reader) -> Observation:
    """Return an accepted observation; a table tells no scatter, so there is none."""
    step, kind, mean = read(find, row)
    return step.observed(mean, kind)


def _check_lengths(plan: Plan, rows: list[Row], observations: tuple[Observation, ...]) -> None:
    """Raise DataError where a length cannot fit the distance between its targets."""
    check = LengthCheck(plan)
    for row, observation in zip(rows, observations, strict=True):
        checked = check(observation)
        if not checked.accepted:
            raise DataError(f"{row.place}: {checked.reason}")
