"""The polygon method, as nodes, replay and report see it: plan, result, figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from rotcal_polygon.model import FACE_ERROR, model_of, separable
from rotcal_polygon.settings import PolygonPlanSettings, PolygonSolverSettings
from rotcal_polygon.simulation import PolygonSimulationSettings, SimulatedAutocollimator
from rotcal_ros.adjust.engine import Adjusted
from rotcal_ros.adjust.model import Model
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.errors import ConfigurationError, PlanError
from rotcal_ros.foundation.observations import Observation, PointKind
from rotcal_ros.foundation.protection import Protection
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.methods.by_model import ByModel, Statement
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.disturbance import harmless, of_readings, repeatability
from rotcal_ros.methods.figures import Figure, style
from rotcal_ros.methods.figures.residuals import residual_figures
from rotcal_ros.methods.measurements import planned_table
from rotcal_ros.planning.plan import Plan, numbered_steps, pauses_at_stations
from rotcal_ros.planning.readings import Readings

NAME: Final = "polygon"
NOWHERE: Final = (0.0, 0.0, 0.0)
"""The autocollimator stays where it is."""
ARRIVALS: Final = 1.4
"""What arrivals that scatter do before they are found, per what noise does: by simulation of the
demonstration, as scripts/power_table.py does, 2.4 standard uncertainties where noise does 1.85."""
FARTHEST_RAD: Final = 0.02
"""No autocollimator reads more than a degree."""


def plan(configuration: Configuration) -> Plan:
    """Return the plan: ``station`` is the mounting, ``target`` the face.

    Raises ConfigurationError for settings that contradict each other, PlanError for mountings
    that do not separate the polygon from the table.
    """
    _check(configuration)
    settings: PolygonPlanSettings = configuration.plan
    n, first, start = settings.faces, settings.first_faces, settings.table_start_deg
    angles = [(start + 360.0 / n * i) * DEGREE for i in range(n + settings.closure)]
    rows = (
        (position, (face + position) % n, mounting)
        for mounting, face in enumerate(first)
        for position in range(len(angles))
    )
    targets, points = (NOWHERE,) * n, settings.readings
    steps = numbered_steps(rows, angles, targets, PointKind.READING, n_points=points)
    instructions = [
        f"mounting {mounting} of {len(first)}: turn the polygon on the table so that the "
        f"autocollimator sees face {face} with the table at {start:g} deg"
        for mounting, face in enumerate(first)
    ]
    pauses = pauses_at_stations(steps, "polygon", instructions)
    return Plan(NAME, tuple(angles), targets, steps, pauses)


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


def model(configuration: Configuration, read: Readings) -> Model:
    """Return what was read, for the engine."""
    return model_of(configuration.plan, configuration.solver, read)


def states(configuration: Configuration, found: Adjusted) -> Statement:
    """Return the faces' errors, and what is done about effects that no reading can tell of."""
    gauge = Protection("gauge", "estimated", "the mountings separate the polygon's errors")
    doubts = []
    if FACE_ERROR not in found.also:
        doubts.append(
            "the errors of the polygon are in the result: there is one mounting and no "
            "certificate; add mountings, or solver.face_errors_arcsec"
        )
        gauge = Protection("gauge", "not protected", "the polygon's errors are in the result")
    if configuration.solver.face_errors_arcsec:
        gauge = Protection("gauge", "bounded", "the polygon's errors are those of its certificate")
    return Statement(doubts, (*_unread(), _arrivals(found), gauge))


def _unread() -> tuple[Protection, ...]:
    return (
        Protection("error motion", "harmless", "an autocollimator sees no shift of the face"),
        Protection("refraction", "harmless", "a steady bend is the same at all faces"),
        Protection("tilt", "harmless", "a tilt moves the image across the direction that is read"),
        Protection(
            "sign of readings",
            "not protected",
            "readings that count the other way round fit as well, and turn the sign of the result",
        ),
    )


def _arrivals(found: Adjusted) -> Protection:
    mounting = found.model.groupings[0].number
    if len(np.unique(mounting[mounting >= 0])) == 1:
        return Protection("repeatability", "not protected", "the table comes once to an angle")
    noise = next(p.error for p in found.protections() if p.effect == "axis noise")
    error = None if noise is None else ARRIVALS * noise
    return Protection("repeatability", "tested", "every mounting comes to every angle", error)


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


def figures(result: Result, _truth: Mapping[str, Any] | None) -> Sequence[Figure]:
    """Return the figures that only this method can fill."""
    caption = "How far each face is turned from its nominal direction, k = 2; the mean is zero."
    return [
        Figure("Face errors of the polygon", caption, _face_errors(result.details)),
        *residual_figures(result, ARCSEC, "arcsec"),
    ]


@style.styled
def _face_errors(details: Mapping[str, Any]) -> str:
    if FACE_ERROR not in details["also"]:
        return ""
    faces = details["also"][FACE_ERROR]
    error = np.asarray(faces["value"]) / ARCSEC
    band = COVERAGE_FACTOR * np.asarray(faces["std"]) / ARCSEC
    (ax,) = style.grid()
    ax.bar(range(len(error)), error, yerr=band, color=style.BLUE, alpha=0.75, capsize=2)
    style.whole_numbers(ax.xaxis)
    ax.set_xlabel("face")
    ax.set_ylabel("face error / arcsec")
    return style.svg(ax)


METHOD: Final = ByModel(NAME, model, states).method(
    title="Optical polygon and autocollimator",
    page="polygon",
    plan_settings=PolygonPlanSettings,
    solver_settings=PolygonSolverSettings,
    simulation_settings=PolygonSimulationSettings,
    simulated_instrument=SimulatedAutocollimator,
    plan=plan,
    check=check,
    table=planned_table(
        {"position": "table_position", "mounting": "station"}, {"reading_rad": FARTHEST_RAD}
    ),
    figures=figures,
    disturbances=(
        *of_readings(0.05, 20.0),
        repeatability(0.02, 10.0),
        *harmless("error motion", "refraction", "tilt", "gauge"),
    ),
)
