"""The laser-tracer method in the catalogue: settings, plan, problem."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rotcal_ros.catalogue.calibration import Method
from rotcal_ros.configuration import Configuration
from rotcal_ros.errors import DataError
from rotcal_ros.observations import Observation
from rotcal_ros.planning.plan import Plan
from rotcal_ros.planning.tracer_plan import TracerPlanSettings, tracer_plan
from rotcal_ros.results import Result
from rotcal_ros.settings import setting

NAME = "tracer_multistation"


@dataclass(frozen=True)
class TracerSolverSettings:
    """How the laser-tracer method is solved."""

    variant: str = setting(
        "joint",
        doc="station by station with known targets, or joint self-calibration",
        choices=("station", "joint"),
    )
    datum: str = setting(
        "prior",
        doc="joint variant: targets as weighted prior, or as mere start values (free network)",
        choices=("prior", "free"),
    )
    length_std_m: float = setting(
        0.2e-6,
        doc="m, standard deviation of one captured length, repeatability included",
        minimum=1e-9,
        maximum=1e-2,
    )
    length_std_relative: float = setting(
        0.0,
        doc="m/m, part of the length deviation that grows with the distance",
        minimum=0.0,
        maximum=1e-2,
    )
    target_std_m: float = setting(
        1e-6, doc="m, standard deviation of each coordinate of a target", minimum=1e-9, maximum=1.0
    )
    error_motion_std_m: float = setting(
        0.0,
        doc="m, standard deviation of the table's radial error motion",
        minimum=0.0,
        maximum=1e-2,
    )


def plan(configuration: Configuration) -> Plan:
    """Return the plan of a laser-tracer configuration."""
    return tracer_plan(configuration.group("plan", TracerPlanSettings), NAME)


def solve(configuration: Configuration, plan: Plan, observations: Sequence[Observation]) -> Result:
    """Solve accepted observations of a laser-tracer plan."""
    raise DataError("the laser-tracer solver is not connected yet")


TRACER_MULTISTATION = Method(
    name=NAME,
    title="Laser tracer, multi-station",
    topics=("tracer_length", "probe_point", "joint_states"),
    settings={"plan": TracerPlanSettings, "solver": TracerSolverSettings},
    plan=plan,
    solve=solve,
)
