"""The ball plate method, as nodes, replay and report see it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from rotcal_ros.capture.points import points
from rotcal_ros.capture.rules import CaptureRules
from rotcal_ros.catalogue.ball_plate import calibration
from rotcal_ros.catalogue.ball_plate.plan import BallPlatePlanSettings, plan
from rotcal_ros.catalogue.ball_plate.simulation_settings import PlateSimulationSettings
from rotcal_ros.catalogue.ball_plate.solver_settings import BallPlateSolverSettings
from rotcal_ros.catalogue.ball_plate.table import BallPlateTable, short_setup
from rotcal_ros.catalogue.ball_plate.touched_ball import reported_centre, touched_centre
from rotcal_ros.catalogue.configuration import Configuration
from rotcal_ros.catalogue.method import Method, See
from rotcal_ros.figures import Figure
from rotcal_ros.methods.ball_plate.solve import METHOD as NAME
from rotcal_ros.observations import PointKind
from rotcal_ros.planning.plan import Plan
from rotcal_ros.results import Result


def nominal(_configuration: Configuration, _plan: Plan) -> See:
    """Return the planned places of the balls."""
    return lambda step: step.position


def figures(result: Result, truth: Mapping[str, Any] | None) -> Sequence[Figure]:
    """Return the figures of a report."""
    # Figures take a second to load, which a solution should not wait for.
    from rotcal_ros.catalogue.ball_plate.figures import figures as draw

    return draw(result, truth)


METHOD: Final = Method(
    name=NAME,
    title="Ball plate, reduced three-rosette method",
    page="ball_plate",
    topics=("probe_point", "joint_states"),
    plan_settings=BallPlatePlanSettings,
    solver_settings=BallPlateSolverSettings,
    simulation_settings=PlateSimulationSettings,
    plan=plan,
    capture=CaptureRules(
        {PointKind.SURFACE: points(touched_centre), PointKind.CENTRE: points(reported_centre)}
    ),
    solve=calibration.solve,
    trials=calibration.trials,
    gauge=calibration.gauge,
    nominal=nominal,
    table=BallPlateTable(),
    short_setup=short_setup,
    figures=figures,
)
