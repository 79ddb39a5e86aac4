"""The plan of the plane-mirror method: table positions, tracker stations, nests.

Each tracker station measures the nests first, then its table positions, then the nests again,
which shows how the tracker drifted; neighbouring stations share positions. Before each station a
person moves the tracker.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain
from typing import Final

import numpy as np

from rotcal_ros.foundation.errors import ConfigurationError, PlanError
from rotcal_ros.foundation.observations import Approach, PointKind
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.method import See
from rotcal_ros.methods.plane_mirror.mirror_physics import (
    FlatMirror,
    TrackerStation,
    incidence,
    on_circle,
    reflector_places,
)
from rotcal_ros.methods.plane_mirror.settings import (
    DIRECT,
    JOINT,
    MIRROR,
    STITCHING,
    MirrorPlanSettings,
)
from rotcal_ros.methods.plane_mirror.solver.solve import METHOD
from rotcal_ros.planning.plan import OperatorMove, Pause, Plan, Point, Step
from rotcal_ros.planning.points import parse_points
from rotcal_ros.planning.table_angles import table_angles

LEAST_ANGLES: Final = 3
"""Different table angles below which the mirror's normals show no plane of rotation."""
_CLOSING: Final = "leave the tracker where it is; the station is measured again"
_MIN_TRIANGLE: Final = 0.1
"""Nests reach at least this far (m) to the side of the line through them."""


def plan(configuration: Configuration) -> Plan:
    """Return the plan of a plane-mirror configuration.

    Raises ConfigurationError when the way does not fit what the table carries, PlanError when
    the way lacks nests or shared positions.
    """
    settings: MirrorPlanSettings = configuration.plan
    way = configuration.solver.way
    if way != JOINT and (way == DIRECT) == (settings.carries == MIRROR):
        raise ConfigurationError(
            f"{configuration.source}: solver.way = {way} does not fit plan.carries = "
            f"{settings.carries}: the direct way needs reflectors on the table, stitching and "
            "registration a mirror"
        )
    result = mirror_plan(settings)
    n_stations = len(tracker_stands(settings))
    if way == STITCHING and n_stations > 1 and not settings.shared_positions:
        raise PlanError(
            f"{configuration.source}: stitching carries the zero on through shared positions; "
            "station 1 shares none with station 0: set plan.shared_positions to at least 1"
        )
    if way != STITCHING and n_stations > 1 and not result.targets:
        raise PlanError(
            f"{configuration.source}: the way {way} joins {n_stations} tracker stations "
            "through nests: name at least three in plan.nests_m"
        )
    return result


def check_plan(configuration: Configuration, planned: Plan) -> None:
    """Raise PlanError for a plan whose points show no plane in which the table turns."""
    angles = len(planned.distinct_angles)
    if configuration.plan.carries == MIRROR and angles < LEAST_ANGLES:
        raise PlanError(
            f"{angles} table angles: the plane in which the mirror turns needs at least "
            f"{LEAST_ANGLES}: raise table_positions"
        )


@dataclass(frozen=True)
class Stand:
    """One place of the tracker: ``place`` (m) and the table positions measured from it."""

    number: int
    place: Point
    azimuth: float
    visit: range


def mirror_plan(settings: MirrorPlanSettings) -> Plan:
    """Return the plan of one plane-mirror calibration.

    With ``bidirectional`` the table positions go up through the angles and down again: position
    2 n - 1 - i stands at the angle of position i, reached from above. Raises PlanError
    when a station sees the mirror beyond the incidence limit, or when nests, stations and
    positions do not fit together.
    """
    angles, stands = table_angles(settings), tracker_stands(settings)
    again = settings.closing_nests
    nests = parse_points(settings.nests_m, "nests_m") if len(stands) > 1 or again else ()
    _check_nests(nests)
    every = position_angles(settings)
    blocks = [_steps_of(settings, every, stand, nests, again) for stand in stands]
    up = len(angles)
    side = [Approach.POSITIVE] * up + [Approach.NEGATIVE] * (len(every) - up)
    starts = np.cumsum([0, *map(len, blocks)]).tolist()
    steps = tuple(
        Step(index, position, every[position], side[position], kind, target, place, station)
        for index, (station, position, kind, target, place) in enumerate(chain(*blocks))
    )
    pauses: list[Pause] = []
    for start, end, stand in zip(starts[:-1], starts[1:], stands, strict=True):
        instruction = _instruction(stand, stands, angles, len(nests))
        move = OperatorMove("tracker", stand.number, stand.place)
        pauses.append(Pause(start, start + len(nests) - 1, instruction, move=move))
        if nests and again:
            pauses.append(Pause(end - len(nests), end - 1, _CLOSING, again_from=start))
    return Plan(METHOD, every, nests, steps, tuple(pauses))


