"""The plane-mirror method in the catalogue: settings, plan, problem, nests while measuring."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from rotcal_ros.catalogue.calibration import Method, Trials
from rotcal_ros.configuration import Configuration
from rotcal_ros.errors import ConfigurationError, DataError, PlanError
from rotcal_ros.methods import plane_mirror
from rotcal_ros.methods.plane_mirror import PlaneMirrorProblem, TrackerNoise
from rotcal_ros.methods.plane_mirror.problem import WAYS, Way
from rotcal_ros.observations import Observation, PointKind
from rotcal_ros.planning.mirror_plan import MIRROR, MirrorPlanSettings, mirror_plan
from rotcal_ros.planning.plan import Plan
from rotcal_ros.planning.table_angles import table_angles
from rotcal_ros.results import Result
from rotcal_ros.settings import setting
from rotcal_ros.units import ARCSEC, DEGREE

NAME: Final = plane_mirror.METHOD
DIRECT: Final = "direct"
STITCHING: Final = "stitching"


@dataclass(frozen=True)
class MirrorSolverSettings:
    """How the plane-mirror method is solved, and how well the tracker measures."""

    way: str = setting(
        "joint",
        doc="reflectors on the table (direct), or how the stations with a mirror are joined",
        choices=WAYS,
    )
    range_std_m: float = setting(
        2.5e-6, doc="m, noise along the beam at distance 0", minimum=0.0, maximum=1e-2
    )
    range_std_relative: float = setting(
        0.25e-6, doc="m/m, growth of the noise along the beam", minimum=0.0, maximum=1e-2
    )
    transverse_std_m: float = setting(
        3.75e-6, doc="m, noise across the beam at distance 0", minimum=0.0, maximum=1e-2
    )
    transverse_std_relative: float = setting(
        1.5e-6, doc="m/m, growth of the noise across the beam", minimum=0.0, maximum=1e-2
    )
    mirror_slope_std_arcsec: float = setting(
        0.0,
        doc="arcsec, flatness of the mirror as slope from spot to spot",
        minimum=0.0,
        maximum=3600.0,
    )
    tilt_std_arcsec: float = setting(
        1.0, doc="arcsec, how far the table may tilt (EAC, EBC)", minimum=1e-6, maximum=3600.0
    )
    significance: float = setting(
        1e-3, doc="probability of a false alarm of each test", minimum=1e-9, maximum=0.5
    )


def plan(configuration: Configuration) -> Plan:
    """Return the plan of a plane-mirror configuration.

    Raises ConfigurationError when the way does not fit what the table carries, PlanError when
    the way lacks nests or shared positions.
    """
    planned = configuration.group("plan", MirrorPlanSettings)
    way = configuration.group("solver", MirrorSolverSettings).way
    if (way == DIRECT) == (planned.carries == MIRROR):
        raise ConfigurationError(
            f"{configuration.source}: solver.way = {way} does not fit plan.carries = "
            f"{planned.carries}: the direct way needs reflectors on the table, all others a mirror"
        )
    result = mirror_plan(planned, NAME)
    if way == STITCHING and len(result.pauses) > 1 and not planned.shared_positions:
        raise PlanError(
            f"{configuration.source}: stitching carries the zero on through shared positions; "
            "station 1 shares none with station 0: set plan.shared_positions to at least 1"
        )
    if way != STITCHING and len(result.pauses) > 1 and not result.targets:
        raise PlanError(
            f"{configuration.source}: the way {way} joins {len(result.pauses)} tracker stations "
            "through nests: name at least three in plan.nests_m"
        )
    return result


def solve(configuration: Configuration, plan: Plan, observations: Sequence[Observation]) -> Result:
    """Solve the accepted observations of a plane-mirror plan.

    A reflector whose direct or mirrored point is missing (given up, or not measured yet) is left
    out; details["left_out"] names it.
    """
    problem, left_out = _problem(configuration, plan, observations)
    return _solve_ways(problem, {"left_out": left_out})


def trials(
    configuration: Configuration, plan: Plan, observations: Sequence[Observation]
) -> Trials:
    """Prepare Monte Carlo trials about the accepted observations of a plane-mirror plan."""
    return plane_mirror.mirror_trials(_problem(configuration, plan, observations)[0])


def _problem(
    configuration: Configuration, plan: Plan, observations: Sequence[Observation]
) -> tuple[PlaneMirrorProblem, list[str]]:
    """Return the problem that observations pose, and what was left out of it."""
    paired, left_out = _paired(observations)
    if not paired:
        raise DataError("no reflector was measured both directly and through the mirror yet")
    problem = plane_mirror.problem_from_observations(paired, np.array(plan.table_angles))
    return configured(problem, configuration), left_out


def solve_table(configuration: Configuration, text: str, name: str) -> Result:
    """Solve the CSV ``text`` of the file ``name``: any stations and nests, any order of rows."""
    angles = np.array(table_angles(configuration.group("plan", MirrorPlanSettings)))
    problem = plane_mirror.read_points(text, name, angles)
    return _solve_ways(configured(problem, configuration), {})


def check(
    configuration: Configuration, plan: Plan, observations: Sequence[Observation]
) -> tuple[str, ...]:
    """Return in words which nests do not stand where the stations before saw them.

    Raises DataError or GeometryError when the newest station cannot be registered at all.
    """
    nests = [o for o in observations if o.kind == PointKind.NEST]
    if not nests:
        return ()
    problem = plane_mirror.problem_from_observations(nests, np.array(plan.table_angles))
    return tuple(plane_mirror.check_nests(configured(problem, configuration)))


def configured(problem: PlaneMirrorProblem, configuration: Configuration) -> PlaneMirrorProblem:
    """Return a problem with noise, way and limits of the configuration."""
    settings = configuration.group("solver", MirrorSolverSettings)
    limit = configuration.group("plan", MirrorPlanSettings).incidence_limit_deg
    return replace(
        problem,
        noise=TrackerNoise(
            range_std=settings.range_std_m,
            range_std_per_metre=settings.range_std_relative,
            transverse_std=settings.transverse_std_m,
            transverse_std_per_metre=settings.transverse_std_relative,
            mirror_slope_std=settings.mirror_slope_std_arcsec * ARCSEC,
        ),
        way=_way(settings.way),
        tilt_std=settings.tilt_std_arcsec * ARCSEC,
        incidence_limit=limit * DEGREE,
        significance=settings.significance,
    )


def _way(name: str) -> Way:
    return next(way for way in WAYS if way == name)


def _solve_ways(problem: PlaneMirrorProblem, details: dict[str, Any]) -> Result:
    """Solve the chosen way; the other ways of the same points go into the details."""
    result = plane_mirror.solve(problem)
    others = [way for way in WAYS if DIRECT not in (way, problem.way) and way != problem.way]
    if others:
        details = {**details, "ways": [_other_way(problem, way) for way in others]}
    return replace(result, details={**result.details, **details})


def _other_way(problem: PlaneMirrorProblem, way: Way) -> dict[str, Any]:
    """Return the curve of another way, or why there is none."""
    try:
        result = plane_mirror.solve(replace(problem, way=way))
    except DataError as error:
        return {"way": way, "why_not": str(error)}
    return {
        "way": way,
        "angles_rad": result.angles,
        "ecc_rad": result.deviations["ECC"],
        "ecc_std_rad": result.std["ECC"],
        "sigma0": result.sigma0,
        "verdict": result.verdict,
    }


def _paired(
    observations: Sequence[Observation],
) -> tuple[list[Observation], list[str]]:
    """Return the observations without reflectors that lack one of their points, and the latter.

    Without any mirrored point there is no mirror, and every direct point stands for itself.
    """
    kinds: dict[tuple[int, int, int], set[PointKind]] = {}
    for o in observations:
        if o.kind != PointKind.NEST:
            kinds.setdefault((o.table_index, o.station, o.target), set()).add(o.kind)
    if not any(PointKind.MIRRORED in found for found in kinds.values()):
        return list(observations), []
    single = {key: found for key, found in kinds.items() if len(found) == 1}
    used = [
        o
        for o in observations
        if o.kind == PointKind.NEST or (o.table_index, o.station, o.target) not in single
    ]
    names = [
        f"position {position}, tracker station {station}, reflector {number}: only "
        f"{next(iter(found)).name.lower()} was measured"
        for (position, station, number), found in single.items()
    ]
    return used, names


PLANE_MIRROR = Method(
    name=NAME,
    title="Laser tracker and plane mirror",
    topics=("probe_point", "joint_states"),
    settings={"plan": MirrorPlanSettings, "solver": MirrorSolverSettings},
    plan=plan,
    solve=solve,
    trials=trials,
    check=check,
    solve_table=solve_table,
)
