"""Measurements from plain tables: from a machine's or a tracker's own program."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.tables import Row, Table, hashes, read_table, require_header
from rotcal_ros.foundation.units import NANOSECOND
from rotcal_ros.methods.calibration import Calibration, prepare
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.method import (
    Measurements,
    TableReader,
    Trials,
    find_method,
    method_names,
)
from rotcal_ros.planning.plan import Plan, Step

TIME: Final = "time_s"
"""A last column that tells when a row was read, from any moment on."""
LATEST_S: Final = 9e9
"""Nanoseconds beyond are no numbers of 64 bits."""


@dataclass(frozen=True)
class PlannedMeasurements:
    """Observations of a plan, as of a table; ``sha256`` maps file names to hashes."""

    calibration: Calibration
    observations: tuple[Observation, ...]
    sha256: Mapping[str, str] = field(default_factory=dict)

    @property
    def configuration(self) -> Configuration:
        """What it is solved with."""
        return self.calibration.configuration

    def solve(self) -> Result:
        """Return the result."""
        return self.calibration.solve(self.observations)

    def trials(self) -> Trials:
        """Prepare Monte Carlo trials about the observations."""
        return self.calibration.trials(self.observations)


def read_measurements(
    source: Path | Table, configuration: Configuration, targets: Path | Table | None = None
) -> Measurements:
    """Read a table, or that in a file, as the method of the configuration understands it.

    ``targets`` are target positions, for methods that have targets. Raises BagError
    when a file cannot be read or has other columns, ConfigurationError for a set-up without plan,
    DataError when the content cannot be what it should be.
    """
    table, method = _table(source), configuration.method
    others = [
        other.name
        for other in map(find_method, method_names())
        if other.table is not None and table.header in other.table.headers
    ]
    if others and method.name not in others:
        raise BagError(
            f"{table.path} is a table of the method {others[0]}, but {configuration.source} sets "
            f"up {method.name}: give the set-up that belongs to it"
        )
    if method.table is None:
        raise BagError(f"{table.path}: the method {method.name} reads no plain tables")
    require_header(table, method.table.headers)
    if "plan" not in configuration.given:
        raise ConfigurationError(
            f"{configuration.source} has no group 'plan': it has to say which table angles the "
            f"positions in {table.path} stand for"
        )
    return method.table.read(configuration, table, None if targets is None else _table(targets))


def _table(source: Path | Table) -> Table:
    return source if isinstance(source, Table) else read_table(source)


def planned_table(columns: Mapping[str, str], values: Mapping[str, float]) -> TableReader:
    """Return what reads tables with a row for each step of a plan, and what was read there.

    ``columns`` of numbers from 0, each with the field of a :class:`~.planning.plan.Step` that it
    tells; columns of up to three ``values``, in metres or radians as their names say (``_m``,
    ``_rad``), with the largest that can be. A last column ``time_s`` may tell when each row was
    read; without it that was in the order of the plan.
    """
    header = (*columns, *values)

    def read(
        configuration: Configuration, table: Table, _targets: Table | None
    ) -> PlannedMeasurements:
        calibration = prepare(configuration)
        find, observations = RowStepFinder(calibration.plan, columns), list[Observation]()
        for row in table.rows():
            seen = [_value(row, name, largest) for name, largest in values.items()]
            step, missing = find(row), (0.0,) * (3 - len(seen))
            observations.append(read_at(row, step.observed((*seen, *missing))))
        return PlannedMeasurements(calibration, tuple(observations), hashes(table))

    return TableReader((header, (*header, TIME)), read)


def read_at(row: Row, observation: Observation) -> Observation:
    """Return the observation with the time that its row tells, if it tells one."""
    if TIME not in row.cells:
        return observation
    seconds = row.number(TIME)
    if abs(seconds) > LATEST_S:
        raise DataError(f"{row.place}: {TIME} is {seconds:g} s; are these milliseconds?")
    return replace(observation, window_end_ns=round(seconds / NANOSECOND))


def _value(row: Row, name: str, largest: float) -> float:
    return row.radians(name, largest) if name.endswith("_rad") else row.metres(name, largest)


class RowStepFinder:
    """Finds the step of the plan that a row measures, and refuses it twice.

    What the plan measures again, as a plan that closes does, may stand in the table again.
    ``columns`` of the table, each with the field of a step that it tells: ``table_position``,
    ``target`` or ``station``. A field that no column tells counts as the same everywhere.
    """

    def __init__(self, plan: Plan, columns: Mapping[str, str]) -> None:
        self._columns, self._steps = columns, dict[tuple[int, ...], list[Step]]()
        for step in plan.steps:
            key = tuple(getattr(step, field) for field in columns.values())
            self._steps.setdefault(key, []).append(step)
        self._seen: dict[tuple[int, ...], list[str]] = {}

    def __call__(self, row: Row) -> Step:
        """Return the step that a row measures; DataError, with its place, where there is none."""
        key = tuple(row.index(name) for name in self._columns)
        steps, names = self._steps.get(key), [name.replace("_", " ") for name in self._columns]
        what = ", ".join(f"{name} {number}" for name, number in zip(names, key, strict=True))
        if steps is None:
            known = zip(names, zip(*self._steps, strict=True), strict=True)
            plurals = ((f"{name}es" if name[-1] == "x" else f"{name}s", n) for name, n in known)
            *most, last = [f"{names} {_in_words(numbers)}" for names, numbers in plurals]
            raise DataError(
                f"{row.place}: {what} is not in the plan, which has {', '.join(most)} and {last}; "
                "does the set-up belong to this table?"
            )
        seen = self._seen.setdefault(key, [])
        if len(seen) == len(steps):
            raise DataError(
                f"{row.place}: {what} was measured already ({', '.join(seen)}); keep one of the "
                "rows" + (f", {len(steps)} are in the plan" if len(steps) > 1 else "")
            )
        seen.append(row.place)
        return steps[len(seen) - 1]


def _in_words(numbers: Iterable[int]) -> str:
    """Return which numbers there are; the balls of a plate have gaps."""
    known = sorted(set(numbers))
    if known == list(range(len(known))):
        return f"0 to {known[-1]}"
    return ", ".join(map(str, known))
