"""What may spoil a plane-mirror calibration: the plan measured again, with one thing wrong."""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.geometry.rotations import rotation_about_z, rotation_from_vector
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.disturbance import (
    ALL_AXES,
    PPM,
    Disturbance,
    Disturbances,
    DisturbedMeasurement,
    Sizes,
    Streams,
    arrival_errors,
    error_motion,
    repeatability,
    scatter_in_plane,
    streams,
    tilt,
    times,
)
from rotcal_ros.methods.plane_mirror.mirror_physics import TrackerStation
from rotcal_ros.methods.plane_mirror.plan import nominal_mirror, tracker_stands
from rotcal_ros.methods.plane_mirror.settings import MirrorPlanSettings
from rotcal_ros.methods.plane_mirror.solver.problem import noise_of
from rotcal_ros.planning.plan import Plan


def _tilt(configuration: Configuration) -> float:
    return float(configuration.solver.tilt_std_arcsec * ARCSEC)


def _swing(configuration: Configuration) -> float:
    return float(configuration.solver.uneven_drift_std_arcsec * ARCSEC)


LISTED: Final = (
    Disturbance(
        "drift",
        "the tracker's azimuth drifts by so much at every station, linearly while it stands",
        "arcsec", ARCSEC, 0.3, 100.0,
    ),
    Disturbance(
        "uneven drift",
        "the tracker's azimuth swings by so much at every station, one sine while it stands",
        "arcsec", ARCSEC, 0.3, 100.0, stated=_swing,
    ),
    Disturbance(
        "one place",
        "half of the reflectors are seen so far aside in the mirror, at one table position",
        "um", MICROMETRE, 3.0, 1000.0,
    ),
    Disturbance(
        "knock",
        "the mirror is turned on the table, about x, y and z alike, half-way through the run",
        "arcsec", ARCSEC, 0.3, 100.0,
    ),
    Disturbance(
        "axis noise",
        "the tracker's errors across the beam are so many times the stated ones",
        "times", 1.0, 1.2, 100.0, scatters=True,
    ),
    error_motion(1.0, 100.0),
    repeatability(0.3, 100.0),
    Disturbance(
        "refraction",
        "the index of the air changes sideways through the room by so much per metre",
        "ppm/m", PPM, 0.3, 100.0,
    ),
    Disturbance(
        "scale", "the tracker's distances are too long by so much", "ppm", PPM, 1.0, 1000.0
    ),
    tilt(0.1, 100.0, _tilt),
    Disturbance(
        "gauge",
        "the table's axis leans by so much against the vertical",
        "arcsec", ARCSEC, 100.0, 3600.0,
    ),
)  # fmt: skip


def measure(
    configuration: Configuration, plan: Plan, sizes: Sizes, seed: int
) -> DisturbedMeasurement:
    """Return what the tracker sees with the stated noise and the effects of ``sizes``.

    The table has no ECC; the true ECC are zero.
    """
    noise, other = streams(seed)
    stations = [TrackerStation(stand.place) for stand in tracker_stands(configuration.plan)]
    station = np.array([step.station for step in plan.steps])
    head = np.array([stations[s].place for s in station.tolist()])
    seen = _places(configuration, plan, stations, sizes, (noise, other)) - head
    seen = _bent(seen, sizes) * (1.0 + sizes.get("scale", 0.0))
    since = _since_put_up(station)
    azimuth = sizes.get("drift", 0.0) * since
    azimuth = azimuth + sizes.get("uneven drift", 0.0) * np.sin(2.0 * np.pi * since)
    seen = np.einsum("nij,nj->ni", rotation_about_z(azimuth), seen)
    seen = seen + sizes.get("one place", 0.0) * _aside(configuration.plan, plan, seen)
    seen = seen + _noise(configuration, seen, sizes, noise)
    observations = tuple(
        step.observed((x, y, z)) for step, (x, y, z) in zip(plan.steps, seen.tolist(), strict=True)
    )
    return DisturbedMeasurement(observations, {"ECC": np.zeros(len(plan.distinct_angles))})


