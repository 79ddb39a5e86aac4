"""The polygon method, as nodes, replay and report see it: the one object that is registered."""

from __future__ import annotations

from typing import Final

from rotcal_polygon import calibration, table
from rotcal_polygon.figures import figures
from rotcal_polygon.plan import NAME, plan
from rotcal_polygon.settings import PolygonPlanSettings, PolygonSolverSettings
from rotcal_polygon.simulation import PolygonSimulationSettings, SimulatedAutocollimator
from rotcal_ros.capture import CaptureRules
from rotcal_ros.capture.points import mean_point, points
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.method import Method, See, TableReader
from rotcal_ros.planning.plan import Plan


def nominal(_configuration: Configuration, _plan: Plan) -> See:
    """Return that a perfect table with a perfect polygon always reads zero."""
    return lambda step: step.position


METHOD: Final = Method(
    name=NAME,
    title="Optical polygon and autocollimator",
    page="polygon",
    topics=("probe_point", "joint_states"),
    plan_settings=PolygonPlanSettings,
    solver_settings=PolygonSolverSettings,
    simulation_settings=PolygonSimulationSettings,
    simulated_instrument=SimulatedAutocollimator,
    plan=plan,
    capture=CaptureRules({PointKind.READING: points(mean_point)}),
    solve=calibration.solve,
    trials=calibration.trials,
    check=calibration.check,
    nominal=nominal,
    table=TableReader(table.HEADERS, table.read),
    figures=figures,
)
