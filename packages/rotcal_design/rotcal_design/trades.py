"""Plans of a configuration with other numbers: what each takes, and how sure the result gets.

Stations and reflectors of a plane mirror, and targets of a tracer, by their own solvers; balls,
angles and runs of balls on the table by what the engine predicts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain, product
from math import ceil
from typing import Final, TypeVar

import numpy as np

from rotcal_ros.adjust.engine import predicted
from rotcal_ros.foundation.arrays import rms_about_mean
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.errors import ConfigurationError, PlanError
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.methods.calibration import Calibration, prepare, prepare_to_measure
from rotcal_ros.methods.configuration import Configuration, changed
from rotcal_ros.methods.dry_run import SEED, DryRun
from rotcal_ros.methods.table_balls.method import model, nominal
from rotcal_ros.methods.table_balls.settings import below_the_table
from rotcal_ros.methods.tracer.plan import targets_of
from rotcal_ros.methods.tracer.settings import TARGETS_PER_STATION
from rotcal_ros.planning.readings import Readings

USUAL_MIRROR: Final = """
/**:
  ros__parameters:
    method: plane_mirror
    plan:
      table_step_deg: 22.5
      table_positions: 17
      shared_positions: 1
      nests_m: [1.53, 0.47, 0.1, 0.39, 1.73, 0.55, -1.37, 1.35, 1.0,
                -2.02, -0.62, 0.1, -0.35, -1.56, 0.55, 1.26, -1.24, 1.0]
    solver: {way: joint}
"""
"""A whole turn with closure, six nests around the table, and the solver's usual noise."""


USUAL_BALLS: Final = """
method: table_balls
balls_m: [[0.15, 0.0, 0.08], [-0.075, 0.13, 0.04], [-0.075, -0.13, 0.12]]
axis_m: [0.0, 0.0, 0.08]
"""
"""Three balls that are not in a line; the method's usual uncertainties."""
USUAL_TURNS: Final = """
method: tracer_multistation
plan:
  turning_deg_s: [12, -12]
  table_step_deg: 3.0
  table_positions: 120
  tracer_m: [0.06, 0.025, 0.2]
  targets_m: [0.5, 0.0, 0.3, 0.0, 0.5, 0.7, -0.5, 0.0, 0.3, 0.0, -0.5, 0.7,
              0.35, 0.35, 0.7, -0.35, 0.35, 0.3, -0.35, -0.35, 0.7, 0.35, -0.35, 0.3]
solver: {length_std_m: 1.0e-7, error_motion_std_m: 0.0}
planner: {step_timeout_s: 60.0}
"""
"""Eight targets half a metre around a tracer 65 mm off the axis."""
USUAL_SIX: Final = """
method: tracer_six
plan:
  turning_deg_s: [12, -12]
  table_step_deg: 10.0
  table_positions: 36
  places_m: [0.15, 0, 0.12, -0.075, 0.13, 0.12, -0.075, -0.13, 0.12]
  targets_m: [0.5, 0.0, 0.3, 0.0, 0.5, 0.7, -0.5, 0.0, 0.3, 0.0, -0.5, 0.7,
              0.35, 0.35, 0.7, -0.35, 0.35, 0.3, -0.35, -0.35, 0.7, 0.35, -0.35, 0.3]
solver: {length_std_m: 1.0e-7}
planner: {pause_s: 90.0, step_timeout_s: 60.0}
"""
"""The same targets, and three places 150 mm off the axis to which a person moves the tracer."""
FULL_TURN_DEG: Final = 360.0
AXES: Final = 4
"""Values of a line: two places, two turns."""


@dataclass(frozen=True)
class MirrorTrade:
    """A plan of ``stations`` with ``reflectors`` at each position.

    ``pairs`` (direct and mirrored) and ``nests`` are measured in ``seconds``, the moves of the
    tracker included. ``expanded``: U (k = 2) of ECC, rms over the angles about their mean, rad.
    """

    stations: int
    reflectors: int
    pairs: int
    nests: int
    seconds: float
    expanded: float


@dataclass(frozen=True)
class BallsTrade:
    """A plan with the first ``balls`` at so many ``angles`` of a turn, in so many ``runs``.

    ``centres`` are measured by ``touches`` in ``seconds``. ``place``, m, and ``lean``, rad: the
    largest U (k = 2) of XOC and YOC, AOC and BOC, those of a tilting axis included; ``turn``, rad,
    that of ECC. ``bound``, m: no plan of so many centres gets a place below it.
    """

    balls: int
    angles: int
    runs: int
    centres: int
    touches: int
    seconds: float
    place: float
    lean: float
    turn: float
    bound: float


@dataclass(frozen=True)
class TurningTrade:
    """A tracer's plan of the first ``targets``, on a table that turns or ``stands`` at its angles.

    The tracer stands at so many ``places`` of the table. All is measured in both directions, in
    ``seconds``. ``expanded``: U (k = 2) of ECC, rms over the angles about their mean, rad;
    ``shift`` (m) and ``lean`` (rad) the largest such of EXC, EYC and EZC, and of EAC and EBC, None
    where only ECC is measured. ``untested``: what the plan is not protected against.
    """

    stands: bool
    places: int
    targets: int
    angles: int
    lengths: int
    seconds: float
    expanded: float
    shift: float | None
    lean: float | None
    untested: tuple[str, ...]


Trade = TypeVar("Trade", MirrorTrade, BallsTrade, TurningTrade)


def mirror_trade(
    configuration: Configuration,
    stations: Sequence[int],
    reflectors: Sequence[int],
    *,
    move_s: float,
    pair_s: float,
    nest_s: float,
) -> tuple[MirrorTrade, ...]:
    """Return the plans with so many stations and reflectors, the quickest first.

    The covariance is the solver's, for exact points of the configuration's plan. Numbers of
    stations that see the mirror beyond the limit of incidence, or that no share of the positions
    gives, are left out. Raises PlanError when none is left.
    """
    shared = configuration.plan.shared_positions
    alone = configuration.plan.table_positions - shared
    own = {count: ceil(alone / count) for count in stations}
    variants = (
        (f"plan.positions_per_station={own[count] + shared}", f"plan.reflectors={number}")
        for count, number in product(stations, reflectors)
        if ceil(alone / own[count]) == count
    )

    plans = _possible(configuration, variants, prepare)
    return _quickest_first(
        (_with_mirror(plan.of_distances, move_s, pair_s, nest_s) for plan in plans),
        PlanError(
            f"{configuration.source}: none of {list(stations)} tracker stations can share the "
            "table positions within the limit of incidence: allow more of them"
        ),
    )


def _with_mirror(
    calibration: Calibration, move_s: float, pair_s: float, nest_s: float
) -> MirrorTrade:
    steps = calibration.plan.steps
    covariance = calibration.solve(calibration.nominal_observations()).covariance["ECC"]
    stations = len({step.station for step in steps})
    pairs = sum(step.kind == PointKind.MIRRORED for step in steps)
    nests = len(steps) - 2 * pairs
    return MirrorTrade(
        stations=stations,
        reflectors=calibration.configuration.plan.reflectors,
        pairs=pairs,
        nests=nests,
        seconds=stations * move_s + pairs * pair_s + nests * nest_s,
        expanded=COVERAGE_FACTOR * rms_about_mean(covariance),
    )


def balls_trade(
    configuration: Configuration,
    balls: Sequence[int],
    angles: Sequence[int],
    runs: Sequence[int],
    *,
    touch_s: float,
    way_s: float,
    turn_deg_s: float,
) -> tuple[BallsTrade, ...]:
    """Return what each combination takes and gives, the quickest first.

    A touch takes ``touch_s``, the way to a ball ``way_s``, the table turns by ``turn_deg_s``.
    Plans that leave the axis open, or have more balls than the configuration, are left out.
    Raises PlanError when none is left.
    """
    places = configuration.plan.balls_m
    variants = (
        (
            f"plan.balls_m={list(places[: 3 * number])}", "plan.table_angles_deg=[]",
            f"plan.table_step_deg={FULL_TURN_DEG / count}", f"plan.table_positions={count}",
            f"plan.runs={repeated}",
        )
        for number, count, repeated in product(balls, angles, runs)
        if 3 * number <= len(places)
    )  # fmt: skip
    plans = _possible(configuration, variants, prepare_to_measure)
    return _quickest_first(
        (_with_balls(plan, touch_s, way_s, turn_deg_s) for plan in plans),
        PlanError(
            f"{configuration.source}: none of these numbers of balls, angles and runs determines "
            "the axis: allow more angles"
        ),
    )


def _with_balls(plan: Calibration, touch_s: float, way_s: float, turn_deg_s: float) -> BallsTrade:
    settings, steps = plan.configuration.plan, plan.plan.steps
    see = nominal(plan.configuration, plan.plan)
    read = Readings.of([step.observed(see(step)) for step in steps])
    expanded = COVERAGE_FACTOR * predicted(model(plan.configuration, read)).std
    lines = AXES * (2 if below_the_table(settings.chain) else 1)
    of_lines = expanded[len(expanded) - lines :].reshape(-1, 2, 2)
    count = len(plan.plan.table_angles)
    turned = np.abs(np.diff([step.table_angle for step in steps])).sum() / DEGREE
    touches = sum(step.n_points for step in steps)
    return BallsTrade(
        balls=len(settings.balls_m) // 3,
        angles=count,
        runs=settings.runs,
        centres=len(steps),
        touches=touches,
        seconds=float(touches * touch_s + len(steps) * way_s + turned / turn_deg_s),
        place=float(of_lines[:, 0].max()),
        lean=float(of_lines[:, 1].max()),
        turn=float(expanded[: len(expanded) - lines][-count:].max()),
        bound=float(
            COVERAGE_FACTOR * plan.configuration.solver.sigma_centre_m / np.sqrt(len(steps))
        ),
    )


def turning_trade(
    configurations: Iterable[Configuration], targets: Sequence[int], standing: Sequence[int]
) -> tuple[TurningTrade, ...]:
    """Return plans of the first of so many targets, the quickest first.

    Each is measured while the table turns, as each of the ``configurations`` states, and at
    ``standing`` angles of a turn at rest. A length is as noisy in either way. Plans that determine
    too little, or have more targets than the configuration, are left out. Raises
    ConfigurationError for a table that does not turn, PlanError when no plan is left.
    """
    every = list(configurations)
    found = chain.from_iterable(_turning_plans(each, targets, standing) for each in every)
    sources = ", ".join(str(each.source) for each in every)
    return _quickest_first(
        map(_with_turns, found),
        PlanError(f"{sources}: none of {list(targets)} targets determine the table: state more"),
    )


def _turning_plans(
    configuration: Configuration, targets: Sequence[int], standing: Sequence[int]
) -> Iterator[Calibration]:
    """Yield the plans of the first of so many targets that can be made."""
    if not getattr(configuration.plan, "turning_deg_s", ()) or not configuration.method.by_light:
        raise ConfigurationError(
            f"{configuration.source}: a tracer on a table that turns is traded: state "
            "plan.turning_deg_s, as [12, -12]"
        )
    places = targets_of(configuration.plan)
    variants = (
        (f"plan.targets_m={[x for place in places[:number] for x in place]}", *others)
        for number in targets
        for others in ((), *map(_at_rest, standing))
        if number <= len(places)
    )
    yield from _possible(configuration, variants, prepare_to_measure)


def _at_rest(angles: int) -> tuple[str, ...]:
    """Return the changes that let a table stand at so many angles of a turn, both ways."""
    return (
        "plan.turning_deg_s=[]", "plan.table_angles_deg=[]", "plan.bidirectional=true",
        f"plan.order={TARGETS_PER_STATION}", f"plan.table_positions={angles}",
        f"plan.table_step_deg={FULL_TURN_DEG / angles}",
    )  # fmt: skip


def _with_turns(calibration: Calibration) -> TurningTrade:
    planned, alone = calibration.plan, calibration.of_distances
    result = alone.solve(alone.measured({}, SEED).observations)
    u = {c: COVERAGE_FACTOR * rms_about_mean(result.covariance[c]) for c in result.components}
    return TurningTrade(
        stands=not calibration.configuration.plan.turning_deg_s,
        places=max(len(planned.pauses), 1),
        targets=len(planned.targets),
        angles=len(result.angles),
        lengths=len(planned.counting),
        seconds=DryRun(calibration, planned.steps[0].table_angle).time_estimate()[0],
        expanded=u["ECC"],
        shift=max((u[c] for c in u if c in ("EXC", "EYC", "EZC")), default=None),
        lean=max((u[c] for c in u if c in ("EAC", "EBC")), default=None),
        untested=result.unprotected,
    )


def _possible(
    configuration: Configuration,
    variants: Iterable[tuple[str, ...]],
    prepared: Callable[[Configuration], Calibration],
) -> Iterator[Calibration]:
    """Yield the plans of a configuration with each of the changes that make one."""
    for changes in variants:
        with suppress(PlanError):
            yield prepared(changed(configuration, changes))


def _quickest_first(rows: Iterable[Trade], none_left: PlanError) -> tuple[Trade, ...]:
    """Return the plans in the order of their time; raises ``none_left`` where there are none."""
    found = tuple(sorted(rows, key=lambda row: row.seconds))
    if not found:
        raise none_left
    return found