def _places(
    configuration: Configuration,
    plan: Plan,
    stations: list[TrackerStation],
    sizes: Sizes,
    streams: Streams,
) -> Floats:
    """Return where the points or their images are at every step (n, 3), m, in the room."""
    noise, other = streams
    settings: MirrorPlanSettings = configuration.plan
    solver, mirror = configuration.solver, nominal_mirror(settings)
    rotation, shift = _table(configuration, plan, sizes, (noise, other))
    slope = solver.mirror_slope_std_arcsec * ARCSEC * noise.standard_normal((len(plan.steps), 3))
    knock = rotation_from_vector(sizes.get("knock", 0.0) * ALL_AXES)
    after = times(plan) >= 0.5
    places = np.array([step.position for step in plan.steps])
    for k, step in enumerate(plan.steps):
        carried = rotation[k] @ knock if after[k] else rotation[k]
        if step.kind is PointKind.MIRRORED:
            centre, frame = mirror.pose(carried, shift[k])
            pose = centre, rotation_from_vector(slope[k]) @ frame
            places[k] = mirror.image(pose, stations[step.station], places[k], f"step {k}")
        elif step.kind is PointKind.DIRECT and settings.carries != "mirror":
            nominal = rotation_about_z(step.table_angle)
            places[k] = carried @ nominal.T @ places[k] + shift[k]
    return places


def _table(
    configuration: Configuration, plan: Plan, sizes: Sizes, streams: Streams
) -> tuple[Floats, Floats]:
    """Return rotation (n, 3, 3) and shift (n, 3) of the table at every step."""
    noise, other = streams
    m = len(plan.table_angles)
    position = np.array([step.table_position for step in plan.steps])
    arrived = arrival_errors(plan, sizes, other)
    angle = np.array([step.table_angle for step in plan.steps]) + arrived
    lean = scatter_in_plane(m, _tilt(configuration), noise)
    lean += scatter_in_plane(m, sizes.get("tilt", 0.0), other)
    shift = scatter_in_plane(m, sizes.get("error motion", 0.0), other)
    axis = rotation_from_vector(np.array([sizes.get("gauge", 0.0), 0.0, 0.0]))
    turned = axis @ rotation_from_vector(lean)[position] @ rotation_about_z(angle)
    return np.asarray(turned, dtype=np.float64), shift[position]


def _bent(seen: Floats, sizes: Sizes) -> Floats:
    """Return the points (n, 3) where they seem to be through air whose index grows along x."""
    distance = np.linalg.norm(seen, axis=1)[:, None]
    beam = seen / distance
    gradient = np.array([sizes.get("refraction", 0.0), 0.0, 0.0])
    across = gradient - (beam @ gradient)[:, None] * beam
    return np.asarray(seen + 0.5 * distance**2 * across, dtype=np.float64)


def _aside(settings: MirrorPlanSettings, plan: Plan, seen: Floats) -> Floats:
    """Return the direction (n, 3) level across the beam of half the images at one position.

    It is the position in the middle of the plan; other points have none.
    """
    middle = len(plan.table_angles) // 2
    wrong = [
        step.kind is PointKind.MIRRORED
        and step.table_position == middle
        and 2 * step.target <= max(settings.reflectors, 2)
        for step in plan.steps
    ]
    level = np.cross([0.0, 0.0, 1.0], seen)
    level = level / np.linalg.norm(level, axis=1)[:, None]
    return np.where(np.array(wrong)[:, None], level, 0.0)


def _since_put_up(station: Floats) -> Floats:
    """Return the time (n,) since the tracker was put up at its station, 0 to 1."""
    time = np.zeros(len(station))
    for s in np.unique(station):
        rows = np.flatnonzero(station == s)
        time[rows] = np.linspace(0.0, 1.0, len(rows))
    return time


def _noise(
    configuration: Configuration, seen: Floats, sizes: Sizes, noise: np.random.Generator
) -> Floats:
    """Return errors (n, 3) of the tracker at points (n, 3) in its frame, m."""
    factor = np.linalg.cholesky(noise_of(configuration.solver).covariance(seen))
    error = np.einsum("nij,nj->ni", factor, noise.standard_normal(seen.shape))
    beam = seen / np.linalg.norm(seen, axis=1)[:, None]
    along = np.einsum("ni,ni->n", error, beam)[:, None] * beam
    return np.asarray(along + sizes.get("axis noise", 1.0) * (error - along), dtype=np.float64)


DISTURBANCES: Final = Disturbances(LISTED, measure)