def position_angles(settings: MirrorPlanSettings) -> tuple[float, ...]:
    """Return the commanded angle (rad) of every table position: up, then down if both ways."""
    angles = table_angles(settings)
    return angles + angles[::-1] * settings.bidirectional


def tracker_stands(settings: MirrorPlanSettings) -> tuple[Stand, ...]:
    """Return the stations of the tracker; raises PlanError for one that is not possible."""
    angles = table_angles(settings)
    if settings.shared_positions >= settings.positions_per_station:
        raise PlanError(
            f"plan: shared_positions = {settings.shared_positions} must be less than "
            f"positions_per_station = {settings.positions_per_station}: no station would get on"
        )
    visits = station_visits(len(angles), settings.positions_per_station, settings.shared_positions)
    azimuths = tuple(azimuth * DEGREE for azimuth in settings.station_azimuths_deg) or tuple(
        settings.mirror_azimuth_deg * DEGREE + (angles[v[0]] + angles[v[-1]]) / 2 for v in visits
    )
    if len(azimuths) != len(visits):
        raise PlanError(
            f"plan: {len(visits)} tracker stations are needed for {len(angles)} positions, "
            f"station_azimuths_deg names {len(azimuths)}"
        )
    stands = tuple(
        Stand(
            number,
            on_circle(settings.station_radius_m, azimuth, settings.station_height_m),
            azimuth,
            visit,
        )
        for number, (azimuth, visit) in enumerate(zip(azimuths, visits, strict=True))
    )
    if settings.carries == MIRROR:
        _check_incidence(settings, angles, stands)
    return stands


def station_visits(n_positions: int, per_station: int, shared: int) -> tuple[range, ...]:
    """Return the table positions that each tracker station measures.

    Every station measures ``per_station`` positions, the last one what is left; neighbours have
    ``shared`` (less than ``per_station``) in common.
    """
    visits = [range(min(per_station, n_positions))]
    while visits[-1].stop < n_positions:
        first = visits[-1].stop - shared
        visits.append(range(first, min(first + per_station, n_positions)))
    return tuple(visits)


def nominal_mirror(settings: MirrorPlanSettings) -> FlatMirror:
    """Return the mirror as the plan has it."""
    turned = settings.mirror_azimuth_deg * DEGREE, settings.mirror_lean_deg * DEGREE
    return FlatMirror(settings.mirror_centre_m, *turned, *settings.mirror_size_m)


def tracker_sees(settings: MirrorPlanSettings) -> See:
    """Return what a tracker sees that looks along +x at every station; the mirror is flat."""
    stations = [TrackerStation(stand.place) for stand in tracker_stands(settings)]
    mirror = nominal_mirror(settings)

    def see(step: Step) -> tuple[float, ...]:
        station, place = stations[step.station], np.array(step.position)
        if step.kind is PointKind.MIRRORED:
            pose = mirror.pose(rotation_about_z(step.table_angle))
            place = mirror.image(pose, station, place, f"step {step.index}")
        return tuple(station.to_local(place).tolist())

    return see


Row = tuple[int, int, PointKind, int, Point]
"""Station, table position, kind, number of the nest or reflector, place."""


