"""The plan of the six-deviations method: places of the tracer, table angles, targets.

The tracer stands at one place of the table after the other. From each it measures lengths to the
same targets while the table turns; between two places a person fixes it anew.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain, product
from typing import Final

from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.tracer.settings import TARGETS_PER_STATION
from rotcal_ros.methods.tracer_six.places import around, described, require_six
from rotcal_ros.methods.tracer_six.settings import SixPlanSettings
from rotcal_ros.methods.tracer_six.solver import METHOD
from rotcal_ros.planning.plan import TABLE_FRAME, Move, Pause, Plan, Point, Step
from rotcal_ros.planning.points import block, triples
from rotcal_ros.planning.table_angles import table_angles, visits

LOCATING: Final = 6
"""Targets after which the lengths at a table angle show where the tracer stands: 4 unknowns."""
LEAST_ANGLES: Final = 3


def plan(configuration: Configuration) -> Plan:
    """Return the plan of a configuration; PlanError where its places lose a deviation."""
    try:
        return six_plan(
            configuration.plan, tilt_known=configuration.solver.tilt_std_rad is not None
        )
    except PlanError as error:
        raise PlanError(f"{configuration.source}: {error}") from error


def six_plan(settings: SixPlanSettings, *, tilt_known: bool = False) -> Plan:
    """Return the plan of one calibration.

    ``Step.station`` is the number of the place. Raises PlanError for places that lose a deviation
    at every angle, unless it is a tilt and ``tilt_known`` beforehand, and for several arrivals in
    an order that cannot keep them apart.
    """
    if settings.arrivals > 1 and settings.order != TARGETS_PER_STATION:
        raise PlanError(
            f"plan: several arrivals need the order {TARGETS_PER_STATION}: with {settings.order} "
            "the table arrives anew for every target, and no arrival could be told from another"
        )
    places = places_of(settings)
    require_six(places, tilt_known=tilt_known)
    return plan_of(settings, targets_of(settings))


def plan_of(settings: SixPlanSettings, targets: tuple[Point, ...]) -> Plan:
    """Return the plan that measures ``targets`` (m) from every place at the angles.

    With ``bidirectional`` table position 2 n - 1 - i stands at the angle of position i, reached
    from above.
    """
    distinct, places = table_angles(settings), places_of(settings)
    every = visits(len(distinct), runs=1, bidirectional=settings.bidirectional)
    angles = tuple(distinct[visit.target] for visit in every)
    visited = [*range(len(angles))] * settings.arrivals + [0] * settings.closes
    blocks = [
        _rows(number, visited, len(targets), settings.order) for number in range(len(places))
    ]
    steps = tuple(
        Step(
            index=index,
            table_position=position,
            table_angle=angles[position],
            approach=every[position].approach,
            kind=PointKind.REFLECTOR,
            target=target,
            position=targets[target],
            station=place,
        )
        for index, (place, position, target) in enumerate(chain(*blocks))
    )
    length = len(visited) * len(targets)
    pauses = tuple(
        Pause(
            first := number * length,
            _located(steps[first : first + length], settings.order),
            _instruction(number, places, len(targets), len(distinct)),
            move=Move("tracer", number, places[number], TABLE_FRAME),
        )
        for number in range(len(places))
    )
    return Plan(METHOD, angles, targets, steps, pauses)


def places_of(settings: SixPlanSettings) -> tuple[Point, ...]:
    """Return the places of the tracer (m), table frame at angle 0."""
    if settings.places_m:
        return triples(settings.places_m, "places_m")
    return around(
        settings.places,
        settings.place_radius_m,
        settings.place_azimuth_deg * DEGREE,
        settings.place_height_m,
        settings.place_height_step_m,
    )


def targets_of(settings: SixPlanSettings) -> tuple[Point, ...]:
    """Return the targets (m), machine frame."""
    if settings.targets_m:
        return triples(settings.targets_m, "targets_m")
    return block(settings.box_centre_m, settings.box_size_m, settings.box_points)


def check_plan(_configuration: Configuration, planned: Plan) -> None:
    """Raise PlanError for a plan whose lengths could never be solved."""
    n = len(planned.targets)
    if (apart := len(set(planned.targets))) < n:
        raise PlanError(
            f"{n} targets at {apart} places: box_size_m is 0 where box_points are more"
        )
    if n < LOCATING:
        raise PlanError(
            f"{n} targets: a place and its zero are 4 unknowns, and every target has errors of "
            f"its own; at least {LOCATING} targets are needed"
        )
    if len(planned.distinct_angles) < LEAST_ANGLES:
        raise PlanError(
            f"{len(planned.distinct_angles)} table angles: what turns with the table and what "
            f"stands still are told apart from {LEAST_ANGLES} on"
        )


def _rows(
    place: int, visited: Sequence[int], n_targets: int, order: str
) -> Iterator[tuple[int, int, int]]:
    """Return place, table position and target of each step at a place."""
    if order == TARGETS_PER_STATION:
        return ((place, at, target) for at, target in product(visited, range(n_targets)))
    return ((place, at, target) for target, at in product(range(n_targets), visited))


def _located(steps: Sequence[Step], order: str) -> int:
    """Return the step after which enough targets were measured at the first angle.

    All of them, where they are measured before the table turns; else LOCATING.
    """
    at_first = [step for step in steps if step.table_position == steps[0].table_position]
    targets = {step.target: step.index for step in reversed(at_first)}
    indices = sorted(targets.values())
    return indices[-1] if order == TARGETS_PER_STATION else indices[:LOCATING][-1]


def _instruction(number: int, places: tuple[Point, ...], n_targets: int, n_angles: int) -> str:
    return (
        f"fix the tracer at place {number} (of 0 to {len(places) - 1}) on the table, "
        f"{described(places[number])}; it will measure {n_targets} targets at "
        f"{n_angles} table angles, and must not move on the table meanwhile"
    )
