"""The plan of the six-deviations method: places of the tracer, table angles, targets.

The tracer stands at one place of the table after the other. From each it measures lengths to the
same targets while the table turns; between two places a person fixes it anew. Places determine all
six deviations, or do not: those in a line lose one (:func:`_require_six`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain, product
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.units import DEGREE, MILLIMETRE
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.tracer.plan import targets_of, turning_steps
from rotcal_ros.methods.tracer.settings import TARGETS_PER_STATION
from rotcal_ros.methods.tracer_six.settings import SixPlanSettings
from rotcal_ros.methods.tracer_six.solver import METHOD
from rotcal_ros.methods.tracer_six.solver.problem import lost_direction
from rotcal_ros.planning.plan import (
    TABLE_FRAME,
    OperatorMove,
    Pause,
    Plan,
    Point,
    Step,
    numbered_steps,
)
from rotcal_ros.planning.points import parse_points
from rotcal_ros.planning.table_angles import planned_arrivals, table_angles

LOCATING: Final = 6
"""Targets after which the lengths at a table angle show where the tracer stands: 4 unknowns."""
LEAST_TURNS: Final = 4
"""Targets of a table that turns: 12 lengths at an angle from three places, for 6 unknowns."""
LEAST_ANGLES: Final = 3
"""Below it what turns with the table is not separated from what stands still."""
LEAST_PLACES: Final = 3
"""Two leave a turn about the line through them."""
_UPRIGHT: Final = 0.7
"""Vertical part from which the turn that is lost about a line is mostly ECC."""


def plan(configuration: Configuration) -> Plan:
    """Return the plan of a configuration; PlanError where its places lose a deviation."""
    try:
        return six_plan(configuration.plan, tilt_known=tilt_known(configuration))
    except PlanError as error:
        raise PlanError(f"{configuration.source}: {error}") from error


def tilt_known(configuration: Configuration) -> bool:
    """Return whether the tilts of the table are stated."""
    return configuration.solver.tilt_std_rad is not None


def six_plan(
    settings: SixPlanSettings, targets: tuple[Point, ...] = (), *, tilt_known: bool = False
) -> Plan:
    """Return the plan of one calibration; ``targets``: in place of the plan's.

    ``Step.station`` is the number of the place. Raises PlanError for places that lose a deviation
    at every angle, unless it is a tilt and ``tilt_known`` beforehand, and for several arrivals in
    an order that cannot keep them apart.
    """
    if settings.turning_deg_s and (settings.bidirectional or settings.arrivals > 1):
        raise PlanError(
            "plan: turning_deg_s measures every target in a whole turn at each speed: leave out "
            "bidirectional and arrivals; speeds of both signs measure both directions"
        )
    if settings.arrivals > 1 and settings.order != TARGETS_PER_STATION:
        raise PlanError(
            f"plan: several arrivals need the order {TARGETS_PER_STATION}: with {settings.order} "
            "the table arrives anew for every target, and no arrival could be distinguished from "
            "another"
        )
    places = places_of(settings)
    _require_six(places, tilt_known=tilt_known)
    return plan_of(settings, targets or targets_of(settings))


def plan_of(settings: SixPlanSettings, targets: tuple[Point, ...]) -> Plan:
    """Return the plan that measures ``targets`` (m) from every place at the angles.

    With ``bidirectional`` table position 2 n - 1 - i stands at the angle of position i, reached
    from above.
    """
    if settings.turning_deg_s:
        return _turning_plan(settings, targets)
    distinct, places = table_angles(settings), places_of(settings)
    every = planned_arrivals(len(distinct), runs=1, bidirectional=settings.bidirectional)
    angles = tuple(distinct[visit.target] for visit in every)
    visited = [*range(len(angles))] * settings.arrivals + [0] * settings.closes
    blocks = [
        _rows(number, visited, len(targets), settings.order) for number in range(len(places))
    ]
    sides = [visit.approach for visit in every]
    steps = numbered_steps(chain(*blocks), angles, targets, PointKind.REFLECTOR, approaches=sides)
    length = len(visited) * len(targets)
    pauses = tuple(
        Pause(
            first := number * length,
            _located(steps[first : first + length], settings.order),
            _instruction(number, places, len(targets), len(distinct)),
            move=OperatorMove("tracer", number, places[number], TABLE_FRAME),
        )
        for number in range(len(places))
    )
    return Plan(METHOD, angles, targets, steps, pauses)


def _turning_plan(settings: SixPlanSettings, targets: tuple[Point, ...]) -> Plan:
    """Return the plan of a table that turns at every place once at each speed for each target.

    Table position r n + i is passed at the angle of number i in the run r, at the speed r. Each
    turn counts from a zero of its own, so that no single one shows where the tracer stands.
    """
    angles, places = table_angles(settings), places_of(settings)
    once = turning_steps(settings, angles, targets)
    steps = tuple(
        replace(
            step,
            index=place * len(once) + step.index,
            station=place,
            table_position=step.station * len(angles) + step.table_position,
        )
        for place, step in product(range(len(places)), once)
    )
    pauses = tuple(
        Pause(
            first := number * len(once),
            first - 1,
            _instruction(number, places, len(targets), len(angles)),
            move=OperatorMove("tracer", number, places[number], TABLE_FRAME),
        )
        for number in range(len(places))
    )
    every = angles * len(settings.turning_deg_s)
    return Plan(METHOD, every, targets, steps, pauses)


def places_of(settings: SixPlanSettings) -> tuple[Point, ...]:
    """Return the places of the tracer (m), table frame at angle 0."""
    if settings.places_m:
        return parse_points(settings.places_m, "places_m")
    return places_around_axis(
        settings.places,
        settings.place_radius_m,
        settings.place_azimuth_deg * DEGREE,
        settings.place_height_m,
        settings.place_height_step_m,
    )


def check_plan(planned: Plan, *, turning: bool = False) -> None:
    """Raise PlanError for a plan whose lengths could never be solved.

    A table that is ``turning`` has a zero for each turn.
    """
    n = len(planned.targets)
    if (apart := len(set(planned.targets))) < n:
        raise PlanError(
            f"{n} targets at {apart} places: box_size_m is 0 where box_points are more; give a "
            "size"
        )
    if turning and n < LEAST_TURNS:
        raise PlanError(
            f"{n} targets: every turn counts from a zero of its own; give at least {LEAST_TURNS}"
        )
    if not turning and n < LOCATING:
        raise PlanError(
            f"{n} targets: a place and its zero are 4 unknowns, and every target has errors of "
            f"its own; give at least {LOCATING}"
        )
    if len(planned.distinct_angles) < LEAST_ANGLES:
        raise PlanError(
            f"{len(planned.distinct_angles)} table angles: to separate what turns with the table "
            f"from what stands still, give at least {LEAST_ANGLES}"
        )


def _rows(
    place: int, visited: Sequence[int], n_targets: int, order: str
) -> Iterator[tuple[int, int, int]]:
    """Return table position, target and place of each step at a place."""
    if order == TARGETS_PER_STATION:
        return ((at, target, place) for at, target in product(visited, range(n_targets)))
    return ((at, target, place) for target, at in product(range(n_targets), visited))


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
        f"fix the tracer at place {number + 1} of {len(places)} (number {number} in the data) on "
        f"the table, {describe_place(places[number])}; it will measure {n_targets} targets at "
        f"{n_angles} table angles, and must not move on the table meanwhile"
    )


def places_around_axis(
    count: int, radius: float, azimuth: float, height: float, height_step: float
) -> tuple[Point, ...]:
    """Return ``count`` places evenly around the axis, the first at ``azimuth`` (rad), in metres.

    Each is ``height_step`` higher than the one before, the first at ``height``. Table frame at
    angle 0.
    """
    angles = azimuth + 2.0 * np.pi * np.arange(count) / count
    heights = height + height_step * np.arange(count)
    rows = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), heights])
    return tuple((x, y, z) for x, y, z in rows.tolist())


def _require_six(places: tuple[Point, ...], *, tilt_known: bool = False) -> None:
    """Raise PlanError, with the lost direction, unless the places determine six deviations.

    ``tilt_known``: a lost tilt is tolerated, because it is stated beforehand.
    """
    points = np.array(places)
    if len(set(places)) < 2:
        raise PlanError(
            f"plan: the tracer stands at {len(places)} place(s) of the table: six deviations need "
            f"{LEAST_PLACES} that do not lie in a line; raise plan.places"
        )
    lost = lost_direction(points)
    if lost is None:
        return
    x, y, z = (lost.round(3) + 0.0).tolist()  # without negative zeros
    upright = abs(z) > _UPRIGHT
    if tilt_known and not upright:
        return
    what = "ECC" if upright else "the tilt about it"
    lie = f"the {len(places)} places" + (" lie in a line:" if len(places) > 2 else ":")
    stated = "" if upright else ", or state solver.tilt_std_rad"
    raise PlanError(
        f"plan: {lie} a turn of the table about the line through them ({x:.3f}, {y:.3f}, {z:.3f}) "
        f"moves none of them, so that no length determines {what}; take {LEAST_PLACES} places "
        f"that do not lie in a line, at best 120 degrees apart{stated}"
    )


def describe_place(place: Point | Floats) -> str:
    """Return a place in words a person can work with."""
    x, y, z = place
    azimuth = np.arctan2(y, x) / DEGREE % 360.0
    return (
        f"{np.hypot(x, y) / MILLIMETRE:.0f} mm from the table axis towards {azimuth:.0f} deg of "
        f"the table, its centre {z / MILLIMETRE:.0f} mm above it"
    )
