"""Lengths as a plain table: ``position,target,length_m``, and beside it ``targets.csv``."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Final

from rotcal_ros.catalogue.calibration import Calibration, prepare
from rotcal_ros.catalogue.configuration import Configuration
from rotcal_ros.catalogue.measurements import PlannedMeasurements, StepFinder
from rotcal_ros.catalogue.tracer.plausibility import LengthCheck
from rotcal_ros.errors import DataError
from rotcal_ros.observations import Approach, Observation, PointKind
from rotcal_ros.planning.plan import Plan, Point, Step
from rotcal_ros.tables import Header, Row, Table, hashes, read_table, require_header

HEADER: Final = ("position", "target", "length_m")
OLD_HEADER: Final = ("station", "target", "length_m")
TARGETS: Final = ("target", "x_m", "y_m", "z_m")
TARGETS_FILE: Final = "targets.csv"


class TracerTable:
    """Reads lengths by table position and target; a table tells no scatter, so there is none."""

    headers: tuple[Header, ...] = (HEADER, OLD_HEADER)

    def read(
        self, configuration: Configuration, table: Table, targets: Path | None
    ) -> PlannedMeasurements:
        """Return the observations.

        The targets are those of the file ``targets``, of ``targets.csv`` beside the table, or of
        the set-up, in this order.
        """
        files, calibration = [table.path], prepare(configuration)
        beside = table.path.with_name(TARGETS_FILE)
        if targets is None and beside.exists():
            targets = beside
        if targets is not None:
            files.append(targets)
            plan = plan_of_targets(calibration.plan, read_targets(targets))
            calibration = Calibration(configuration, plan)
        rows, position = table.rows(), table.header[0]
        find = StepFinder(calibration.plan)
        observations = tuple(
            find(row, row.index(position), row.index("target")).observed((row.metres("length_m"),))
            for row in rows
        )
        _check_lengths(calibration.plan, rows, observations)
        return PlannedMeasurements(calibration, observations, hashes(*files))


def read_targets(path: Path) -> tuple[Point, ...]:
    """Return the target positions (m) of ``targets.csv`` in the order of their numbers."""
    table = read_table(path)
    require_header(table, (TARGETS,))
    points: dict[int, Point] = {}
    for row in table.rows():
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


def plan_of_targets(plan: Plan, targets: tuple[Point, ...]) -> Plan:
    """Return the plan with other targets: every target at every table position."""
    pairs = product(range(len(plan.table_angles)), range(len(targets)))
    steps = tuple(
        Step(
            index=number,
            table_index=position,
            table_angle=plan.table_angles[position],
            approach=Approach.UNKNOWN,
            kind=PointKind.REFLECTOR,
            target=target,
            position=targets[target],
        )
        for number, (position, target) in enumerate(pairs)
    )
    return Plan(plan.method, plan.table_angles, targets, steps)


def _check_lengths(plan: Plan, rows: list[Row], observations: tuple[Observation, ...]) -> None:
    """Raise DataError where a length cannot fit the distance between its targets."""
    check = LengthCheck(plan)
    for row, observation in zip(rows, observations, strict=True):
        checked = check(observation)
        if not checked.accepted:
            raise DataError(f"{row.place}: {checked.reason}")
