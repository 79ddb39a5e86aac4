"""The ball plate method, as nodes, replay and report see it.

From observations, or from a plain table, to the problem, its result and its trials. A table has
the columns ``position,ball_step,x_m,y_m,z_m``, and optionally ``sx_m,sy_m,sz_m``, the standard
deviation of each centre. A set-up may be no more than a plate (:func:`short_setup`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from rotcal_ros.capture.attempt import CaptureRules
from rotcal_ros.capture.decisions import decide_by_points
from rotcal_ros.capture.touched_ball import reported_centre, touched_centre
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.curves import gauge
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.observations import Observation, PointKind
from rotcal_ros.foundation.protection import Protection
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.tables import Header, Table, table_hashes
from rotcal_ros.foundation.units import NANOSECOND
from rotcal_ros.methods.arrivals import (
    Arrivals,
    RepeatedTrials,
    arrivals_of,
    mean_of_arrivals,
    mean_of_runs,
)
from rotcal_ros.methods.ball_plate import solver as ball_plate
from rotcal_ros.methods.ball_plate.plan import check_plan, plan
from rotcal_ros.methods.ball_plate.settings import (
    CENTRE,
    CLOSED_FORM,
    DRIFTS,
    BallPlatePlanSettings,
    BallPlateSolverSettings,
    PlateSimulationSettings,
)
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem
from rotcal_ros.methods.ball_plate.solver.result import METHOD as NAME
from rotcal_ros.methods.calibration import prepare
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.method import Method, TableReader, Trials
from rotcal_ros.planning.plan import Plan
from rotcal_ros.planning.readings import Readings

if TYPE_CHECKING:
    from rotcal_ros.adjust.model import CurveModel
    from rotcal_ros.methods.measurements import PlannedMeasurements


COLUMNS: Final = {"position": "table_position", "ball_step": "target"}
STD: Final[Header] = ("sx_m", "sy_m", "sz_m")
_CENTRES: Final[Header] = ("position", "ball_step", "x_m", "y_m", "z_m")
HEADERS: Final[tuple[Header, ...]] = (_CENTRES, _CENTRES + STD)
SIGMA: Final = "sigma_centre_m"
AXES: Final = "sigma_axes_m"


def solve(configuration: Configuration, plan: Plan, observations: Sequence[Observation]) -> Result:
    """Solve the accepted observations of a ball plate plan; angles are those of the table.

    Those of both directions become one curve over the distinct angles:
    :mod:`rotcal_ros.methods.arrivals`.
    """
    solution = ball_plate.adjust(_chosen(configuration, plan, observations))
    result, arrivals = ball_plate.result_of(solution), _arrivals(configuration, plan)
    number = {o.step: k for k, o in enumerate(observations)}  # the rows of the plate are steps
    result = replace(result, raw_data=result.raw_data.with_row_numbers(number))
    if all(o.kind == PointKind.SURFACE and o.captured for o in observations):
        why = phrase("touch points that lie below the centre of a ball are refused by the capture")
        result = result.protected(Protection("sign of z", "harmless", why))
    if configuration.plan.bidirectional:
        return mean_of_runs(result, arrivals.take(solution.table_positions), from_first=False)
    return replace(result, angles=arrivals.targets[solution.table_positions])


def model_of_curves(
    configuration: Configuration, plan: Plan, observations: Sequence[Observation]
) -> CurveModel | None:
    """Return what the accepted observations determine of the curves, to be solved with others.

    None where an allowance is stated: that has no noise of its own.
    """
    solver = configuration.solver
    if solver.drift_allowance_m or solver.group_allowance_m:
        return None
    arrivals = _arrivals(configuration, plan)
    chosen = _chosen(configuration, plan, observations)
    found, positions = ball_plate.model_of_curves(chosen, arrivals.targets[arrivals.target])
    return mean_of_arrivals(found, arrivals.take(positions))


def trials(
    configuration: Configuration, plan: Plan, observations: Sequence[Observation]
) -> Trials:
    """Prepare Monte Carlo trials about the accepted observations of a ball plate plan.

    Raises ConfigurationError when neither the set-up nor the residuals give the noise.
    """
    solution = ball_plate.adjust(_chosen(configuration, plan, observations))
    if not solution.noisy:
        raise ConfigurationError(
            f"{configuration.source}: exact centres show no noise; state solver.sigma_centre_m"
        )
    prepared = ball_plate.trials_about(solution)
    if not configuration.plan.bidirectional:
        return prepared
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


def read(
    configuration: Configuration, table: Table, _targets: Table | None
) -> PlannedMeasurements:
    """Return ball centres by table position and ball step, numbered in the order of the rows.

    A plate that moved is searched for in the order of measurement, which is that of the rows.
    Standard deviations in the table take the place of those of the set-up.
    """
    from rotcal_ros.methods.measurements import PlannedMeasurements, RowStepFinder

    stated = table.header[-3:] == STD
    if stated:
        solver = replace(configuration.solver, own_std=True)
        configuration = replace(configuration, solver=solver)
    calibration = prepare(configuration)
    find = RowStepFinder(calibration.plan, COLUMNS)
    observations = []
    for number, row in enumerate(table.rows()):
        observation = find(row).observed(row.point(), PointKind.CENTRE)
        std = tuple(row.metres(name, farthest=1e-2) for name in STD) if stated else observation.std
        if stated and not min(std) > 0.0:
            name, value = min(zip(STD, std, strict=True), key=lambda each: each[1])
            raise DataError(f"{row.place}: {name} must be positive, found {value:g} m")
        observations.append(replace(observation, step=number, std=std))
    return PlannedMeasurements(calibration, tuple(observations), table_hashes(table))


def short_setup(entries: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the settings that the entries of a plate file state.

    Its balls are measured as centres. Beside the plate, ``sigma_centre_m`` states the standard
    deviation of a centre: a number, or a list of three for x, y, z.
    """
    several = isinstance(entries.get(SIGMA), list)
    named = {AXES if name == SIGMA and several else name: v for name, v in entries.items()}
    return {"measure": CENTRE, **named}


METHOD: Final = Method(
    name=NAME,
    title="Ball plate, reduced three-rosette method",
    page="ball_plate",
    plan_settings=BallPlatePlanSettings,
    solver_settings=BallPlateSolverSettings,
    simulation_settings=PlateSimulationSettings,
    simulated_instrument=plugins.lazy_load("rotcal_ros.methods.ball_plate.simulation:touch_probe"),
    plan=plan,
    check_plan=check_plan,
    capture=CaptureRules(
        {
            PointKind.SURFACE: decide_by_points(touched_centre),
            PointKind.CENTRE: decide_by_points(reported_centre),
        }
    ),
    solve=solve,
    model_of_curves=model_of_curves,
    trials=trials,
    gauge=gauge.without_axis_and_artefact,
    nominal=lambda _configuration, _plan: lambda step: step.position,
    table=TableReader(HEADERS, read, COLUMNS),
    short_setup=short_setup,
    figures=plugins.lazy_load("rotcal_ros.methods.ball_plate.figures:figures"),
    tables=plugins.lazy_load("rotcal_ros.methods.ball_plate.figures:tables"),
    zero=gauge.describe,
    disturbances=plugins.lazy_load("rotcal_ros.methods.ball_plate.simulation:DISTURBANCES"),
)
