"""The six-deviations method, as nodes, replay and report see it.

From observations, or from a plain table, to the problem, its result and its trials. A table has
the columns ``place,position,target,length_m``, and beside it stands ``targets.csv``; a fifth
column ``segment`` numbers the unbroken beams from a place, without it each has one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from rotcal_ros.capture.attempt import CaptureRules
from rotcal_ros.capture.decisions import decide_length
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.curves import gauge
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.observations import Observation, PointKind
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.tables import Header, Table
from rotcal_ros.foundation.units import DEGREE, MILLIMETRE
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.arrivals import (
    Arrivals,
    RepeatedTrials,
    arrivals_of,
    arrivals_of_turns,
    mean_of_arrivals,
    mean_of_runs,
)
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.method import Method, See, Stations, TableReader, Trials
from rotcal_ros.methods.tracer import turning_readings
from rotcal_ros.methods.tracer.lengths import (
    LengthCheck,
    length_columns,
    read_from,
    segments_of,
    times_before,
    times_measured_before,
)
from rotcal_ros.methods.tracer.settings import TARGETS_PER_STATION
from rotcal_ros.methods.tracer.solver.station_by_station import locate_stations
from rotcal_ros.methods.tracer.table import SEGMENT, TARGETS, read_lengths, read_turns
from rotcal_ros.methods.tracer.turning_table import TurningTables
from rotcal_ros.methods.tracer_six.plan import (
    LOCATING,
    check_plan,
    describe_place,
    places_of,
    plan,
    plan_of,
    six_plan,
    tilt_known,
)
from rotcal_ros.methods.tracer_six.settings import (
    SixPlanSettings,
    SixSimulationSettings,
    Zero,
    ZeroSetting,
)
from rotcal_ros.methods.tracer_six.solver import METHOD as NAME
from rotcal_ros.methods.tracer_six.solver import TracerSixSolverSettings
from rotcal_ros.methods.tracer_six.solver.problem import SixProblem
from rotcal_ros.methods.tracer_six.solver.solve import (
    SixSolution,
    adjust,
    curve_model,
    result_of,
)
from rotcal_ros.methods.turning import require_turns
from rotcal_ros.planning.plan import Plan, Point

if TYPE_CHECKING:
    from rotcal_ros.adjust.model import CurveModel
    from rotcal_ros.methods.measurements import PlannedMeasurements

COLUMNS: Final = {"place": "station", "position": "table_position", "target": "target"}
HEADERS: Final[tuple[Header, ...]] = (
    ("place", "position", "target", "length_m"),
    ("place", "position", "target", "length_m", SEGMENT),
)


def solve(configuration: Configuration, plan: Plan, observations: Sequence[Observation]) -> Result:
    """Solve the accepted observations of a plan.

    Those of both directions, or of all speeds at which the table turned, become one curve over the
    distinct angles: :mod:`rotcal_ros.methods.arrivals`.
    """
    solution, arrivals = _solved(configuration, plan, observations)
    result = result_of(solution)
    return result if arrivals is None else mean_of_runs(result, arrivals, from_first=False)


def model_of_curves(
    configuration: Configuration, plan: Plan, observations: Sequence[Observation]
) -> CurveModel:
    """Return what the lengths determine of the curves, to be solved with other instruments."""
    solution, arrivals = _solved(configuration, plan, observations)
    found = curve_model(solution)
    return found if arrivals is None else mean_of_arrivals(found, arrivals)


def trials(
    configuration: Configuration, plan: Plan, observations: Sequence[Observation]
) -> Trials:
    """Prepare Monte Carlo trials about what :func:`solve` solves."""
    solution, arrivals = _solved(configuration, plan, observations)
    if arrivals is None:
        return solution.trials
    return RepeatedTrials.of(solution.trials, result_of(solution), arrivals, from_first=False)


def _solved(
    configuration: Configuration, plan: Plan, observations: Sequence[Observation]
) -> tuple[SixSolution, Arrivals | None]:
    """Return the solution, and the arrivals of its positions where angles come again."""
    solution = adjust(problem(configuration, plan, observations))
    arrivals = _arrivals(configuration, plan)
    return solution, None if arrivals is None else arrivals.take(solution.positions)


def _arrivals(configuration: Configuration, plan: Plan) -> Arrivals | None:
    """Return the arrivals of all positions of a plan that comes to its angles more than once."""
    if speeds := configuration.plan.turning_deg_s:
        return arrivals_of_turns(plan.distinct_angles, speeds)
    if not configuration.plan.bidirectional:
        return None
    return arrivals_of(plan.distinct_angles, runs=1, bidirectional=True)


def problem(
    configuration: Configuration, plan: Plan, observations: Sequence[Observation]
) -> SixProblem:
    """Return the problem that observations of a plan pose.

    Where all targets are measured at one arrival, they share its scatter; else, and where the
    table turns past its angles, every length has an arrival of its own. A run that was interrupted
    and taken up again may count from another zero, which its lengths share.

    Raises DataError when an observation does not fit the plan.
    """
    settings: TracerSixSolverSettings = configuration.solver
    places = np.array(places_of(configuration.plan))
    _require_planned(plan, places, observations)
    columns, speeds = dict[str, Any](), np.array(configuration.plan.turning_deg_s) * DEGREE
    zero, segment = _zeros(settings.zero, observations)
    if len(speeds):
        position = np.array([o.table_position for o in observations], dtype=np.int64)
        turn = position // len(plan.distinct_angles)
        columns = {"speed": speeds[turn], "lag": settings.lag_s, "lag_std": settings.lag_std_s}
        zero, segment = "per_segment", segments_of(observations, turn)
    arrivals = _arrivals(configuration, plan)
    shift, turned, own_std = _scatter(configuration)
    return SixProblem(
        **length_columns(settings, plan, observations, own_std),
        place=np.array([o.station for o in observations], dtype=np.int64),
        **columns,
        upward=None if arrivals is None else arrivals.upward,
        places=places,
        place_tolerance=configuration.plan.place_tolerance_m,
        datum=settings.datum,
        zero=zero,
        segment=segment,
        scatter_translation_std=shift,
        scatter_rotation_std=turned,
        arrival=_arrived(plan, observations, turns=bool(len(speeds))),
        tilt_std=settings.tilt_std_rad,
        slip=settings.slip_m,
    )


def _arrived(plan: Plan, observations: Sequence[Observation], *, turns: bool) -> Ints:
    """Return the numbers (k,) of arrivals; where the table ``turns``, of lengths read again."""
    if turns:
        return times_measured_before(plan, observations)
    before, steps = times_before(plan), len(plan.steps)
    return np.array([before[o.step] + steps * o.run for o in observations], dtype=np.int64)


def _scatter(configuration: Configuration) -> tuple[float | None, float | None, float]:
    """Return the scatter of an arrival (m, rad) for the solver, and what joins a length (m).

    Where the table arrives anew for every length, or passes, its scatter is noise of the lengths.
    """
    settings: TracerSixSolverSettings = configuration.solver
    shift, turn = settings.scatter_translation_std_m, settings.scatter_rotation_std_rad
    stops = not configuration.plan.turning_deg_s
    if stops and configuration.plan.order == TARGETS_PER_STATION:
        return shift, turn, 0.0
    arm = np.linalg.norm(places_of(configuration.plan), axis=1).max()
    return 0.0, 0.0, float(np.hypot(shift or 0.0, arm * (turn or 0.0)))


def _require_planned(plan: Plan, places: Floats, observations: Sequence[Observation]) -> None:
    if not observations:
        raise DataError("no length was measured: there is nothing to solve")
    for o in observations:
        if not (
            o.table_position < len(plan.table_angles)
            and o.target < len(plan.targets)
            and o.station < len(places)
            and o.step < len(plan.steps)
        ):
            raise DataError(
                f"step {o.step}: place {o.station}, position {o.table_position}, target "
                f"{o.target} are not in the plan of {len(places)} places, "
                f"{len(plan.table_angles)} angles and {len(plan.targets)} targets"
            )


def _zeros(zero: ZeroSetting, observations: Sequence[Observation]) -> tuple[Zero, Ints | None]:
    """Return which lengths share a zero, with the segment (k,) of each where it takes numbers.

    Whatever is chosen, a tracer that was fixed anew and a run that was resumed begin a new zero.
    """
    zero = "per_segment" if zero == "auto" else zero
    mountings = {(o.station, o.run) for o in observations}
    resumed = len(mountings) > len({o.station for o in observations})
    if zero != "per_segment" and not resumed:
        return zero, None
    within = {"per_run": lambda _: 0, "per_station": lambda o: o.table_position}
    part: Callable[[Observation], int] = within.get(zero, lambda o: o.segment)
    keys = np.array([(o.station, o.run, part(o)) for o in observations])
    _, segment = np.unique(keys, axis=0, return_inverse=True)
    return "per_segment", np.asarray(segment.ravel(), dtype=np.int64)


def check(
    configuration: Configuration, plan: Plan, observations: Sequence[Observation]
) -> tuple[str, ...]:
    """Return in words how far the newest place is from where the plan has it, if too far.

    Only the lengths at the first angle of that place are looked at, with targets and table as the
    plan has them: what matters here are millimetres. A turn counts from a zero of its own, and
    shows nothing before others follow.
    """
    if not observations or configuration.plan.turning_deg_s:
        return ()
    number = max(o.station for o in observations)
    here = [o for o in observations if o.station == number]
    first = [o for o in here if o.table_position == here[0].table_position]
    if len({o.target for o in first}) <= LOCATING - 2:
        return ()
    planned = np.array(places_of(configuration.plan))[number]
    found = _located(plan, first, planned)
    away, allowed = float(np.linalg.norm(found - planned)), configuration.plan.place_tolerance_m
    if away <= allowed:
        return ()
    return (
        f"place {number + 1}: the tracer stands {away / MILLIMETRE:.1f} mm from its place, "
        f"allowed {allowed / MILLIMETRE:g}: its centre is {describe_place(found)}, planned "
        f"{describe_place(planned)}",
    )


def _located(plan: Plan, observations: Sequence[Observation], planned: Floats) -> Floats:
    """Return where the tracer stands (3,), m, table frame; nearest to ``planned`` (3,)."""
    targets = np.array([plan.targets[o.target] for o in observations])
    length = np.array([[o.mean[0] for o in observations]])
    turn = rotation_about_z(plan.table_angles[observations[0].table_position])
    start = turn @ planned
    zero = np.mean(np.linalg.norm(targets - start, axis=1) - length)
    state, _ = locate_stations(
        targets, length, np.ones_like(length), np.array([[*start.tolist(), float(zero)]])
    )
    return np.asarray(turn.T @ state[0, :3], dtype=np.float64)


def read(configuration: Configuration, table: Table, targets: Table | None) -> PlannedMeasurements:
    """Return lengths by place, table position and target; a table shows no scatter.

    What the plan measures several times may stand in the table as often, in the order of time. A
    table of turns states angles and directions instead.
    """
    if table.header in TURNS.headers:
        return read_turns(TURNS, configuration, table, targets)
    return read_lengths(
        configuration,
        table,
        targets,
        COLUMNS,
        lambda _, listed: plan_of(configuration.plan, listed),
    )


def nominal(configuration: Configuration, _plan: Plan) -> See:
    """Return what a tracer reads that stands exactly at its places."""
    dead_distance: float = configuration.simulation.tracer.dead_distance_m
    return read_from(places_of(configuration.plan), dead_distance)


def _check_plan(configuration: Configuration, plan: Plan) -> None:
    """Raise PlanError for a plan that could never be solved, or never be carried out."""
    turning = bool(configuration.plan.turning_deg_s)
    check_plan(plan, turning=turning)
    if turning:
        require_turns(configuration, plan)


def _plan_of_turns(configuration: Configuration, targets: tuple[Point, ...]) -> Plan:
    """Return the plan of turns that a table holds; to its own targets without ``targets``."""
    planned = six_plan(configuration.plan, targets, tilt_known=tilt_known(configuration))
    check_plan(planned, turning=True)
    return planned


TURNS: Final = TurningTables(_plan_of_turns, places=True)
METHOD: Final = Method(
    name=NAME,
    title="Laser tracer at several places: six deviations",
    page="tracer_six",
    by_light=True,
    plan_settings=SixPlanSettings,
    solver_settings=TracerSixSolverSettings,
    simulation_settings=SixSimulationSettings,
    simulated_instrument=plugins.lazy_load(
        "rotcal_ros.methods.tracer_six.simulation:CarriedTracer"
    ),
    plan=plan,
    check_plan=_check_plan,
    capture=CaptureRules({PointKind.REFLECTOR: decide_length}, lambda plan: (LengthCheck(plan),)),
    solve=solve,
    model_of_curves=model_of_curves,
    joins_runs=True,
    trials=trials,
    check=check,
    nominal=nominal,
    stations=lambda configuration: Stations(places_of(configuration.plan), carried=True),
    gauge=gauge.without_axis_and_artefact,
    table=TableReader(HEADERS, read, COLUMNS, TARGETS, runs="arrivals", with_angles=TURNS.headers),
    of_turns=partial(turning_readings.of_streams, TURNS),
    figures=plugins.lazy_load("rotcal_ros.methods.tracer_six.figures:figures"),
    tables=plugins.lazy_load("rotcal_ros.methods.tracer_six.figures:tables"),
    zero=gauge.describe,
    disturbances=plugins.lazy_load("rotcal_ros.methods.tracer_six.simulation:DISTURBANCES"),
)
