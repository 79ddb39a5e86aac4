"""Measurements from plain tables: from a machine's or a tracker's own program."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rotcal_ros.catalogue.calibration import Calibration
from rotcal_ros.catalogue.configuration import Configuration
from rotcal_ros.catalogue.method import Measurements, find_method, method_names
from rotcal_ros.errors import DataError
from rotcal_ros.observations import Observation
from rotcal_ros.planning.plan import Plan, Step
from rotcal_ros.results import Result
from rotcal_ros.tables import Row, read_table, require_header


@dataclass(frozen=True)
class PlannedMeasurements:
    """Observations of a plan that stand in a table; ``sha256`` maps file names to hashes."""

    calibration: Calibration
    observations: tuple[Observation, ...]
    sha256: Mapping[str, str]

    def solve(self) -> Result:
        """Return the result."""
        return self.calibration.solve(self.observations)


def read_measurements(
    path: Path, configuration: Configuration, targets: Path | None = None
) -> Measurements:
    """Read the table at ``path`` as the method of the configuration understands it.

    ``targets`` is a file of target positions, for methods that have targets. Raises BagError
    when a file cannot be read, DataError when its content cannot be what it should be.
    """
    table, method = read_table(path), configuration.method
    others = [
        other.name
        for other in map(find_method, method_names())
        if other.table is not None and table.header in other.table.headers
    ]
    if others and method.name not in others:
        raise DataError(
            f"{path} is a table of the method {others[0]}, but {configuration.source} sets up "
            f"{method.name}: give the set-up that belongs to it"
        )
    if method.table is None:
        raise DataError(f"{path}: the method {method.name} reads no plain tables")
    require_header(table, method.table.headers)
    return method.table.read(configuration, table, targets)


class StepFinder:
    """Finds the step of the plan that a row measures, and refuses the same step twice."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._steps: dict[tuple[int, int], Step] = {}
        for step in plan.steps:
            self._steps.setdefault((step.table_position, step.target), step)
        self._seen: dict[int, str] = {}

    def __call__(self, row: Row, position: int, target: int) -> Step:
        """Return the step that measures a target at a table position."""
        step = self._steps.get((position, target))
        if step is None:
            raise DataError(
                f"{row.place}: position {position}, target {target} is not in the plan, which has "
                f"positions 0 to {len(self._plan.table_angles) - 1} and targets "
                f"{_in_words(self._plan.steps)}; does the set-up belong to this table?"
            )
        if step.index in self._seen:
            raise DataError(
                f"{row.place}: position {position}, target {target} was measured already "
                f"({self._seen[step.index]}); keep one of the two rows"
            )
        self._seen[step.index] = row.place
        return step


def _in_words(steps: Sequence[Step]) -> str:
    """Return the targets of a plan in words; the balls of a plate have gaps."""
    known = sorted({step.target for step in steps})
    if known == list(range(len(known))):
        return f"0 to {known[-1]}"
    return ", ".join(map(str, known))
