"""Ball centres as a plain table: ``position,ball_step,x_m,y_m,z_m``; set-ups that are a plate.

Optional columns ``sx_m,sy_m,sz_m``: the standard deviation of each centre.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.tables import Header, Row, Table, hashes
from rotcal_ros.methods.ball_plate.settings import CENTRE
from rotcal_ros.methods.calibration import prepare
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.measurements import PlannedMeasurements, RowStepFinder

COLUMNS: Final = {"position": "table_position", "ball_step": "target"}
STD: Final[Header] = ("sx_m", "sy_m", "sz_m")
_CENTRES: Final[Header] = ("position", "ball_step", "x_m", "y_m", "z_m")
HEADERS: Final[tuple[Header, ...]] = (_CENTRES, _CENTRES + STD)
SIGMA: Final = "sigma_centre_m"
AXES: Final = "sigma_axes_m"


def read(
    configuration: Configuration, table: Table, _targets: Table | None
) -> PlannedMeasurements:
    """Return ball centres by table position and ball step, numbered in the order of the rows.

    A plate that moved is looked for in the order of measurement, which is that of the rows.
    Standard deviations in the table take the place of those of the set-up.
    """
    stated = table.header[-3:] == STD
    if stated:
        solver = replace(configuration.solver, own_std=True)
        configuration = replace(configuration, solver=solver)
    calibration = prepare(configuration)
    find = RowStepFinder(calibration.plan, COLUMNS)
    observations = []
    for number, row in enumerate(table.rows()):
        observation = find(row).observed(row.point(), PointKind.CENTRE)
        std = tuple(_std(row, name) for name in STD) if stated else observation.std
        observations.append(replace(observation, step=number, std=std))
    return PlannedMeasurements(calibration, tuple(observations), hashes(table))


def short_setup(entries: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the settings that the entries of a plate file state.

    Its balls are measured as centres. Beside the plate, ``sigma_centre_m`` states the standard
    deviation of a centre: a number, or a list of three for x, y, z.
    """
    several = isinstance(entries.get(SIGMA), list)
    named = {AXES if name == SIGMA and several else name: v for name, v in entries.items()}
    return {"measure": CENTRE, **named}


def _std(row: Row, name: str) -> float:
    """Return a standard deviation, metres; raises DataError unless it is positive."""
    value = row.metres(name, farthest=1e-2)
    if not value > 0.0:
        raise DataError(f"{row.place}: {name} must be positive, found {value:g} m")
    return value
