"""From observations to the ball plate problem, its result and its trials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.observations import Observation, PointKind
from rotcal_ros.foundation.protection import Protection
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import NANOSECOND
from rotcal_ros.methods.arrivals import Arrivals, RepeatedTrials, arrivals_of, mean_of_runs
from rotcal_ros.methods.ball_plate import solver as ball_plate
from rotcal_ros.methods.ball_plate.settings import (
    CLOSED_FORM,
    DRIFTS,
    BallPlatePlanSettings,
    BallPlateSolverSettings,
)
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.method import Trials
from rotcal_ros.planning.plan import Plan
from rotcal_ros.planning.readings import Readings


def solve(configuration: Configuration, plan: Plan, observations: Sequence[Observation]) -> Result:
    """Solve the accepted observations of a ball plate plan; angles are those of the table.

    Those of both directions become one curve over the distinct angles:
    :mod:`rotcal_ros.methods.arrivals`.
    """
    solution = ball_plate.adjust(_chosen(configuration, plan, observations))
    result, arrivals = ball_plate.result_of(solution), _arrivals(configuration, plan)
    number = {o.step: k for k, o in enumerate(observations)}  # the rows of the plate are steps
    result = replace(
        result,
        raw_data=result.raw_data.renumbered(number),
        protections=_told_by_touches(result.protections, observations),
    )
    if configuration.plan.bidirectional:
        return mean_of_runs(result, arrivals.take(solution.table_positions), from_first=False)
    return replace(result, angles=arrivals.targets[solution.table_positions])


def _told_by_touches(
    protections: Sequence[Protection], observations: Sequence[Observation]
) -> tuple[Protection, ...]:
    """Return the protections; balls whose touches were captured tell which way z points."""
    if any(o.kind != PointKind.SURFACE or not o.captured for o in observations):
        return tuple(protections)
    touched = Protection(
        "sign of z",
        "harmless",
        "touch points that lie below the centre of a ball are refused by the capture",
    )
    return tuple(touched if p.effect == touched.effect else p for p in protections)


def trials(
    configuration: Configuration, plan: Plan, observations: Sequence[Observation]
) -> Trials:
    """Prepare Monte Carlo trials about the accepted observations of a ball plate plan.

    Raises ConfigurationError when neither the set-up nor the residuals tell the noise.
    """
    chosen = _chosen(configuration, plan, observations)
    prepared = ball_plate.plate_trials(chosen)
    if not np.max(prepared.std) > 1e-12:
        raise ConfigurationError(
            f"{configuration.source}: exact centres tell no noise; state solver.sigma_centre_m"
        )
    if not configuration.plan.bidirectional:
        return prepared
    solution = ball_plate.adjust(chosen)
    return RepeatedTrials.of(
        prepared,
        ball_plate.result_of(solution),
        _arrivals(configuration, plan).take(solution.table_positions),
        from_first=False,
    )


def _arrivals(configuration: Configuration, plan: Plan) -> Arrivals:
    """Return the arrivals of all table positions that the settings of the solver choose."""
    angles = plan.distinct_angles[:: configuration.solver.coarser]
    return arrivals_of(angles, runs=1, bidirectional=configuration.plan.bidirectional)


def _chosen(
    configuration: Configuration, plan: Plan, observations: Sequence[Observation]
) -> BallPlateProblem:
    """Return the part of the data that the settings of the solver choose."""
    settings: BallPlateSolverSettings = configuration.solver
    return ball_plate.select(
        problem(configuration, plan, observations),
        balls=list(settings.balls) or None,
        cmm_positions=list(settings.cmm_positions) or None,
        coarser=settings.coarser,
    )


def problem(
    configuration: Configuration, plan: Plan, observations: Sequence[Observation]
) -> BallPlateProblem:
    """Return the problem that observations of a plan pose.

    The row numbers are the steps of the plan, so that messages and the search for a moved plate
    follow the order of measurement; the time of each counts where a drift is estimated. All
    centres weigh the same unless ``own_std`` says otherwise: the scatter of a few touches says
    less about a centre than the residuals of all.
    """
    if not observations:
        raise DataError("no ball was measured: there is nothing to solve")
    settings: BallPlatePlanSettings = configuration.plan
    plate, solver, read = settings.plate, configuration.solver, Readings.of(observations)
    return BallPlateProblem(
        grid=plate.grid,
        radius=plate.circle_radius_m,
        position=read.position,
        ball_step=read.target,
        centres=np.array([o.mean for o in observations]) - np.array(settings.centre_m),
        sigma=None if solver.own_std else solver.sigma_centre_m or None,
        std=_std(solver, observations),
        row=np.array([o.step for o in observations], dtype=np.int64),
        separate_groups=plate.separate_groups,
        time=_times(observations) if DRIFTS.index(solver.drift) else None,
        drift=DRIFTS.index(solver.drift),
        drift_allowance=solver.drift_allowance_m,
        bidirectional=settings.bidirectional,
        group_allowance=solver.group_allowance_m,
        closed_form=solver.variant == CLOSED_FORM,
        material=plate.material,
    )


def _times(observations: Sequence[Observation]) -> Floats | None:
    """Return when each was measured, s (n,); None for tables, whose rows have no time."""
    ends = np.array([o.window_end_ns for o in observations], dtype=np.int64)
    if len(np.unique(ends)) < len(ends):
        return None
    return np.asarray((ends - ends.min()) * NANOSECOND, dtype=np.float64)


def _std(settings: BallPlateSolverSettings, observations: Sequence[Observation]) -> Floats | None:
    """Return the standard deviations (n, 3) that the centres or the settings state, if any."""
    if not settings.own_std:
        axes = settings.sigma_axes_m
        return np.tile(axes, (len(observations), 1)) if axes else None
    std = np.array([o.std for o in observations])
    bad = np.flatnonzero(~np.all(np.isfinite(std) & (std > 0.0), axis=1))
    if len(bad):
        o = observations[bad[0]]
        raise DataError(
            f"step {o.step} (ball step {o.target}, table position {o.table_position}): "
            f"its standard deviations are {o.std} m, solver.own_std needs three positive lengths"
        )
    return std
