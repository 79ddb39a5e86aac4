"""The plan of the laser-tracer method: table angles and a block of targets.

The tracer rides on the table; the probe carries the reflector to the targets. Both orders of
measuring are plans: all stations at each target (the order of the paper), and all targets at
each station. An explicit plan lists its own targets, and the pairs of table position and target in
the order in which they are measured.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import compress, product
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.foundation.observations import Approach, PointKind, Turn
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.geometry.rotations import positions_on_table
from rotcal_ros.methods.tracer.settings import (
    TARGETS_PER_STATION,
    BlockSettings,
    TracerPlanSettings,
    TracerSolverSettings,
    TurningBlockSettings,
)
from rotcal_ros.methods.tracer.solver.circle import contrast_count
from rotcal_ros.methods.tracer.solver.observability import what_is_missing
from rotcal_ros.methods.tracer.solver.problem import station_minimum
from rotcal_ros.methods.tracer.solver.solve import METHOD
from rotcal_ros.planning.plan import Plan, Point, Step, numbered_steps
from rotcal_ros.planning.points import are_collinear, are_coplanar, parse_points
from rotcal_ros.planning.table_angles import planned_arrivals, table_angles

LEAST_BEAMS = 4
"""Targets with a free beam that a station has to see."""
LEAST_ANGLES = 3
"""Different table angles below which the stations show no axis, however often they return."""


def check_plan(solver: TracerSolverSettings, planned: Plan, *, turning: bool = False) -> None:
    """Raise PlanError for a plan whose lengths could never be solved.

    A table that is ``turning`` has a zero for each turn, and no length to spare is too few.
    """
    at, of = (
        np.array([getattr(step, name) for step in planned.steps])
        for name in ("table_position", "target")
    )
    shared = turning or solver.zero == "per_segment"
    on_circle = solver.circle_std_m is not None
    least = station_minimum(not shared, on_circle) + int(turning)
    different = np.array(sorted({*zip(at.tolist(), of.tolist(), strict=True)}))
    lengths = np.bincount(different[:, 0], minlength=len(planned.table_angles))
    poor = np.flatnonzero(lengths < least)
    enough = lengths[at] >= least
    n = len(planned.targets)
    free = solver.variant == "joint" and solver.datum == "free"
    m, count = int((lengths >= least).sum()), int(enough.sum())
    missing = what_is_missing(m, len(set(of[enough])), count, free and not shared, least)
    unknowns = 3 * m + (1 if shared else m) - (contrast_count(m) if on_circle else 0)
    if not missing and count < unknowns:
        missing = (
            f"{count} lengths from {m} stations are fewer than the {unknowns} unknowns: measure "
            "more targets"
        )
    if len(poor) and not missing:
        missing = (
            f"table position {poor[0]} has {lengths[poor[0]]} lengths, at least {least} are "
            "needed at each"
        )
    if (places := len(set(planned.targets))) < n:
        missing = (
            f"{n} targets at {places} places: targets_m repeats one, or box_size_m is 0 where "
            "box_points are several"
        )
    if not on_circle and not missing and are_collinear(np.array(planned.targets)):
        missing = (
            f"the {n} targets lie in a line, about which every station could be turned without a "
            "trace in the lengths: put some aside"
        )
    if not (on_circle or shared or missing) and n == 4 and are_coplanar(np.array(planned.targets)):
        missing = (
            "4 targets in one plane do not determine a station with a zero of its own: put one "
            "out of the plane, or measure more"
        )
    if (angles := len(set(planned.table_angles))) < LEAST_ANGLES:
        missing = missing or f"{angles} table angles: a circle needs at least {LEAST_ANGLES}"
    if missing:
        raise PlanError(missing)


MOST_PASSED: Final = 14_400
"""Angles, each at every speed: twice those of 3,600 angles in both directions, 22 MB of result."""


def tracer_plan(settings: TracerPlanSettings) -> Plan:
    """Return the plan of one laser-tracer calibration.

    Explicit pairs are measured as they are listed, every position reached from below. Repeated
    runs list the table angles again for every arrival: a station is one arrival, at which the
    table stands until all targets are measured. Raises PlanError when explicit angles do not
    ascend, when repeated runs come with an order that leaves the angle for every target, or when
    pairs are not of the plan's angles and targets.
    """
    if settings.turning_deg_s:
        return turning_plan(settings)
    if settings.pairs:
        return explicit_plan(settings)
    if settings.repeated and settings.order != TARGETS_PER_STATION:
        raise PlanError(
            f"repeated runs need the order {TARGETS_PER_STATION}: with {settings.order} the table "
            "would arrive anew for every target, and no arrival could be distinguished from "
            "another"
        )
    angles = table_angles(settings)
    arrivals = planned_arrivals(len(angles), settings.runs, settings.bidirectional)
    targets = targets_of(settings)
    every = tuple(angles[visit.target] for visit in arrivals)
    plan = plan_of(every, targets, [visit.approach for visit in arrivals])
    if settings.limited:
        plan = _with_free_beams(plan, settings)
    if settings.order == TARGETS_PER_STATION:
        return plan
    return _renumbered(plan, sorted(plan.steps, key=lambda step: step.target))


def turning_plan(settings: TracerPlanSettings, targets: Sequence[Point] = ()) -> Plan:
    """Return the plan of a table that turns once at each speed, for one target after the other.

    ``targets``: in place of the plan's. A step's station is its run: the number of its speed.
    Raises PlanError for settings that ask for stops, and as :func:`turning_steps`.
    """
    if settings.pairs or settings.limited or settings.runs > 1 or settings.bidirectional:
        raise PlanError(
            "turning_deg_s measures every target in a whole turn at each speed: leave out pairs, "
            "min_elevation_deg, min_distance_m, runs and bidirectional; speeds of both signs "
            "measure both directions"
        )
    angles, targets = table_angles(settings), tuple(targets) or targets_of(settings)
    return Plan(METHOD, angles, targets, turning_steps(settings, angles, targets))


def turning_steps(
    settings: TurningBlockSettings, angles: tuple[float, ...], targets: tuple[Point, ...]
) -> tuple[Step, ...]:
    """Return the steps of a table that passes ``angles`` (rad) at each speed for each target.

    A step's station is its run: the number of its speed. Every turn begins with a step at rest, at
    which the reflector has come to its target. Raises PlanError for speeds of zero, and for more
    than MOST_PASSED angles.
    """
    speeds = settings.turning_deg_s
    if not all(speeds):
        raise PlanError(f"turning_deg_s: {list(speeds)} deg/s: a table that turns has a speed")
    if (places := len(angles) * len(speeds)) > MOST_PASSED:
        raise PlanError(
            f"turning_deg_s: {len(angles)} angles at {len(speeds)} speeds are {places} places, "
            f"expected {MOST_PASSED} at most; measure fewer angles"
        )
    if settings.run_up_deg <= settings.passing_deg:
        raise PlanError(
            f"run_up_deg: {settings.run_up_deg:g} leaves the table no way to get up to its speed "
            f"before passing_deg, {settings.passing_deg:g}"
        )
    steps = list[Step]()
    ends = angles[0] - settings.run_up_deg * DEGREE, angles[-1] + settings.run_up_deg * DEGREE
    for target, (run, speed) in product(range(len(targets)), enumerate(speeds)):
        sense = 1 if speed > 0.0 else -1
        begin, end = ends[::sense]
        side = Approach.POSITIVE if speed > 0.0 else Approach.NEGATIVE
        rows = [(position, target, run) for position in range(len(angles))][::sense]
        sides, kind = [side] * len(angles), PointKind.REFLECTOR
        passed = numbered_steps(rows, angles, targets, kind, approaches=sides)
        rest = replace(passed[0], table_angle=begin, approach=Approach.UNKNOWN)
        turn, passing = Turn(begin, end, speed * DEGREE), settings.passing_deg * DEGREE
        each = (rest, *(replace(step, turn=turn, passing=passing) for step in passed))
        steps += [replace(step, index=k) for k, step in enumerate(each, len(steps))]
    return tuple(steps)


def _with_free_beams(plan: Plan, settings: TracerPlanSettings) -> Plan:
    """Return the plan without the pairs whose beam is too low or too short."""
    if len(settings.tracer_m) != 3:
        raise PlanError(
            "min_elevation_deg and min_distance_m need to know where the tracer stands on the "
            "table: give tracer_m: [x, y, z]"
        )
    angles = np.array(plan.table_angles)
    lowest = -90.0 if settings.min_elevation_deg is None else settings.min_elevation_deg
    position = np.array([step.table_position for step in plan.steps])
    targets = np.array([step.position for step in plan.steps])
    beams = targets - positions_on_table(settings.tracer_m, angles)[position]
    free = within_reach(beams, (settings.min_distance_m, np.inf), (lowest, 90.0))
    require_beams(position[free], angles, "min_elevation_deg, min_distance_m")
    return _renumbered(plan, compress(plan.steps, free))


def within_reach(
    beams: Floats, distances_m: tuple[float, float], elevations_deg: tuple[float, float]
) -> Bools:
    """Return which of the ``beams`` (k, 3), m, from tracer to target, keep both limits."""
    distance = np.linalg.norm(beams, axis=1)
    elevation = np.arcsin(np.clip(beams[:, 2] / np.maximum(distance, 1e-9), -1.0, 1.0)) / DEGREE
    (nearest, farthest), (lowest, highest) = distances_m, elevations_deg
    free = (distance >= nearest) & (distance <= farthest)
    return np.asarray(free & (elevation >= lowest) & (elevation <= highest), dtype=np.bool_)


def require_beams(position: Ints, table_angles: Floats, settings: str) -> None:
    """Raise PlanError for a station without enough free beams, with the ``settings`` to see.

    ``position`` (k,): the table position of each beam.
    """
    few = np.flatnonzero(np.bincount(position, minlength=len(table_angles)) < LEAST_BEAMS)
    if len(few):
        raise PlanError(
            f"station {few[0]} at {table_angles[few[0]] / DEGREE:g} deg has fewer than "
            f"{LEAST_BEAMS} targets with a free beam: see {settings}"
        )


def _renumbered(plan: Plan, steps: Iterable[Step]) -> Plan:
    in_order = tuple(replace(step, index=number) for number, step in enumerate(steps))
    return replace(plan, steps=in_order)


def explicit_plan(settings: TracerPlanSettings, targets: Sequence[Point] = ()) -> Plan:
    """Return the plan of the listed pairs; PlanError, with the step, for those that cannot be.

    A pair that is listed several times is measured as often. ``targets``: in place of the plan's.
    """
    if settings.repeated:
        raise PlanError(
            "runs and bidirectional repeat all lengths: they do not go with explicit pairs; leave "
            "out one of the two"
        )
    if settings.limited:
        raise PlanError(
            "min_elevation_deg and min_distance_m leave out pairs: they do not go with explicit "
            "ones; remove one of the two"
        )
    angles, targets = table_angles(settings), tuple(targets) or targets_of(settings)
    pairs = settings.listed
    for number, (position, target) in enumerate(pairs):
        where = f"step {number} of the pairs, table position {position}, target {target}"
        if position >= len(angles):
            raise PlanError(
                f"{where}: there are table positions 0 to {len(angles) - 1}; correct it"
            )
        if target >= len(targets):
            raise PlanError(f"{where}: there are targets 0 to {len(targets) - 1}; correct it")
    return _plan(angles, targets, pairs, [Approach.POSITIVE] * len(angles))


def plan_of(
    table_angles: tuple[float, ...], targets: tuple[Point, ...], approaches: Sequence[Approach]
) -> Plan:
    """Return the plan that measures every target at each table angle, which is an arrival."""
    pairs = product(range(len(table_angles)), range(len(targets)))
    return _plan(table_angles, targets, pairs, approaches)


def _plan(
    table_angles: tuple[float, ...],
    targets: tuple[Point, ...],
    pairs: Iterable[tuple[int, int]],
    approaches: Sequence[Approach],
) -> Plan:
    """Return the plan with one step for each pair (arrival, target), in their order."""
    rows = ((arrival, target, 0) for arrival, target in pairs)
    kind = PointKind.REFLECTOR
    steps = numbered_steps(rows, table_angles, targets, kind, approaches=approaches)
    return Plan(METHOD, table_angles, targets, steps)


def targets_of(settings: BlockSettings) -> tuple[Point, ...]:
    """Return the explicit targets (m), or those of the block."""
    return parse_points(settings.targets_m, "targets_m") if settings.targets_m else settings.block
