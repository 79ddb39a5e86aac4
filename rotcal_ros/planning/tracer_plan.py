"""The plan of the laser-tracer method: table angles and a block of targets.

The tracer rides on the table; the probe carries the reflector to the targets. Both orders of
measuring are plans: all stations at each target (the order of the paper), and all targets at
each station.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from rotcal_ros.observations import Approach, PointKind
from rotcal_ros.planning.plan import Plan, Point, Step
from rotcal_ros.planning.table_angles import TableAngleSettings, table_angles
from rotcal_ros.settings import setting

STATIONS_PER_TARGET = "stations_per_target"
TARGETS_PER_STATION = "targets_per_station"


@dataclass(frozen=True)
class TracerPlanSettings(TableAngleSettings):
    """Where the table turns and where the reflector goes."""

    box_centre_m: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.6), doc="m, centre of the block of targets"
    )
    box_size_m: tuple[float, float, float] = setting(
        (0.45, 0.6, 0.45), doc="m, size of the block of targets", minimum=0.0
    )
    box_points: tuple[int, int, int] = setting(
        (4, 4, 4), doc="number of targets along x, y and z", minimum=1, maximum=1000
    )
    order: str = setting(
        STATIONS_PER_TARGET,
        doc="what changes fastest: the table (the paper's order) or the target",
        choices=(STATIONS_PER_TARGET, TARGETS_PER_STATION),
    )


def tracer_plan(settings: TracerPlanSettings, method: str = "tracer_multistation") -> Plan:
    """Return the plan of one laser-tracer calibration.

    Raises PlanError when explicit angles do not ascend.
    """
    angles = table_angles(settings)
    targets = block_of_targets(settings)
    pairs = product(range(len(targets)), range(len(angles)))
    if settings.order == TARGETS_PER_STATION:
        pairs = ((t, a) for a, t in product(range(len(angles)), range(len(targets))))  # type: ignore[assignment]
    steps = tuple(
        Step(
            index=number,
            table_index=angle,
            table_angle=angles[angle],
            approach=Approach.POSITIVE,
            kind=PointKind.REFLECTOR,
            target=target,
            position=targets[target],
        )
        for number, (target, angle) in enumerate(pairs)
    )
    return Plan(method=method, table_angles=angles, targets=targets, steps=steps)


def block_of_targets(settings: TracerPlanSettings) -> tuple[Point, ...]:
    """Return the targets (m), layer by layer in a serpentine: neighbours are close together."""
    axes = [
        np.linspace(c - s / 2, c + s / 2, n) if n > 1 else np.array([c])
        for c, s, n in zip(
            settings.box_centre_m, settings.box_size_m, settings.box_points, strict=True
        )
    ]
    x_axis, y_axis, z_axis = axes
    rows = [(y, z) for k, z in enumerate(z_axis) for y in y_axis[:: _zigzag(k)]]
    return tuple(
        (float(x), float(y), float(z))
        for k, (y, z) in enumerate(rows)
        for x in x_axis[:: _zigzag(k)]
    )


def _zigzag(row: int) -> int:
    """Return the direction of travel (1 or -1) of a row of a serpentine."""
    return -1 if row % 2 else 1
