"""From observations to the laser-tracer problem, its result and its trials."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rotcal_ros.foundation.arrays import Ints
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.results import Result
from rotcal_ros.geometry.rotations import on_table
from rotcal_ros.methods.arrivals import Arrivals, RepeatedTrials, arrivals_of, mean_of_runs
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.method import Trials
from rotcal_ros.methods.tracer.lengths import length_columns, reported_positions, times_before
from rotcal_ros.methods.tracer.settings import TracerPlanSettings
from rotcal_ros.methods.tracer.solver.joined_runs import (
    RepeatedLengths,
    Runs,
    adjust_at_equal_places,
    adjust_joined,
)
from rotcal_ros.methods.tracer.solver.problem import TracerProblem
from rotcal_ros.methods.tracer.solver.reported import WeighedSolution, with_reported
from rotcal_ros.methods.tracer.solver.solution import TracerSolution
from rotcal_ros.methods.tracer.solver.solve import result_of
from rotcal_ros.methods.tracer.solver.trials import trials_about
from rotcal_ros.methods.tracer.solver_settings import TracerSolverSettings
from rotcal_ros.planning.plan import Plan
from rotcal_ros.planning.table_angles import table_angles


def solve(configuration: Configuration, plan: Plan, observations: Sequence[Observation]) -> Result:
    """Solve the accepted observations of a laser-tracer plan.

    Those of several runs of an interrupted plan are joined by what was measured twice:
    :mod:`rotcal_ros.methods.tracer.solver.joined_runs`. Repeated runs of the plan become one curve
    over the distinct angles: :mod:`rotcal_ros.methods.arrivals`.
    """
    result, positions = _solved(configuration, plan, observations)
    arrivals = _arrivals(configuration)
    return result if arrivals is None else mean_of_runs(result, arrivals.take(positions))


def trials(
    configuration: Configuration, plan: Plan, observations: Sequence[Observation]
) -> Trials:
    """Prepare Monte Carlo trials about what :func:`solve` solves."""
    if _interrupted(observations) and not _in_segments(configuration):
        prepared = adjust_joined(_runs(configuration, plan, observations)).trials
    else:
        prepared = trials_about(_at_equal_places(configuration, plan, observations).solution)
    arrivals = _arrivals(configuration)
    if arrivals is None:
        return prepared
    result, positions = _solved(configuration, plan, observations)
    return RepeatedTrials.of(prepared, result, arrivals.take(positions))


def _interrupted(observations: Sequence[Observation]) -> bool:
    return len({o.run for o in observations}) > 1


def _solved(
    configuration: Configuration, plan: Plan, observations: Sequence[Observation]
) -> tuple[Result, Ints]:
    """Return the deviations at every arrival that was solved, and the positions (m,) of these."""
    if _interrupted(observations) and not _in_segments(configuration):
        joined = adjust_joined(_runs(configuration, plan, observations))
        return joined.result(), joined.solution.positions
    weighed = _at_equal_places(configuration, plan, observations)
    solution = weighed.solution
    return with_reported(result_of(solution), weighed.reported), solution.positions


def _at_equal_places(
    configuration: Configuration, plan: Plan, observations: Sequence[Observation]
) -> WeighedSolution[TracerSolution]:
    """Return the solution of one run, its lengths reduced to the mean place of their target."""
    posed = problem(configuration, plan, observations)
    shift = reported_positions(observations) - posed.targets[posed.target]
    return adjust_at_equal_places(posed, shift)


def _in_segments(configuration: Configuration) -> bool:
    return bool(configuration.solver.zero == "per_segment")


def _segments(observations: Sequence[Observation]) -> Ints:
    """Return the segment (k,) of each observation; another run is another segment."""
    both = np.array([(o.run, o.segment) for o in observations], dtype=np.int64).reshape(-1, 2)
    return np.unique(both, axis=0, return_inverse=True)[1].ravel()


def _arrivals(configuration: Configuration) -> Arrivals | None:
    """Return the arrivals of all stations of a plan with repeated runs."""
    settings: TracerPlanSettings = configuration.plan
    if not settings.repeated:
        return None
    return arrivals_of(table_angles(settings), settings.runs, bidirectional=settings.bidirectional)


def _runs(configuration: Configuration, plan: Plan, observations: Sequence[Observation]) -> Runs:
    """Return the first length of every step as one problem, the others as pairs with them."""
    row_of: dict[int, int] = {}
    kept: list[Observation] = []
    repeated: dict[int, list[Observation]] = {}
    for o in sorted(observations, key=lambda o: (o.run, o.step)):
        if o.step in row_of:
            repeated.setdefault(o.run, []).append(o)
        else:
            row_of[o.step] = len(kept)
            kept.append(o)
    posed = problem(configuration, plan, kept)
    place = posed.targets[posed.target]
    run = np.array([o.run for o in kept], dtype=np.int64)
    pairs = []
    for number in np.unique(run)[1:].tolist():
        again = repeated.get(number, [])
        row = np.array([row_of[o.step] for o in again], dtype=np.int64)
        twin = problem(configuration, plan, again) if again else posed
        pairs.append(
            RepeatedLengths(
                run=number,
                row=row,
                length=twin.length[: len(again)],
                length_std=twin.length_std[: len(again)],
                shift=reported_positions(again) - place[row],
            )
        )
    position_std = configuration.solver.position_std_m
    return Runs(posed, run, reported_positions(kept) - place, pairs, position_std)


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
    before, mount = times_before(plan), configuration.plan.tracer_m
    return TracerProblem(
        **length_columns(settings, plan, observations),
        segment=_segments(observations) if _in_segments(configuration) else None,
        again=before[[o.step for o in observations]] if before.any() else None,
        zero_walk_std=settings.zero_walk_std_m if _in_segments(configuration) else 0.0,
        slip=settings.slip_m,
        # few lengths to low targets leave a mirror image of a station, which this rules out
        start_stations=on_table(mount, plan.table_angles) if mount else None,
        variant=settings.variant,
        datum=settings.datum,
        error_motion_std=settings.error_motion_std_m,
        circle_std=settings.circle_std_m,
        repeated_runs=configuration.plan.repeated,
    )
