"""Lengths as a plain table: ``place,position,target,length_m``, and beside it ``targets.csv``.

A fifth column ``segment`` numbers the unbroken beams from a place; without it each has one.
A short set-up lists settings of the plan and of the solver by their names, points as x, y, z.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.plugins import nearest
from rotcal_ros.foundation.settings import declarations
from rotcal_ros.foundation.tables import Header, Table
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.measurements import PlannedMeasurements
from rotcal_ros.methods.tracer.table import SEGMENT, read_lengths
from rotcal_ros.methods.tracer_six.plan import plan_of
from rotcal_ros.methods.tracer_six.settings import SixPlanSettings
from rotcal_ros.methods.tracer_six.solver import TracerSixSolverSettings

HEADERS: Final[tuple[Header, ...]] = (
    ("place", "position", "target", "length_m"),
    ("place", "position", "target", "length_m", SEGMENT),
)


def read(configuration: Configuration, table: Table, targets: Table | None) -> PlannedMeasurements:
    """Return lengths by place, table position and target; a table tells no scatter.

    What the plan measures several times may stand in the table as often, in the order of time.
    """
    return read_lengths(
        configuration,
        table,
        targets,
        {"place": "station", "position": "table_position", "target": "target"},
        lambda _, listed: plan_of(configuration.plan, listed),
    )


def short_setup(document: Mapping[str, Any], where: str) -> Mapping[str, Any]:
    """Return the groups of settings that the entries of a short set-up state.

    Raises ConfigurationError, with the nearest name, for an entry that is no setting.
    """
    group_of = {
        declared.name: group
        for group, cls in (("plan", SixPlanSettings), ("solver", TracerSixSolverSettings))
        for declared in declarations(cls)
    }
    groups: dict[str, dict[str, Any]] = {"plan": {}, "solver": {}}
    for name, value in document.items():
        if name == "method":
            continue
        if name not in group_of:
            raise ConfigurationError(
                f"{where}: unknown entry {name!r}{nearest(str(name), group_of)}"
            )
        groups[group_of[name]][name] = _flat(value)
    return groups


def _flat(value: Any) -> Any:
    """Return a list of points as a flat list of their coordinates, anything else as it is."""
    if isinstance(value, list) and value and all(isinstance(point, list) for point in value):
        return [coordinate for point in value for coordinate in point]
    return value
