"""The six-deviations method, as nodes, replay and report see it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from rotcal_ros.capture.attempt import CaptureRules
from rotcal_ros.capture.decisions import decide_length
from rotcal_ros.foundation.curves import gauge
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.method import Method, See, Stations, TableReader
from rotcal_ros.methods.tracer.lengths import LengthCheck, read_from
from rotcal_ros.methods.tracer.table import TARGETS
from rotcal_ros.methods.tracer_six import calibration, table
from rotcal_ros.methods.tracer_six.disturbances import DISTURBANCES
from rotcal_ros.methods.tracer_six.figures import figures, tables
from rotcal_ros.methods.tracer_six.plan import check_plan, places_of, plan
from rotcal_ros.methods.tracer_six.settings import SixPlanSettings, SixSimulationSettings
from rotcal_ros.methods.tracer_six.solver import METHOD as NAME
from rotcal_ros.methods.tracer_six.solver import TracerSixSolverSettings
from rotcal_ros.planning.plan import Plan

if TYPE_CHECKING:
    from rotcal_ros.methods.simulation.air import SimulatedTemperature
    from rotcal_ros.methods.simulation.instrument import SimulatedInstrument, Table


def nominal(configuration: Configuration, _plan: Plan) -> See:
    """Return what a tracer reads that stands exactly at its places."""
    dead_distance: float = configuration.simulation.tracer.dead_distance_m
    return read_from(places_of(configuration.plan), dead_distance)


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
    capture=CaptureRules({PointKind.REFLECTOR: decide_length}, lambda plan: (LengthCheck(plan),)),
    solve=calibration.solve,
    joins_runs=True,
    trials=calibration.trials,
    check=calibration.check,
    nominal=nominal,
    stations=lambda configuration: Stations(places_of(configuration.plan), carried=True),
    gauge=gauge.without_axis_and_artefact,
    table=TableReader(table.HEADERS, table.read, table.COLUMNS, TARGETS, runs="arrivals"),
    figures=figures,
    tables=tables,
    zero=gauge.in_words,
    disturbances=DISTURBANCES,
)
