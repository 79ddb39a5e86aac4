"""The laser-tracer method, as nodes, replay and report see it: problem, result and trials."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from rotcal_ros.capture.attempt import CaptureRules
from rotcal_ros.capture.decisions import decide_length
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.errors import (
    DataError,
    GeometryError,
    ObservabilityError,
)
from rotcal_ros.foundation.observations import Observation, PointKind
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.geometry.rotations import positions_on_table
from rotcal_ros.methods.arrivals import (
    Arrivals,
    RepeatedTrials,
    arrivals_of,
    arrivals_of_turns,
    mean_of_arrivals,
    mean_of_runs,
    scatter_of,
)
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.method import Adaptive, Method, See, Stations, TableReader, Trials
from rotcal_ros.methods.tracer import table, turning_readings
from rotcal_ros.methods.tracer.lengths import (
    LengthCheck,
    length_columns,
    read_from,
    segments_of,
    times_measured_before,
)
from rotcal_ros.methods.tracer.plan import check_plan, tracer_plan
from rotcal_ros.methods.tracer.settings import (
    TARGETS_PER_STATION,
    TracerPlanSettings,
    TracerSimulationSettings,
    TracerSolverSettings,
)
from rotcal_ros.methods.tracer.solver.problem import TracerProblem
from rotcal_ros.methods.tracer.solver.solution import adjust, curve_model
from rotcal_ros.methods.tracer.solver.solve import METHOD as NAME
from rotcal_ros.methods.tracer.solver.solve import result_of
from rotcal_ros.methods.tracer.table import PLAN_FILES
from rotcal_ros.methods.turning import require_turns
from rotcal_ros.planning.plan import Plan, PlanComparison
from rotcal_ros.planning.table_angles import table_angles

if TYPE_CHECKING:
    from rotcal_ros.adjust.model import CurveModel


def solve(configuration: Configuration, plan: Plan, observations: Sequence[Observation]) -> Result:
    """Solve the accepted observations of a laser-tracer plan.

    Those of several runs of an interrupted plan are joined by what was measured twice. Repeated
    runs of the plan become one curve over the distinct angles:
    :mod:`rotcal_ros.methods.arrivals`.
    """
    solution = adjust(problem(configuration, plan, observations))
    result, arrivals = result_of(solution), _arrivals(configuration)
    return result if arrivals is None else mean_of_runs(result, arrivals.take(solution.positions))


def trials(
    configuration: Configuration, plan: Plan, observations: Sequence[Observation]
) -> Trials:
    """Prepare Monte Carlo trials about what :func:`solve` solves."""
    solution = adjust(problem(configuration, plan, observations))
    arrivals = _arrivals(configuration)
    if arrivals is None:
        return solution.trials
    arrivals = arrivals.take(solution.positions)
    return RepeatedTrials.of(solution.trials, result_of(solution), arrivals)


def model_of_curves(
    configuration: Configuration, plan: Plan, observations: Sequence[Observation]
) -> CurveModel:
    """Return what the accepted lengths determine of ECC, to be solved with other instruments.

    Of the mean where the table comes to its angles more than once.
    """
    posed, arrivals = problem(configuration, plan, observations), _arrivals(configuration)
    try:
        solution = adjust(posed)
    except (ObservabilityError, GeometryError):
        if arrivals is not None:
            raise
        return curve_model(posed)
    found = curve_model(posed, solution)
    if arrivals is None:
        return found
    arrivals = arrivals.take(solution.positions)
    return mean_of_arrivals(found, arrivals, scatter_of(result_of(solution), arrivals))


def _in_segments(configuration: Configuration) -> bool:
    turning = configuration.plan.turning_deg_s
    return bool(turning) or bool(configuration.solver.zero == "per_segment")


def _arrivals(configuration: Configuration) -> Arrivals | None:
    """Return the arrivals of all stations of a plan with repeated runs."""
    settings: TracerPlanSettings = configuration.plan
    if settings.turning_deg_s:
        return arrivals_of_turns(table_angles(settings), settings.turning_deg_s)
    if not settings.repeated:
        return None
    return arrivals_of(table_angles(settings), settings.runs, bidirectional=settings.bidirectional)


def problem(
    configuration: Configuration, plan: Plan, observations: Sequence[Observation]
) -> TracerProblem:
    """Return the problem that observations pose; DataError when one does not fit the plan."""
    settings: TracerSolverSettings = configuration.solver
    for o in observations:
        if not (o.table_position < len(plan.table_angles) and o.target < len(plan.targets)):
            raise DataError(
                f"step {o.step}: position {o.table_position}, target {o.target} are not in the "
                f"plan of {len(plan.table_angles)} angles and {len(plan.targets)} targets"
            )
    columns, mount = length_columns(settings, plan, observations), configuration.plan.tracer_m
    speeds = np.array(configuration.plan.turning_deg_s) * DEGREE
    segments, again = _in_segments(configuration), times_measured_before(plan, observations)
    run = np.array([o.run for o in observations], dtype=np.int64)
    angles, turn = np.tile(plan.table_angles, max(len(speeds), 1)), None
    if len(speeds):
        turn = np.array([o.station for o in observations], dtype=np.int64)
        columns |= {
            "position": columns["position"] + len(plan.table_angles) * turn,
            "table_angles": angles,
            "speed": speeds[turn],
            "lag": settings.lag_s,
            "lag_std": settings.lag_std_s,
        }
    return TracerProblem(
        **columns,
        segment=segments_of(observations, turn) if segments else None,
        again=again if again.any() else None,
        run=None if segments or len(np.unique(run)) < 2 else run,
        position_std=settings.position_std_m,
        zero_walk_std=settings.zero_walk_std_m if segments else 0.0,
        slip=settings.slip_m,
        # few lengths to low targets leave a mirror image of a station, which this rules out
        start_stations=positions_on_table(mount, angles.tolist()) if mount else None,
        variant=settings.variant,
        datum=settings.datum,
        error_motion_std=settings.error_motion_std_m,
        circle_std=settings.circle_std_m,
        repeated_runs=configuration.plan.repeated,
    )


def nominal(configuration: Configuration, _plan: Plan) -> See:
    """Return what a tracer reads that stands where the simulation mounts it."""
    tracer = configuration.simulation.tracer
    return read_from([tracer.mount_m], tracer.dead_distance_m)


def stations(configuration: Configuration) -> Stations:
    """Return where the tracer rides: as the plan says, else where the simulation mounts it."""
    place = configuration.plan.tracer_m
    if not place and configuration.simulated:
        place = configuration.simulation.tracer.mount_m
    return Stations((tuple(place),) if place else (), carried=True)


def compare(
    configuration: Configuration, plan: Plan, steps: Sequence[int], lost: Collection[int]
) -> PlanComparison:
    """Return what is known of ``steps`` and of the paper's plan; loaded when it is asked for."""
    from rotcal_ros.methods.tracer import goal_policy

    return goal_policy.compare(configuration, plan, steps, lost)


