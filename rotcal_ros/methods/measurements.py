"""Measurements from plain tables: from a machine's or a tracker's own program."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.tables import Row, read_table, require_header
from rotcal_ros.methods.calibration import Calibration
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.method import Measurements, Trials, find_method, method_names
from rotcal_ros.planning.plan import Plan, Step


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
    path: Path, configuration: Configuration, targets: Path | None = None
) -> Measurements:
    """Read the table at ``path`` as the method of the configuration understands it.

    ``targets`` is a file of target positions, for methods that have targets. Raises BagError
    when a file cannot be read or has other columns, ConfigurationError for a set-up without plan,
    DataError when the content cannot be what it should be.
    """
    table, method = read_table(path), configuration.method
    others = [
        other.name
        for other in map(find_method, method_names())
        if other.table is not None and table.header in other.table.headers
    ]
    if others and method.name not in others:
        raise BagError(
            f"{path} is a table of the method {others[0]}, but {configuration.source} sets up "
            f"{method.name}: give the set-up that belongs to it"
        )
    if method.table is None:
        raise BagError(f"{path}: the method {method.name} reads no plain tables")
    require_header(table, method.table.headers)
    if "plan" not in configuration.given:
        raise ConfigurationError(
            f"{configuration.source} has no group 'plan': it has to say which table angles the "
            f"positions in {path} stand for"
        )
    return method.table.read(configuration, table, targets)


class RowStepFinder:
    """Finds the step of the plan that a row measures, and refuses it twice.

    What the plan measures again, as a plan that closes does, may stand in the table again.
    ``stations``: rows say from which place they were measured; else all places count as the same.
    ``target`` is the word for what is measured.
    """

    def __init__(self, plan: Plan, *, stations: bool = False, target: str = "target") -> None:
        self._plan, self._by_station, self._target = plan, stations, target
        self._steps: dict[tuple[int, int, int], list[Step]] = {}
        for step in plan.steps:
            key = (step.station if stations else 0, step.table_position, step.target)
            self._steps.setdefault(key, []).append(step)
        self._seen: dict[tuple[int, int, int], list[str]] = {}

    def __call__(self, row: Row, position: int, target: int, station: int = 0) -> Step:
        """Return the step that measures a target at a table position, from a place or station."""
        steps = self._steps.get((station, position, target))
        what, places = f"position {position}, {self._target} {target}", ""
        if self._by_station:
            known = len({step.station for step in self._plan.steps})
            what, places = f"place {station}, {what}", f"places 0 to {known - 1}, "
        if steps is None:
            raise DataError(
                f"{row.place}: {what} is not in the plan, which has {places}positions 0 to "
                f"{len(self._plan.table_angles) - 1} and {self._target}s "
                f"{_in_words(self._plan.steps)}; does the set-up belong to this table?"
            )
        seen = self._seen.setdefault((station, position, target), [])
        if len(seen) == len(steps):
            raise DataError(
                f"{row.place}: {what} was measured already ({', '.join(seen)}); keep one of the "
                "rows" + (f", {len(steps)} are in the plan" if len(steps) > 1 else "")
            )
        seen.append(row.place)
        return steps[len(seen) - 1]


def _in_words(steps: Sequence[Step]) -> str:
    """Return the targets of a plan in words; the balls of a plate have gaps."""
    known = sorted({step.target for step in steps})
    if known == list(range(len(known))):
        return f"0 to {known[-1]}"
    return ", ".join(map(str, known))
