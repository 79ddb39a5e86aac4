"""Ball centres as a plain table: ``position,ball_step,x_m,y_m,z_m``; set-ups that are a plate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from rotcal_ros.catalogue.calibration import prepare
from rotcal_ros.catalogue.configuration import Configuration
from rotcal_ros.catalogue.measurements import PlannedMeasurements, StepFinder
from rotcal_ros.methods.ball_plate.plate import parse_plate
from rotcal_ros.observations import PointKind
from rotcal_ros.tables import Header, Table, hashes

HEADERS: Final[tuple[Header, ...]] = (
    ("position", "ball_step", "x_m", "y_m", "z_m"),
    ("table_index", "ball_step", "x_m", "y_m", "z_m"),
)
SIGMA: Final = "sigma_centre_m"


def read(configuration: Configuration, table: Table, _targets: Path | None) -> PlannedMeasurements:
    """Return ball centres by table position and ball step, numbered in the order of the rows.

    A plate that moved is looked for in the order of measurement, which is that of the rows.
    """
    calibration, position = prepare(configuration), table.header[0]
    find = StepFinder(calibration.plan)
    observations = []
    for number, row in enumerate(table.rows()):
        step = find(row, row.index(position), row.index("ball_step"))
        observation = step.observed(row.point(), PointKind.CENTRE)
        observations.append(replace(observation, step=number))
    return PlannedMeasurements(calibration, tuple(observations), hashes(table.path))


def short_setup(document: Mapping[str, Any], where: str) -> Mapping[str, Any]:
    """Return the groups of settings that the entries of a plate file state.

    Beside the plate, ``sigma_centre_m`` states the standard deviation of a centre. Raises
    ConfigurationError for a plate that cannot be.
    """
    entries = {name: value for name, value in document.items() if name not in ("method", SIGMA)}
    parse_plate(entries, where)
    groups: dict[str, Any] = {"plan": {"plate": entries, "measure": "centre"}}
    if SIGMA in document:
        groups["solver"] = {SIGMA: document[SIGMA]}
    return groups
