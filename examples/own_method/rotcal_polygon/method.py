"""The polygon method, as nodes, replay and report see it: settings, plan, result, tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from rotcal_polygon.model import PolygonReadings, face_errors, model_of, separable
from rotcal_polygon.simulation import PolygonSimulationSettings, SimulatedAutocollimator
from rotcal_ros.adjust.engine import adjust
from rotcal_ros.capture import CaptureRules
from rotcal_ros.capture.decisions import mean_point, points
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.errors import ConfigurationError, DataError, PlanError
from rotcal_ros.foundation.observations import Approach, Observation, PointKind
from rotcal_ros.foundation.protection import Protection
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.settings import setting
from rotcal_ros.foundation.tables import Row, Table, hashes
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.methods.calibration import prepare
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.disturbance import (
    Disturbance,
    Disturbances,
    DisturbedMeasurement,
    Sizes,
    harmless,
    repeatability,
    spoiled,
)
from rotcal_ros.methods.figures import Figure, style
from rotcal_ros.methods.figures.residuals import residual_figures
from rotcal_ros.methods.measurements import PlannedMeasurements, RowStepFinder
from rotcal_ros.methods.method import Method, TableReader, Trials
from rotcal_ros.planning.plan import Move, Pause, Plan, Step

NAME: Final = "polygon"
NOWHERE: Final = (0.0, 0.0, 0.0)
"""The autocollimator stays where it is; what it shall read is zero."""
ARRIVALS: Final = 1.4
"""What arrivals that scatter do before they are found, per what noise does: by simulation of the
demonstration, as scripts/power_table.py does, 2.4 standard uncertainties where noise does 1.85."""
FARTHEST_RAD: Final = 0.02
"""No autocollimator reads more than a degree."""


@dataclass(frozen=True)
class PolygonPlanSettings:
    """The polygon, its mountings, and where the table stops: once for every face."""

    faces: int = setting(
        12, doc="number of faces of the polygon", minimum=3, maximum=144, first=True
    )
    first_faces: tuple[int, ...] = setting(
        (0, 1, 5),
        doc="face before the autocollimator at table position 0, by mounting",
        minimum=0,
        first=True,
    )
    table_start_deg: float = setting(0.0, doc="deg, table angle of position 0", first=True)
    closure: bool = setting(True, doc="measure position 0 again after a full turn")
    readings: int = setting(3, doc="readings at each position", minimum=1, maximum=1000)
    alignment_arcsec: float = setting(
        60.0, doc="arcsec, largest first reading of a mounting: else align again", minimum=0.1
    )


@dataclass(frozen=True)
class PolygonSolverSettings:
    """How sure a reading is, and what is known about the polygon."""

    sigma_arcsec: float = setting(
        0.05, doc="arcsec, standard deviation of a reading, the table's repeatability included",
        minimum=1e-6, first=True,
    )  # fmt: skip
    face_errors_arcsec: tuple[float, ...] = setting(
        (),
        doc="arcsec, certificate: how far each face is turned counter-clockwise; none: unknown",
        first=True,
    )
    face_std_arcsec: float = setting(
        0.05,
        doc="arcsec, standard uncertainty (k = 1) of the face errors of the certificate",
        minimum=1e-6,
        first=True,
    )


def plan(configuration: Configuration) -> Plan:
    """Return the plan: ``station`` is the mounting, ``target`` the face.

    Raises ConfigurationError for settings that contradict each other, PlanError for mountings
    that do not separate the polygon from the table.
    """
    _check(configuration)
    settings: PolygonPlanSettings = configuration.plan
    stops, first = settings.faces + settings.closure, settings.first_faces
    angle = [
        (settings.table_start_deg + 360.0 / settings.faces * i) * DEGREE for i in range(stops)
    ]
    steps = tuple(
        Step(
            index=mounting * stops + position, table_position=position,
            table_angle=angle[position], approach=Approach.POSITIVE, kind=PointKind.READING,
            target=(face + position) % settings.faces, position=NOWHERE, station=mounting,
            n_points=settings.readings,
        )
        for mounting, face in enumerate(first)
        for position in range(stops)
    )  # fmt: skip
    pauses = tuple(
        Pause(
            mounting * stops, mounting * stops,
            f"mounting {mounting} of {len(first)}: turn the polygon on the table so that the "
            f"autocollimator sees face {face} with the table at {settings.table_start_deg:g} deg",
            move=Move("polygon", mounting),
        )
        for mounting, face in enumerate(first)
    )  # fmt: skip
    return Plan(NAME, tuple(angle), (NOWHERE,) * settings.faces, steps, pauses)


def _check(configuration: Configuration) -> None:
    settings: PolygonPlanSettings = configuration.plan
    source, first = configuration.source, settings.first_faces
    known = configuration.solver.face_errors_arcsec
    if not first or len(set(first)) < len(first) or max(first) >= settings.faces:
        raise ConfigurationError(
            f"{source}: plan.first_faces: expected different faces from 0 to "
            f"{settings.faces - 1}, one for each mounting, found {list(first)}"
        )
    if known and len(known) != settings.faces:
        raise ConfigurationError(
            f"{source}: solver.face_errors_arcsec: {len(known)} values for a polygon with "
            f"{settings.faces} faces"
        )
    if len(first) > 1 and not known and not separable(settings.faces, first):
        raise PlanError(
            f"{source}: mountings that begin with faces {list(first)} of {settings.faces} never "
            "compare all faces with each other: turn the polygon by 1 face between two of them"
        )


def readings_of(
    configuration: Configuration, observations: Sequence[Observation]
) -> PolygonReadings:
    """Return what was read, for the engine; position N is position 0 again."""
    if not observations:
        raise DataError("the autocollimator has read nothing: there is nothing to solve")
    settings, solver = configuration.plan, configuration.solver
    known = solver.face_errors_arcsec
    columns = [(o.table_position % settings.faces, o.target, o.station) for o in observations]
    return PolygonReadings(
        settings.faces, *np.array(columns).T, np.array([o.mean[0] for o in observations]),
        solver.sigma_arcsec * ARCSEC, np.array(known) * ARCSEC if known else None,
        solver.face_std_arcsec * ARCSEC, bool(known) or len(settings.first_faces) > 1,
    )  # fmt: skip


def solve(configuration: Configuration, plan: Plan, observations: Sequence[Observation]) -> Result:
    """Solve accepted observations; residuals are radians, ``target`` is the face."""
    readings = readings_of(configuration, observations)
    found = adjust(model_of(readings))
    noise = next(p.error for p in found.protections() if p.effect == "axis noise")
    n, doubts, details = readings.faces, [], {}
    if readings.unknown_faces:
        error, std = face_errors(found, n)
        details = {"face_error_rad": error, "face_error_std_rad": std}
    else:
        doubts.append(
            "the errors of the polygon are in the result: there is one mounting and no "
            "certificate; add mountings, or solver.face_errors_arcsec"
        )
    return found.result(
        NAME,
        np.array(plan.table_angles[:n]),
        {"ECC": slice(n)},
        (readings.position, readings.face),
        doubts=doubts,
        protections=_protections(readings, noise),
        details=details,
    )


def _protections(readings: PolygonReadings, noise: float | None) -> tuple[Protection, ...]:
    """Return what is done about effects that no reading can tell of.

    ``noise``: error of a larger noise that just is found, in standard uncertainties.
    """
    once = len(np.unique(readings.mounting)) == 1
    repeats = "the table comes once to an angle" if once else "every mounting comes to every angle"
    gauge = Protection("gauge", "estimated", "the mountings separate the polygon's errors")
    if readings.certificate is not None:
        gauge = Protection("gauge", "bounded", "the polygon's errors are those of its certificate")
    elif not readings.unknown_faces:
        gauge = Protection("gauge", "not protected", "the polygon's errors are in the result")
    return (
        Protection("error motion", "harmless", "an autocollimator sees no shift of the face"),
        Protection(
            "repeatability",
            "not protected" if once else "tested",
            repeats,
            None if once or noise is None else ARRIVALS * noise,
        ),
        Protection("refraction", "harmless", "a steady bend is the same at all faces"),
        Protection("tilt", "harmless", "a tilt moves the image across the direction that is read"),
        gauge,
    )


def trials(
    configuration: Configuration, _plan: Plan, observations: Sequence[Observation]
) -> Trials:
    """Prepare Monte Carlo trials about accepted observations."""
    return adjust(model_of(readings_of(configuration, observations))).trials


def check(
    configuration: Configuration, _plan: Plan, observations: Sequence[Observation]
) -> tuple[str, ...]:
    """Return in words that the newest mounting is not aligned, by its first reading."""
    newest = max((o.station for o in observations), default=0)
    limit = configuration.plan.alignment_arcsec
    return tuple(
        f"mounting {newest} reads {o.mean[0] / ARCSEC:.4g} arcsec at position 0, allowed {limit:g}"
        for o in observations
        if (o.station, o.table_position) == (newest, 0) and abs(o.mean[0]) > limit * ARCSEC
    )


def read(configuration: Configuration, table: Table, _targets: Path | None) -> PlannedMeasurements:
    """Return the readings of a plain table by position and mounting, from 0.

    DataError names file and row of what cannot be.
    """
    calibration, settings = prepare(configuration), configuration.plan
    find, observations = RowStepFinder(calibration.plan), []
    for row in table.rows():
        position, mounting = row.index("position"), row.index("mounting")
        if mounting >= len(settings.first_faces):
            raise DataError(
                f"{row.place}: mounting {mounting} is not in the plan, which has mountings "
                f"0 to {len(settings.first_faces) - 1}"
            )
        step = find(row, position, (settings.first_faces[mounting] + position) % settings.faces)
        observations.append(step.observed((_reading(row), 0.0, 0.0)))
    return PlannedMeasurements(calibration, tuple(observations), hashes(table.path))


def _reading(row: Row) -> float:
    value = row.number("reading_rad")
    if abs(value) > FARTHEST_RAD:
        raise DataError(
            f"{row.place}: reading_rad is {value:g} rad, more than {FARTHEST_RAD:g}; are these "
            "arcseconds? Tables are in radians"
        )
    return value


def figures(result: Result, _truth: Mapping[str, Any] | None) -> Sequence[Figure]:
    """Return the figures that only this method can fill."""
    caption = "How far each face is turned from its nominal direction, k = 2; the mean is zero."
    return [
        Figure("Face errors of the polygon", caption, _face_errors(result.details)),
        *residual_figures(result, ARCSEC, "arcsec"),
    ]


@style.styled
def _face_errors(details: Mapping[str, Any]) -> str:
    if "face_error_rad" not in details:
        return ""
    error = np.asarray(details["face_error_rad"]) / ARCSEC
    band = COVERAGE_FACTOR * np.asarray(details["face_error_std_rad"]) / ARCSEC
    (ax,) = style.grid()
    ax.bar(range(len(error)), error, yerr=band, color=style.BLUE, alpha=0.75, capsize=2)
    style.whole_numbers(ax.xaxis)
    ax.set_xlabel("face")
    ax.set_ylabel("face error / arcsec")
    return style.svg(ax)


def measure(
    configuration: Configuration, plan: Plan, sizes: Sizes, seed: int
) -> DisturbedMeasurement:
    """Return readings of every step, with noise and the effects of ``sizes``."""
    n = configuration.plan.faces
    true = 2.0 * ARCSEC * np.random.default_rng([seed, 2]).standard_normal(n)
    at = [step.table_position % n for step in plan.steps]
    exact = [
        step.observed((angle, 0.0, 0.0)) for step, angle in zip(plan.steps, true[at], strict=True)
    ]
    found = spoiled(model_of(readings_of(configuration, exact)), plan, sizes, seed)
    steps = zip(plan.steps, found.tolist(), strict=False)  # the certificate's values come after
    observations = tuple(step.observed((value, 0.0, 0.0)) for step, value in steps)
    return DisturbedMeasurement(observations, {"ECC": np.resize(true, len(plan.distinct_angles))})


DISTURBANCES: Final = Disturbances(
    (
        Disturbance("drift", "linearly in each mounting", "arcsec", ARCSEC, 0.05, 20.0),
        Disturbance("knock", "from one moment on", "arcsec", ARCSEC, 0.05, 20.0),
        Disturbance(
            "axis noise", "so many times as stated", "times", 1.0, 1.2, 50.0, scatters=True
        ),
        Disturbance("scale", "all readings too large by so much", "%", 0.01, 1.0, 50.0),
        repeatability(0.02, 10.0),
        *harmless("error motion", "refraction", "tilt", "gauge"),
    ),
    measure,
)
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
    solve=solve,
    trials=trials,
    check=check,
    nominal=lambda _configuration, _plan: lambda step: step.position,
    table=TableReader((("position", "mounting", "reading_rad"),), read),
    figures=figures,
    disturbances=DISTURBANCES,
)