def until_goal(configuration: Configuration, plan: Plan) -> Adaptive:
    """Return what makes the policy of that name; loaded when it is asked for."""
    from rotcal_ros.methods.tracer import goal_policy

    return goal_policy.until_goal(configuration, plan)


def _check_plan(configuration: Configuration, plan: Plan) -> None:
    """Raise PlanError for a plan that could never be solved, or never be carried out."""
    turning = bool(configuration.plan.turning_deg_s)
    check_plan(configuration.solver, plan, turning=turning)
    if turning:
        require_turns(configuration, plan)


_TRACER: Final = plugins.lazy_load("rotcal_ros.methods.tracer.simulation:TracerAndReflector")
METHOD: Final = Method(
    name=NAME,
    title="Laser tracer, multi-station",
    page="tracer",
    by_light=True,
    plan_settings=TracerPlanSettings,
    solver_settings=TracerSolverSettings,
    simulation_settings=TracerSimulationSettings,
    simulated_instrument=lambda cell, table, temperature, start_ns: _TRACER(
        cell, cell.tracer.mount_m, table, temperature, start_ns
    ),
    plan=lambda configuration: tracer_plan(configuration.plan),
    check_plan=_check_plan,
    adaptive=until_goal,
    compare=compare,
    plan_files=PLAN_FILES,
    capture=CaptureRules({PointKind.REFLECTOR: decide_length}, lambda plan: (LengthCheck(plan),)),
    solve=solve,
    model_of_curves=model_of_curves,
    joins_runs=True,
    trials=trials,
    nominal=nominal,
    stations=stations,
    table=TableReader(
        (*table.HEADERS, *table.STATIONS),
        table.read,
        table.COLUMNS,
        table.TARGETS,
        runs="runs",
        again={"order": TARGETS_PER_STATION},
        with_angles=table.TURNS.headers,
    ),
    of_turns=partial(turning_readings.of_streams, table.TURNS),
    figures=plugins.lazy_load("rotcal_ros.methods.tracer.figures:figures"),
    tables=plugins.lazy_load("rotcal_ros.methods.tracer.figures:tables"),
    disturbances=plugins.lazy_load("rotcal_ros.methods.tracer.simulation:DISTURBANCES"),
)