def _steps_of(
    settings: MirrorPlanSettings,
    angles: tuple[float, ...],
    stand: Stand,
    nests: tuple[Point, ...],
    again: bool,
) -> list[Row]:
    """Return what is measured from one station: nests, position by position, nests ``again``."""
    mirrored = [PointKind.MIRRORED] if settings.carries == MIRROR else []
    down = [len(angles) - 1 - position for position in reversed(stand.visit)]
    visit = [*stand.visit, *(down if settings.bidirectional else ())]
    rows = _round(stand, visit[0], nests)
    for count, position in enumerate(visit):
        if again and count and settings.nests_every and count % settings.nests_every == 0:
            rows += _round(stand, visit[count - 1], nests)
        rows += [
            (stand.number, position, kind, number, place)
            for number, place in enumerate(_reflectors(settings, angles[position], stand), start=1)
            for kind in (PointKind.DIRECT, *mirrored)
        ]
    return rows + _round(stand, visit[-1], nests) if again else rows


def _round(stand: Stand, position: int, nests: tuple[Point, ...]) -> list[Row]:
    """Return one round of nests; the table stays at ``position``."""
    return [
        (stand.number, position, PointKind.NEST, number, place)
        for number, place in enumerate(nests, start=1)
    ]


def _reflectors(settings: MirrorPlanSettings, angle: float, stand: Stand) -> tuple[Point, ...]:
    if settings.carries == MIRROR:
        places = reflector_places(
            stand.place,
            *nominal_mirror(settings).pose(rotation_about_z(angle)),
            count=settings.reflectors,
            reach=settings.reflector_reach_m,
            edge=min(settings.mirror_size_m),
        )
    else:
        carried = parse_points(settings.table_reflectors_m, "table_reflectors_m")
        if not carried:
            raise PlanError(
                "plan: the table carries reflectors, but table_reflectors_m names none"
            )
        places = np.array(carried) @ rotation_about_z(angle).T
    return tuple((x, y, z) for x, y, z in places.tolist())


def _check_incidence(
    settings: MirrorPlanSettings, angles: tuple[float, ...], stands: tuple[Stand, ...]
) -> None:
    limit = settings.incidence_limit_deg
    for stand, position in ((each, k) for each in stands for k in each.visit):
        pose = nominal_mirror(settings).pose(rotation_about_z(angles[position]))
        found = incidence(stand.place, *pose) / DEGREE
        if found > limit:
            raise PlanError(
                f"plan: from tracker station {stand.number} the beam would strike the mirror at "
                f"position {position} ({angles[position] / DEGREE:g} deg) at {found:.1f} deg of "
                f"incidence, allowed {limit:g}: take fewer positions per station "
                f"(positions_per_station = {settings.positions_per_station}), or another azimuth"
            )


def _check_nests(nests: tuple[Point, ...]) -> None:
    """Refuse nests that could not show how the tracker was turned; none at all are allowed."""
    if not nests:
        return
    if len(nests) < 3:
        raise PlanError(f"plan: {len(nests)} nests, the registration needs at least three")
    centred = np.array(nests) - np.mean(nests, axis=0)
    if np.linalg.svd(centred, compute_uv=False)[1] < _MIN_TRIANGLE:
        raise PlanError(
            f"plan: the {len(nests)} nests lie in a line: a station could turn about it; put one "
            "aside"
        )


def _instruction(
    stand: Stand, stands: tuple[Stand, ...], angles: tuple[float, ...], n_nests: int
) -> str:
    x, y, z = stand.place
    first, last = angles[stand.visit[0]] / DEGREE, angles[stand.visit[-1]] / DEGREE
    nests = f"nests 1 to {n_nests} and " if n_nests else ""
    return (
        f"put the tracker at place {stand.number + 1} of {len(stands)} (number {stand.number} in "
        f"the data), near x {x:.2f}, y {y:.2f}, z {z:.2f} m, {np.hypot(x, y):.2f} m from the "
        f"table axis at {stand.azimuth / DEGREE % 360.0:.0f} deg; it will measure {nests}table "
        f"positions {first:g} to {last:g} deg"
    )
