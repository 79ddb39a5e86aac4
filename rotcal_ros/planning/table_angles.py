"""The angles at which the table stops; for runs after ISO 230-2, how often and from which side."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.settings import expert, setting
from rotcal_ros.foundation.units import DEGREE

ANGLE_SETTINGS: Final = (
    "table_start_deg", "table_step_deg", "table_positions", "table_angles_deg",
)  # fmt: skip
"""The settings of a plan that state its table angles."""


@dataclass(frozen=True)
class TableAngleSettings:
    """The commanded table angles."""

    table_start_deg: float = setting(0.0, doc="deg, first table angle", first=True)
    table_step_deg: float = setting(30.0, doc="deg, step between table angles", first=True)
    table_positions: int = setting(
        12, doc="number of table angles", minimum=2, maximum=3600, first=True
    )
    table_angles_deg: tuple[float, ...] = setting(
        (), doc="deg, explicit ascending table angles; replaces start, step and positions"
    )


def run_up_setting() -> Any:
    """Return the field of how far a table turns beside its angles."""
    return expert(
        15.0, minimum=1e-3, maximum=360.0,
        doc="deg, of a table that turns: before the first angle and behind the last, where it "
        "gets up to its speed and comes to rest",
    )  # fmt: skip


def passing_setting(default: float) -> Any:
    """Return the field of how near to an angle readings count for it."""
    return expert(
        default,
        minimum=1e-3,
        maximum=90.0,
        doc="deg, of a table that turns: readings up to so far from a table angle count for it",
    )


def table_angles(settings: TableAngleSettings) -> tuple[float, ...]:
    """Return the commanded table angles in radians; raises PlanError if they do not ascend."""
    degrees = settings.table_angles_deg or tuple(
        settings.table_start_deg + i * settings.table_step_deg
        for i in range(settings.table_positions)
    )
    if any(b <= a for a, b in pairwise(degrees)):
        raise PlanError(f"table angles must ascend, found {list(degrees)} degrees")
    return tuple(d * DEGREE for d in degrees)


@dataclass(frozen=True, slots=True)
class Arrival:
    """One arrival of the table at target angle number ``target`` in ``run``, from one side."""

    target: int
    run: int
    approach: Approach


def planned_arrivals(targets: int, runs: int, bidirectional: bool) -> tuple[Arrival, ...]:
    """Return all arrivals: up through all ``targets`` angles, and down again if ``bidirectional``.

    Every run is complete before the next begins.
    """
    ways = [(range(targets), Approach.POSITIVE)]
    if bidirectional:
        ways.append((range(targets)[::-1], Approach.NEGATIVE))
    return tuple(
        Arrival(target, run, approach)
        for run in range(runs)
        for order, approach in ways
        for target in order
    )
