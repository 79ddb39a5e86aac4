"""The plane-mirror method, as nodes, replay and report see it.

From observations, or from a plain table, to the problem, its result and its trials. And what is
checked while measuring: points that cannot be (:class:`TrackerCheck`), and nests that do not
stand where they were seen before (:func:`check`).

A table has the columns ``position,tracker_station,kind,nest,x_m,y_m,z_m``. A last column
``time_s`` may state when each row was measured; without it the rows stand in the order in which
they were measured.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import dist
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from rotcal_ros.capture.attempt import CaptureRules
from rotcal_ros.capture.decisions import decide_by_points, mean_point
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.compact import mapped, written
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.errors import DataError, GeometryError
from rotcal_ros.foundation.gum_numbers import value_with_uncertainty
from rotcal_ros.foundation.language import Phrase, phrase
from rotcal_ros.foundation.observations import Observation, PointKind
from rotcal_ros.foundation.raw_data import RawData, hash_of
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.tables import Header, Table, table_hashes
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MILLIMETRE
from rotcal_ros.methods.arrivals import (
    Arrivals,
    RepeatedTrials,
    bidirectional_arrivals,
    mean_curve,
    mean_of_arrivals,
    mean_of_runs,
)
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.method import Method, Stations, TableReader, Trials, zero_at_the_first
from rotcal_ros.methods.plane_mirror import solver as plane_mirror
from rotcal_ros.methods.plane_mirror.plan import (
    check_plan,
    plan,
    position_angles,
    tracker_sees,
    tracker_stands,
)
from rotcal_ros.methods.plane_mirror.settings import (
    DIRECT,
    MIRROR,
    MirrorPlanSettings,
    MirrorSimulationSettings,
    MirrorSolverSettings,
)
from rotcal_ros.methods.plane_mirror.solver.problem import PlaneMirrorProblem, noise_of
from rotcal_ros.methods.plane_mirror.solver.set_up import MIN_APART, not_an_image
from rotcal_ros.methods.plane_mirror.solver.solve import METHOD as NAME
from rotcal_ros.methods.plane_mirror.solver.solve import MirrorSolution
from rotcal_ros.planning.plan import Plan

if TYPE_CHECKING:
    from rotcal_ros.adjust.model import CurveModel

COLUMNS: Final = {"position": "table_position"}
HEADER: Final[Header] = ("position", "tracker_station", "kind", "nest", "x_m", "y_m", "z_m")
TIMED: Final[Header] = (*HEADER, "time_s")
KINDS: Final = {"direct": PointKind.DIRECT, "mirrored": PointKind.MIRRORED, "nest": PointKind.NEST}
_FARTHEST: Final = 1000.0
"""Metres; beyond any tracker."""


def solve(configuration: Configuration, plan: Plan, observations: Sequence[Observation]) -> Result:
    """Solve the accepted observations of a plane-mirror plan.

    A reflector whose direct or mirrored point is missing (given up, or not measured yet) is left
    out; details["left_out"] names it.
    """
    problem, left_out = _problem(configuration, plan, observations)
    return _solve_ways(configuration, problem, {"left_out": left_out})


def _model_of_curves(configuration: Configuration, problem: PlaneMirrorProblem) -> CurveModel:
    """Return what points determine of ECC, to be solved with other instruments."""
    found, positions = plane_mirror.curves(problem)
    arrivals = bidirectional_arrivals(configuration.plan)
    return found if arrivals is None else mean_of_arrivals(found, arrivals.take(positions))


def _trials(configuration: Configuration, problem: PlaneMirrorProblem) -> Trials:
    """Prepare Monte Carlo trials about points."""
    solution, arrivals = MirrorSolution.of(problem), bidirectional_arrivals(configuration.plan)
    prepared = solution.found.trials
    if arrivals is None:
        return prepared
    measured = arrivals.take(solution.layout.positions)
    return RepeatedTrials.of(prepared, solution.result(), measured)


def _problem(
    configuration: Configuration, plan: Plan, observations: Sequence[Observation]
) -> tuple[PlaneMirrorProblem, list[Phrase]]:
    """Return the problem that observations pose, and what was left out of it."""
    paired, left_out = _paired(observations)
    if not paired:
        raise DataError(
            "no reflector was measured both directly and through the mirror; measure both"
        )
    problem = plane_mirror.problem_from_observations(paired, np.array(plan.table_angles))
    return _to_solve(problem, configuration), left_out


def _to_solve(problem: PlaneMirrorProblem, configuration: Configuration) -> PlaneMirrorProblem:
    """Return the problem as configured; refuses points of a mirror without any image."""
    carries = configuration.plan.carries
    alone = not (problem.kind == PointKind.MIRRORED).any()
    if alone and carries == MIRROR and configuration.solver.way != DIRECT:
        raise DataError(
            f"{problem.source}: no reflector was measured through the mirror; measure it, or set "
            "plan.carries to reflectors"
        )
    return configured(problem, configuration)


def check(
    configuration: Configuration, plan: Plan, observations: Sequence[Observation]
) -> tuple[Phrase, ...]:
    """Return in words what the nests show against the newest station.

    They do not stand where they were seen before, or the tracker turned by more than
    ``plan.drift_limit_arcsec`` between two rounds of nests. Raises DataError or GeometryError when
    the newest station cannot be registered at all.
    """
    if not any(o.kind == PointKind.NEST for o in observations):
        return ()
    problem = plane_mirror.problem_from_observations(observations, np.array(plan.table_angles))
    problem = configured(problem, configuration)
    limit = configuration.plan.drift_limit_arcsec * ARCSEC
    return tuple(plane_mirror.check_nests(problem, newest=True, drift_limit=limit))


def configured(problem: PlaneMirrorProblem, configuration: Configuration) -> PlaneMirrorProblem:
    """Return a problem with noise, way and limits of the configuration."""
    settings: MirrorSolverSettings = configuration.solver
    arrivals = bidirectional_arrivals(configuration.plan)
    return replace(
        problem,
        upward=None if arrivals is None else arrivals.upward,
        noise=noise_of(settings),
        way=settings.way,
        tilt_std=settings.tilt_std_arcsec * ARCSEC,
        uneven_drift_std=settings.uneven_drift_std_arcsec * ARCSEC,
        incidence_limit=configuration.plan.incidence_limit_deg * DEGREE,
        significance=settings.significance,
    )


def _solve_ways(
    configuration: Configuration, problem: PlaneMirrorProblem, details: dict[str, Any]
) -> Result:
    """Solve the chosen way; the other ways of the same points go into the details."""
    solution, arrivals = MirrorSolution.of(problem), bidirectional_arrivals(configuration.plan)
    result, measured = solution.result(), None
    if arrivals is not None:
        measured = arrivals.take(solution.layout.positions)
        result = mean_of_runs(result, measured)
    ways = [_other_way(solution, way, measured) for way in solution.others]
    return replace(result, details={**result.details, **details, "ways": ways})


def _other_way(solution: MirrorSolution, way: str, arrivals: Arrivals | None) -> dict[str, Any]:
    try:
        found = solution.by_way(way).found
    except (DataError, GeometryError) as error:
        return {"way": way, "why_not": str(error)}
    angles, ecc, covariance = solution.layout.angles, found.value, found.covariance
    if arrivals is not None:
        tied = mean_curve(arrivals)
        angles = arrivals.targets[arrivals.measured]
        ecc, covariance = tied @ ecc, written(mapped(covariance, tied))
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return {"way": way, "angles_rad": angles, "ecc_rad": ecc, "ecc_std_rad": std}


def _paired(observations: Sequence[Observation]) -> tuple[list[Observation], list[Phrase]]:
    """Return the observations without reflectors that lack one of their points, and the latter.

    Without any mirrored point there is no mirror, and every direct point stands for itself.
    """
    kinds: dict[tuple[int, int, int], set[PointKind]] = {}
    for o in observations:
        if o.kind != PointKind.NEST:
            kinds.setdefault((o.table_position, o.station, o.target), set()).add(o.kind)
    if not any(PointKind.MIRRORED in found for found in kinds.values()):
        return list(observations), []
    single = {key: found for key, found in kinds.items() if len(found) == 1}
    used = [
        o
        for o in observations
        if o.kind == PointKind.NEST or (o.table_position, o.station, o.target) not in single
    ]
    names = [
        phrase(
            "position {0}, tracker station {1}, reflector {2}: only {3} was measured",
            position,
            station,
            number,
            phrase(next(iter(found)).name.lower()),
        )
        for (position, station, number), found in single.items()
    ]
    return used, names


class TrackerCheck:
    """Rejects points of a laser tracker that contradict those of the same station.

    The image of a reflector is farther away than the reflector itself, and two nests stand
    apart. What is found while the reflector is still there can be measured again at once.
    """

    def __init__(self) -> None:
        self._direct: dict[tuple[int, int, int], tuple[float, ...]] = {}
        self._nests: dict[int, dict[int, tuple[float, ...]]] = {}

    def __call__(self, observation: Observation) -> Observation:
        """Return the observation, rejected when it cannot be."""
        if not observation.accepted:
            return observation
        reason = None
        key = (observation.station, observation.table_position, observation.target)
        if observation.kind == PointKind.DIRECT:
            self._direct[key] = observation.mean
        elif observation.kind == PointKind.MIRRORED and key in self._direct:
            reason = not_an_image(self._direct[key], observation.mean)
        elif observation.kind == PointKind.NEST:
            reason = self._on_another_nest(observation)
        return replace(observation, accepted=False, reason=reason) if reason else observation

    def _on_another_nest(self, observation: Observation) -> Phrase | None:
        """Say on which nest the reflector stands, if it is not the one that was asked for."""
        nests = self._nests.setdefault(observation.station, {})
        for number, place in nests.items():
            apart = dist(place, observation.mean)
            if number != observation.target and apart < MIN_APART:
                return phrase(
                    "nest {0} is {1:.3f} mm from where nest {2} was measured: reflector on the "
                    "wrong nest", observation.target, apart / MILLIMETRE, number
                )  # fmt: skip
        nests[observation.target] = observation.mean
        return None


@dataclass(frozen=True)
class TrackerPoints:
    """Points of a table, rows beyond any plan included; ``sha256`` maps file names to hashes."""

    configuration: Configuration
    table: Table
    sha256: Mapping[str, str]

    def __repr__(self) -> str:
        from rotcal_ros.methods.measurements import measured_in_words

        return measured_in_words(self, f"{len(self.table.lines)} points")

    def solve(self) -> Result:
        """Return the result."""
        points = self._points()
        named = zip(points.xyz.tolist(), points.kind, strict=True)
        hashed = RawData(tuple(hash_of(xyz, int(kind)) for xyz, kind in named))
        return replace(_solve_ways(self.configuration, points, {}), raw_data=hashed)

    def model_of_curves(self) -> CurveModel:
        """Return what the points determine of ECC, to be solved with other instruments."""
        return _model_of_curves(self.configuration, self._points())

    def trials(self) -> Trials:
        """Prepare Monte Carlo trials about the points."""
        return _trials(self.configuration, self._points())

    def _points(self) -> PlaneMirrorProblem:
        points = read_points(self.table, np.array(position_angles(self.configuration.plan)))
        return _to_solve(points, self.configuration)


def read(configuration: Configuration, table: Table, _targets: Table | None) -> TrackerPoints:
    """Return the points of any stations and nests, whose rows need not be steps of a plan."""
    return TrackerPoints(configuration, table, table_hashes(table))


def read_points(table: Table, angles: Floats) -> PlaneMirrorProblem:
    """Return the problem in a table for commanded ``angles`` (N,) in rad.

    Positions count from 0 into ``angles``; nest rows may leave theirs empty. Tracker stations are
    any labels, in the order of their first row: the order in which the tracker was moved. The
    order of the rows of a station is that of measuring, unless ``time_s`` states another.
    Coordinates are metres in the tracker's own frame. DataError names the row.
    """
    stations: dict[str, int] = {}
    rows, points, seconds = [], [], []
    for row in table.rows():
        word, station = row.cells["kind"], row.cells["tracker_station"]
        if word not in KINDS:
            raise DataError(f"{row.place}: kind {word!r}, expected {', '.join(KINDS)}")
        if not station:
            raise DataError(f"{row.place}: the tracker station is missing")
        kind = KINDS[word]
        position = -1 if kind is PointKind.NEST else row.index("position")
        number = stations.setdefault(station, len(stations))
        rows.append((position, number, kind, row.index("nest")))
        points.append(row.point(_FARTHEST))
        if table.header == TIMED:
            seconds.append(row.number("time_s"))
    position_of, station_of, kind_of, nest_of = np.array(rows, dtype=np.int64).T
    return PlaneMirrorProblem(
        angles=angles,
        position=position_of,
        station=station_of,
        kind=kind_of,
        nest=nest_of,
        xyz=np.array(points),
        station_names=tuple(stations),
        source=str(table.path),
        lines=tuple(line for line, _ in table.lines),
        time=np.array(seconds) if seconds else None,
    )


def zero(result: Result) -> tuple[str, ...]:
    """Return what the curve counts from, and how a whole turn closes."""
    first, details = zero_at_the_first(result), result.details
    if "closure_rad" not in details:
        unknown = phrase("No whole turn was measured: how the curve closes is not known.")
        return (*first, unknown)
    error = float(details["closure_rad"]) / ARCSEC
    expanded = COVERAGE_FACTOR * float(details["closure_std_rad"]) / ARCSEC
    closes = phrase(
        "The whole turn closes to {0} arcsec (k = 2).", value_with_uncertainty(error, expanded)
    )
    return (*first, closes)


_TRACKER: Final = plugins.lazy_load("rotcal_ros.methods.plane_mirror.simulation:SimulatedTracker")
METHOD: Final = Method(
    name=NAME,
    title="Laser tracker and plane mirror",
    page="plane_mirror",
    plan_settings=MirrorPlanSettings,
    solver_settings=MirrorSolverSettings,
    simulation_settings=MirrorSimulationSettings,
    simulated_instrument=lambda cell, table, _temperature, start_ns: _TRACKER(
        cell, table, start_ns
    ),
    plan=plan,
    check_plan=check_plan,
    capture=CaptureRules(
        {kind: decide_by_points(mean_point) for kind in KINDS.values()},
        lambda _plan: (TrackerCheck(),),
    ),
    solve=solve,
    model_of_curves=lambda *measured: _model_of_curves(measured[0], _problem(*measured)[0]),
    trials=lambda *measured: _trials(measured[0], _problem(*measured)[0]),
    check=check,
    nominal=lambda configuration, _plan: tracker_sees(configuration.plan),
    stations=lambda configuration: Stations(
        tuple(stand.place for stand in tracker_stands(configuration.plan))
    ),
    table=TableReader((HEADER, TIMED), read, COLUMNS),
    figures=plugins.lazy_load("rotcal_ros.methods.plane_mirror.figures:figures"),
    tables=plugins.lazy_load("rotcal_ros.methods.plane_mirror.figures:tables"),
    zero=zero,
    disturbances=plugins.lazy_load("rotcal_ros.methods.plane_mirror.simulation:DISTURBANCES"),
)
