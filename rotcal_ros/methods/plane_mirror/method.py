"""The plane-mirror method, as nodes, replay and report see it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from rotcal_ros.capture.attempt import CaptureRules
from rotcal_ros.capture.decisions import mean_point, points
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.gum_numbers import value_with_uncertainty
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.method import Method, See, Stations, TableReader, zero_at_the_first
from rotcal_ros.methods.plane_mirror import calibration, table
from rotcal_ros.methods.plane_mirror.disturbances import DISTURBANCES
from rotcal_ros.methods.plane_mirror.figures import figures, tables
from rotcal_ros.methods.plane_mirror.mirror_physics import TrackerStation
from rotcal_ros.methods.plane_mirror.plan import check_plan, nominal_mirror, plan, tracker_stands
from rotcal_ros.methods.plane_mirror.settings import (
    MirrorPlanSettings,
    MirrorSimulationSettings,
    MirrorSolverSettings,
)
from rotcal_ros.methods.plane_mirror.solver.solve import METHOD as NAME
from rotcal_ros.planning.plan import Plan, Step

if TYPE_CHECKING:
    from rotcal_ros.methods.simulation.air import SimulatedTemperature
    from rotcal_ros.methods.simulation.instrument import SimulatedInstrument, Table


def zero(result: Result) -> tuple[str, ...]:
    """Return what the curve counts from, and how a whole turn closes."""
    first, details = zero_at_the_first(result), result.details
    if "closure_rad" not in details:
        return (*first, "No whole turn was measured: nothing tells how the curve closes.")
    error = float(details["closure_rad"]) / ARCSEC
    expanded = COVERAGE_FACTOR * float(details["closure_std_rad"]) / ARCSEC
    closes = f"The whole turn closes to {value_with_uncertainty(error, expanded)} arcsec (k = 2)."
    return (*first, closes)


def nominal(configuration: Configuration, _plan: Plan) -> See:
    """Return what a tracker sees that looks along +x at every station; the mirror is flat."""
    settings: MirrorPlanSettings = configuration.plan
    stations = [TrackerStation(stand.place) for stand in tracker_stands(settings)]
    mirror = nominal_mirror(settings)

    def see(step: Step) -> tuple[float, ...]:
        station, place = stations[step.station], np.array(step.position)
        if step.kind is PointKind.MIRRORED:
            pose = mirror.pose(rotation_about_z(step.table_angle))
            place = mirror.image(pose, station, place, f"step {step.index}")
        return tuple(station.seen(place).tolist())

    return see


def stations(configuration: Configuration) -> Stations:
    """Return where the tracker stands."""
    return Stations(tuple(stand.place for stand in tracker_stands(configuration.plan)))


def simulated_instrument(
    settings: MirrorSimulationSettings,
    table: Table,
    _temperature: SimulatedTemperature,
    start_ns: int,
) -> SimulatedInstrument:
    """Return the tracker that looks at the mirror on ``table``."""
    from rotcal_ros.methods.plane_mirror.simulated_tracker import SimulatedTracker

    return SimulatedTracker(settings, table, start_ns)


METHOD: Final = Method(
    name=NAME,
    title="Laser tracker and plane mirror",
    page="plane_mirror",
    topics=("probe_point", "joint_states"),
    plan_settings=MirrorPlanSettings,
    solver_settings=MirrorSolverSettings,
    simulation_settings=MirrorSimulationSettings,
    simulated_instrument=simulated_instrument,
    plan=plan,
    check_plan=check_plan,
    capture=CaptureRules(
        {kind: points(mean_point) for kind in table.KINDS.values()},
        lambda _plan: (calibration.TrackerCheck(),),
    ),
    solve=calibration.solve,
    trials=calibration.trials,
    check=calibration.check,
    nominal=nominal,
    stations=stations,
    table=TableReader((table.HEADER, table.TIMED), table.read, table.COLUMNS),
    figures=figures,
    tables=tables,
    zero=zero,
    disturbances=DISTURBANCES,
)
