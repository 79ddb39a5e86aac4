"""The plan: one turn of the table in each mounting, and a person's work before each."""

from __future__ import annotations

from rotcal_polygon.adjustment import separable
from rotcal_polygon.settings import PolygonPlanSettings
from rotcal_ros.foundation.errors import ConfigurationError, PlanError
from rotcal_ros.foundation.observations import Approach, PointKind
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.planning.plan import Move, Pause, Plan, Step

NAME = "polygon"
NOWHERE = (0.0, 0.0, 0.0)
"""The autocollimator stays where it is; what it shall read is zero."""


def plan(configuration: Configuration) -> Plan:
    """Return the plan: ``station`` is the mounting, ``target`` the face.

    Raises ConfigurationError for settings that contradict each other, PlanError for mountings
    that do not separate the polygon from the table.
    """
    settings: PolygonPlanSettings = configuration.plan
    _check(configuration)
    stops = settings.faces + settings.closure
    start, spacing = settings.table_start_deg, 360.0 / settings.faces
    table_angles = tuple((start + i * spacing) * DEGREE for i in range(stops))
    steps = tuple(
        Step(
            index=mounting * stops + position,
            table_position=position,
            table_angle=table_angles[position],
            approach=Approach.POSITIVE,
            kind=PointKind.READING,
            target=face_at(settings, mounting, position),
            position=NOWHERE,
            station=mounting,
            n_points=settings.readings,
        )
        for mounting in range(len(settings.first_faces))
        for position in range(stops)
    )
    pauses = tuple(
        Pause(
            mounting * stops,
            mounting * stops,
            f"mounting {mounting} of {len(settings.first_faces)}: turn the polygon on the table "
            f"so that the autocollimator sees face {face} with the table at {start:g} deg",
            move=Move("polygon", mounting),
        )
        for mounting, face in enumerate(settings.first_faces)
    )
    return Plan(NAME, table_angles, (NOWHERE,) * settings.faces, steps, pauses)


def face_at(settings: PolygonPlanSettings, mounting: int, position: int) -> int:
    """Return the face before the autocollimator."""
    return (settings.first_faces[mounting] + position) % settings.faces


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
