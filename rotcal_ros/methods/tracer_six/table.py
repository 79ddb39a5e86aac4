"""Lengths as a plain table: ``place,position,target,length_m``, and beside it ``targets.csv``.

A fifth column ``segment`` numbers the unbroken beams from a place; without it each has one.
"""

from __future__ import annotations

from typing import Final

from rotcal_ros.foundation.tables import Header, Table
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.measurements import PlannedMeasurements
from rotcal_ros.methods.tracer.table import SEGMENT, read_lengths
from rotcal_ros.methods.tracer_six.plan import plan_of

COLUMNS: Final = {"place": "station", "position": "table_position", "target": "target"}
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
        COLUMNS,
        lambda _, listed: plan_of(configuration.plan, listed),
    )
