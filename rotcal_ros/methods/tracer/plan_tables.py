"""The tables of an explicit plan: ``target,x_m,y_m,z_m`` and ``step,table_position,target``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.tables import read_table, require_header
from rotcal_ros.methods.method import PlanFile
from rotcal_ros.methods.tracer.table import TARGETS, read_targets
from rotcal_ros.planning.plan import Point

PAIRS: Final = ("step", "table_position", "target")


def read_pairs(path: Path) -> tuple[int, ...]:
    """Return table position and target of every step, one after the other, by their numbers.

    Raises BagError for a file that is no such table, DataError for steps that are listed twice
    or missing.
    """
    table = read_table(path)
    require_header(table, (PAIRS,))
    steps: dict[int, tuple[int, int]] = {}
    for row in table.rows():
        number = row.index("step")
        if number in steps:
            raise DataError(f"{row.place}: step {number} is listed twice")
        steps[number] = row.index("table_position"), row.index("target")
    for number in range(len(steps)):
        if number not in steps:
            raise DataError(
                f"{path}: steps are numbered from 0 without gaps, but step {number} is missing"
            )
    return tuple(index for number in range(len(steps)) for index in steps[number])


def write_targets(path: Path, targets: Sequence[Point]) -> None:
    """Write ``targets`` (m) so that they are read as the same bits."""
    _write(path, TARGETS, [(number, *map(float, point)) for number, point in enumerate(targets)])


def write_pairs(path: Path, pairs: Sequence[tuple[int, int]]) -> None:
    """Write the pairs (table position, target) of a plan in their order."""
    _write(path, PAIRS, [(number, *pair) for number, pair in enumerate(pairs)])


def _write(path: Path, header: Sequence[str], rows: Sequence[tuple[float, ...]]) -> None:
    lines = [",".join(header), *(",".join(map(repr, row)) for row in rows)]
    write_atomically(path, "\n".join(lines) + "\n")


def _coordinates(path: Path) -> tuple[float, ...]:
    return tuple(value for point in read_targets(path) for value in point)


PLAN_FILES: Final[Mapping[str, PlanFile]] = {
    "targets_file": PlanFile("targets_m", _coordinates),
    "pairs_file": PlanFile("pairs", read_pairs),
}
