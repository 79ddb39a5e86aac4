"""The laser-tracer method, as nodes, replay and report see it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Final

from rotcal_ros.capture.attempt import CaptureRules
from rotcal_ros.capture.decisions import decide_length
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.method import Adaptive, Method, See, Stations, TableReader
from rotcal_ros.methods.tracer import calibration, table
from rotcal_ros.methods.tracer.disturbances import DISTURBANCES
from rotcal_ros.methods.tracer.figures import figures, tables
from rotcal_ros.methods.tracer.lengths import LengthCheck, read_from
from rotcal_ros.methods.tracer.plan import check_plan, tracer_plan
from rotcal_ros.methods.tracer.settings import (
    TARGETS_PER_STATION,
    TracerPlanSettings,
    TracerSimulationSettings,
)
from rotcal_ros.methods.tracer.solver.solve import METHOD as NAME
from rotcal_ros.methods.tracer.solver_settings import TracerSolverSettings
from rotcal_ros.methods.tracer.table import PLAN_FILES
from rotcal_ros.planning.plan import Compared, Plan

if TYPE_CHECKING:
    from rotcal_ros.methods.simulation.air import SimulatedTemperature
    from rotcal_ros.methods.simulation.instrument import SimulatedInstrument, Table


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
) -> Compared:
    """Return what is known of ``steps`` and of the paper's plan; loaded when it is asked for."""
    from rotcal_ros.methods.tracer import paper

    return paper.compare(configuration, plan, steps, lost)


def until_goal(configuration: Configuration, plan: Plan) -> Adaptive:
    """Return what makes the policy of that name; loaded when it is asked for."""
    from rotcal_ros.methods.tracer import goal_policy as policy

    return policy.until_goal(configuration, plan)


def simulated_instrument(
    settings: TracerSimulationSettings,
    table: Table,
    temperature: SimulatedTemperature,
    start_ns: int,
) -> SimulatedInstrument:
    """Return the tracer on the table and the reflector that the machine carries."""
    from rotcal_ros.methods.tracer.simulated_cell import TracerAndReflector

    return TracerAndReflector(settings, settings.tracer.mount_m, table, temperature, start_ns)


METHOD: Final = Method(
    name=NAME,
    title="Laser tracer, multi-station",
    page="tracer",
    topics=("tracer_length", "probe_point", "joint_states"),
    plan_settings=TracerPlanSettings,
    solver_settings=TracerSolverSettings,
    simulation_settings=TracerSimulationSettings,
    simulated_instrument=simulated_instrument,
    plan=lambda configuration: tracer_plan(configuration.plan),
    check_plan=lambda configuration, plan: check_plan(configuration.solver, plan),
    adaptive=until_goal,
    compare=compare,
    plan_files=PLAN_FILES,
    capture=CaptureRules({PointKind.REFLECTOR: decide_length}, lambda plan: (LengthCheck(plan),)),
    solve=calibration.solve,
    joins_runs=True,
    trials=calibration.trials,
    nominal=nominal,
    stations=stations,
    table=TableReader(
        (*table.HEADERS, *table.STATIONS),
        table.read,
        table.COLUMNS,
        table.TARGETS,
        runs="runs",
        again={"order": TARGETS_PER_STATION},
    ),
    figures=figures,
    tables=tables,
    disturbances=DISTURBANCES,
)
