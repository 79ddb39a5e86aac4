"""The plan of the laser-tracer method: table angles and a block of targets.

The tracer rides on the table; the probe carries the reflector to the targets. Both orders of
measuring are plans: all stations at each target (the order of the paper), and all targets at
each station.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

from rotcal_ros.errors import PlanError
from rotcal_ros.methods.tracer.observability import what_is_missing
from rotcal_ros.methods.tracer.solve import METHOD
from rotcal_ros.observations import Approach, PointKind
from rotcal_ros.planning.plan import Plan, Point, Step
from rotcal_ros.planning.points import block
from rotcal_ros.planning.table_angles import TableAngleSettings, table_angles
from rotcal_ros.planning.visits import visits
from rotcal_ros.settings import setting

STATIONS_PER_TARGET = "stations_per_target"
TARGETS_PER_STATION = "targets_per_station"
LEAST_ANGLES = 3
"""Different table angles below which the stations show no axis, however often they return."""


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
    runs: int = setting(
        1,
        doc="how often all table angles are measured; ISO 230-2 asks for 5",
        minimum=1,
        maximum=100,
    )
    bidirectional: bool = setting(
        False, doc="measure every run on the way up and, from the other side, on the way down"
    )

    @property
    def repeated(self) -> bool:
        """Whether the table comes to an angle more than once."""
        return self.runs > 1 or self.bidirectional


def check_plan(planned: Plan) -> None:
    """Raise PlanError for a plan whose lengths could never be solved."""
    m, n = len(planned.table_angles), len(planned.targets)
    missing = what_is_missing(m, n, m * n)
    if (places := len(set(planned.targets))) < n:
        missing = f"{n} targets at {places} places: box_size_m is 0 where box_points are several"
    if (angles := len(set(planned.table_angles))) < LEAST_ANGLES:
        missing = missing or f"{angles} table angles: a circle needs at least {LEAST_ANGLES}"
    if missing:
        raise PlanError(missing)


def tracer_plan(settings: TracerPlanSettings) -> Plan:
    """Return the plan of one laser-tracer calibration.

    Repeated runs list the table angles again for every arrival: a station is one arrival, at which
    the table stands until all targets are measured. Raises PlanError when explicit angles do not
    ascend, or when repeated runs come with an order that leaves the angle for every target.
    """
    if settings.repeated and settings.order != TARGETS_PER_STATION:
        raise PlanError(
            f"repeated runs need the order {TARGETS_PER_STATION}: with {settings.order} the table "
            "would arrive anew for every target, and no arrival could be told from another"
        )
    angles = table_angles(settings)
    arrivals = visits(len(angles), settings.runs, settings.bidirectional)
    targets = block_of_targets(settings)
    every = tuple(angles[visit.target] for visit in arrivals)
    plan = plan_of(every, targets, [visit.approach for visit in arrivals])
    if settings.order == TARGETS_PER_STATION:
        return plan
    in_order = sorted(plan.steps, key=lambda step: step.target)
    steps = tuple(replace(step, index=number) for number, step in enumerate(in_order))
    return replace(plan, steps=steps)


def plan_of(
    table_angles: tuple[float, ...], targets: tuple[Point, ...], approaches: Sequence[Approach]
) -> Plan:
    """Return the plan that measures every target at each table angle, which is an arrival."""
    pairs = product(range(len(table_angles)), range(len(targets)))
    steps = tuple(
        Step(
            index=number,
            table_position=arrival,
            table_angle=table_angles[arrival],
            approach=approaches[arrival],
            kind=PointKind.REFLECTOR,
            target=target,
            position=targets[target],
        )
        for number, (arrival, target) in enumerate(pairs)
    )
    return Plan(METHOD, table_angles, targets, steps)


def block_of_targets(settings: TracerPlanSettings) -> tuple[Point, ...]:
    """Return the targets (m), layer by layer in a serpentine: neighbours are close together."""
    return block(settings.box_centre_m, settings.box_size_m, settings.box_points)
