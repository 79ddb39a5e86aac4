"""The six-deviations method, as nodes, replay and report see it."""

from __future__ import annotations

from math import dist
from typing import TYPE_CHECKING, Final

import numpy as np

from rotcal_ros.capture.attempt import CaptureRules
from rotcal_ros.capture.length import decide_length
from rotcal_ros.curves import gauge
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.method import Method, See, TableReader
from rotcal_ros.methods.stations import Stations
from rotcal_ros.methods.tracer_six import calibration, table
from rotcal_ros.methods.tracer_six.disturbances import DISTURBANCES
from rotcal_ros.methods.tracer_six.figures import figures
from rotcal_ros.methods.tracer_six.plan import check_plan, places_of, plan
from rotcal_ros.methods.tracer_six.plausibility import PlaceLengths
from rotcal_ros.methods.tracer_six.settings import SixPlanSettings
from rotcal_ros.methods.tracer_six.simulation_settings import SixSimulationSettings
from rotcal_ros.methods.tracer_six.solver import METHOD as NAME
from rotcal_ros.methods.tracer_six.solver import TracerSixSolverSettings
from rotcal_ros.planning.plan import Plan, Step

if TYPE_CHECKING:
    from rotcal_ros.simulation.air import SimulatedTemperature
    from rotcal_ros.simulation.instrument import SimulatedInstrument, Table


def nominal(configuration: Configuration, _plan: Plan) -> See:
    """Return what a tracer reads that stands exactly at its places."""
    places = [np.array(place) for place in places_of(configuration.plan)]
    dead_distance: float = configuration.simulation.tracer.dead_distance_m

    def see(step: Step) -> tuple[float, ...]:
        station = rotation_about_z(step.table_angle) @ places[step.station]
        return (dist(step.position, station) - dead_distance,)

    return see


def simulated_instrument(
    settings: SixSimulationSettings, table: Table, temperature: SimulatedTemperature, start_ns: int
) -> SimulatedInstrument:
    """Return the tracer at its places and the reflector that the machine carries."""
    from rotcal_ros.methods.tracer_six.simulated_cell import CarriedTracer

    return CarriedTracer(settings, table, temperature, start_ns)


METHOD: Final = Method(
    name=NAME,
    title="Laser tracer at several places: six deviations",
    page="tracer_six",
    topics=("tracer_length", "probe_point", "joint_states"),
    plan_settings=SixPlanSettings,
    solver_settings=TracerSixSolverSettings,
    simulation_settings=SixSimulationSettings,
    simulated_instrument=simulated_instrument,
    plan=plan,
    check_plan=check_plan,
    capture=CaptureRules({PointKind.REFLECTOR: decide_length}, lambda plan: (PlaceLengths(plan),)),
    solve=calibration.solve,
    joins_runs=True,
    trials=calibration.trials,
    check=calibration.check,
    nominal=nominal,
    stations=lambda configuration: Stations(places_of(configuration.plan), carried=True),
    gauge=gauge.without_axis_and_artefact,
    table=TableReader(table.HEADERS, table.read),
    short_setup=table.short_setup,
    figures=figures,
    zero=gauge.in_words,
    disturbances=DISTURBANCES,
)
