"""The ball plate method, as nodes, replay and report see it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from rotcal_ros.capture.attempt import CaptureRules
from rotcal_ros.capture.decisions import points
from rotcal_ros.foundation.curves import gauge
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.methods.ball_plate import calibration, table
from rotcal_ros.methods.ball_plate.disturbances import DISTURBANCES
from rotcal_ros.methods.ball_plate.figures import figures, tables
from rotcal_ros.methods.ball_plate.plan import check_plan, plan
from rotcal_ros.methods.ball_plate.settings import (
    BallPlatePlanSettings,
    BallPlateSolverSettings,
    PlateSimulationSettings,
)
from rotcal_ros.methods.ball_plate.solver.result import METHOD as NAME
from rotcal_ros.methods.ball_plate.touched_ball import reported_centre, touched_centre
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.method import Method, See, TableReader
from rotcal_ros.planning.plan import Plan

if TYPE_CHECKING:
    from rotcal_ros.methods.simulation.air import SimulatedTemperature
    from rotcal_ros.methods.simulation.instrument import SimulatedInstrument, Table


def nominal(_configuration: Configuration, _plan: Plan) -> See:
    """Return the planned places of the balls."""
    return lambda step: step.position


def simulated_instrument(
    settings: PlateSimulationSettings,
    table: Table,
    _temperature: SimulatedTemperature,
    start_ns: int,
) -> SimulatedInstrument:
    """Return the machine that touches the plate on ``table``."""
    from rotcal_ros.methods.ball_plate.simulated_probe import SimulatedTouchProbe, plate_balls

    balls = plate_balls(settings.plate, settings.seed)
    diameter_m = settings.plate.ball_diameter_m
    return SimulatedTouchProbe(settings, settings.touch_probe, balls, diameter_m, table, start_ns)


METHOD: Final = Method(
    name=NAME,
    title="Ball plate, reduced three-rosette method",
    page="ball_plate",
    topics=("probe_point", "joint_states"),
    plan_settings=BallPlatePlanSettings,
    solver_settings=BallPlateSolverSettings,
    simulation_settings=PlateSimulationSettings,
    simulated_instrument=simulated_instrument,
    plan=plan,
    check_plan=check_plan,
    capture=CaptureRules(
        {PointKind.SURFACE: points(touched_centre), PointKind.CENTRE: points(reported_centre)}
    ),
    solve=calibration.solve,
    trials=calibration.trials,
    gauge=gauge.without_axis_and_artefact,
    nominal=nominal,
    table=TableReader(table.HEADERS, table.read, table.COLUMNS),
    short_setup=table.short_setup,
    figures=figures,
    tables=tables,
    zero=gauge.in_words,
    disturbances=DISTURBANCES,
)
