"""What may spoil a laser-tracer calibration: the plan measured again, with one thing wrong."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.observations import Observation
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
from rotcal_ros.planning.plan import Plan

TANGENTIAL: Final = Disturbance(
    "tangential motion",
    "mount or cable shift the tracer along its circle, by so much times the cosine of twice the "
    "table's angle",
    "um", MICROMETRE, 0.1, 10.0,
)  # fmt: skip
SECTOR: Final = 0.4
"""Share of a station's beams that warm air or a person may reach."""


def _error_motion(configuration: Configuration) -> float:
    """Return the stated error motion (m, k = 1), none where it is left to the circle."""
    stated: float | None = configuration.solver.error_motion_std_m
    return 0.0 if stated is None else stated


def of_lengths(drift: float, knock: float, air: float) -> tuple[Disturbance, ...]:
    """Return what spoils lengths of a tracer on the table, wherever it stands.

    Worth a search from these sizes on: ``drift`` and ``knock`` in um, ``air`` in ppm (per metre).
    """
    return (
        Disturbance(
            "drift",
            "the origin of the machine drifts along x, y and z alike, linearly over the whole run",
            "um", MICROMETRE, drift, 100.0,
        ),
        Disturbance(
            "knock",
            "the tracer is shifted on the table, along x, y and z alike, half-way through the run",
            "um", MICROMETRE, knock, 100.0,
        ),
        Disturbance(
            "axis noise",
            "the machine's errors along z are so many times the stated ones",
            "times", 1.0, 1.5, 100.0, scatters=True,
        ),
        Disturbance(
            "refraction",
            "the index of the air changes with the height by so much per metre",
            "ppm/m", PPM, air, 1000.0,
        ),
        Disturbance(
            "one place",
            "two fifths of the beams of one station, all in one sector, are too long by so much",
            "um", MICROMETRE, 1.0, 100.0,
        ),
        Disturbance(
            "scale", "the tracer's lengths are too long by so much", "ppm", PPM, air, 1000.0
        ),
    )  # fmt: skip


def leaning_axis(largest: float) -> Disturbance:
    """Return the lean of the table's axis, up to ``largest`` arcsec."""
    what = "the table's axis leans by so much against the machine's z axis"
    return Disturbance("gauge", what, "arcsec", ARCSEC, 100.0, largest)


def shifted_along(turned: Floats, angle: Floats, sizes: Sizes) -> Floats:
    """Return by how much (n, 3), m, tracers at ``turned`` (n, 3) are shifted at an angle (n,)."""
    across = np.column_stack([-turned[:, 1], turned[:, 0], np.zeros(len(turned))])
    along = across * (np.cos(2.0 * angle) / np.hypot(*turned[:, :2].T))[:, None]
    return np.asarray(sizes.get(TANGENTIAL.effect, 0.0) * along, dtype=np.float64)


LISTED: Final = (
    *of_lengths(1.0, 0.3, 1.0),
    error_motion(0.1, 100.0, _error_motion),
    repeatability(0.3, 100.0),
    tilt(0.3, 100.0),
    leaning_axis(3600.0),
    TANGENTIAL,
)


@dataclass(frozen=True, eq=False)
class PlannedSteps:
    """The steps of a plan as arrays (n,): place of the tracer, table position, target, time."""

    place: Ints
    position: Ints
    target: Ints
    time: Floats


def measure(
    configuration: Configuration, plan: Plan, sizes: Sizes, seed: int
) -> DisturbedMeasurement:
    """Return what a perfect table's tracer reads, with the stated noise and effects of ``sizes``.

    The tracer stands where the simulation mounts it. True deviations are zero.
    """
    noise, other = streams(seed)
    stations = _stations(configuration, plan, sizes, (noise, other))
    observations = observed(configuration, plan, stations, sizes, (noise, other))
    return DisturbedMeasurement(observations, {"ECC": np.zeros(len(plan.table_angles))})


def observed(
    configuration: Configuration, plan: Plan, stations: Floats, sizes: Sizes, streams: Streams
) -> tuple[Observation, ...]:
    """Return what a tracer observes that is at ``stations`` (n, 3), m, at the steps of ``plan``.

    ``streams``: of the stated noise, and of what is beside it.
    """
    noise, other = streams
    steps = steps_of(plan)
    places = _reflector_places(configuration, plan, steps, sizes, noise)
    read = _readings(configuration, stations, places, sizes, noise)
    # a station is one place of the tracer at one table position
    station = steps.place * len(plan.steps) + steps.position
    read += _in_a_sector(stations, places, station, sizes, other)
    return tuple(
        step.observed((value,)) for step, value in zip(plan.steps, read.tolist(), strict=True)
    )


def _readings(
    configuration: Configuration,
    stations: Floats,
    places: Floats,
    sizes: Sizes,
    noise: np.random.Generator,
) -> Floats:
    """Return the lengths (n,) read from ``stations`` (n, 3) to reflectors at ``places`` (n, 3)."""
    solver = configuration.solver
    distance = np.linalg.norm(places - stations, axis=1)
    height = 0.5 * (places[:, 2] + stations[:, 2])
    optical = distance * (1.0 + sizes.get("scale", 0.0))
    optical = optical * (1.0 + sizes.get("refraction", 0.0) * (height - height.mean()))
    std = np.hypot(solver.length_std_m, solver.length_std_relative * distance)
    read = optical + std * noise.standard_normal(len(distance))
    return np.asarray(read - configuration.simulation.tracer.dead_distance_m)


def _in_a_sector(
    stations: Floats, places: Floats, arrival: Ints, sizes: Sizes, rng: np.random.Generator
) -> Floats:
    """Return by how much the lengths (n,) of one station are too long in one sector, m.

    ``arrival`` (n,): which station each length belongs to; one of them is drawn, and the middle of
    the sector, which holds SECTOR of its beams.
    """
    found, size = np.zeros(len(arrival)), sizes.get("one place", 0.0)
    if size:
        chosen = np.flatnonzero(arrival == rng.choice(np.unique(arrival)))
        beams, middle = places[chosen] - stations[chosen], rng.uniform(-np.pi, np.pi)
        away = np.abs(np.angle(np.exp(1j * (np.arctan2(beams[:, 1], beams[:, 0]) - middle))))
        found[chosen[np.argsort(away)[: round(SECTOR * len(chosen))]]] = size
    return found


def steps_of(plan: Plan) -> PlannedSteps:
    """Return the steps of a plan as arrays."""
    return PlannedSteps(
        place=np.array([step.station for step in plan.steps], dtype=np.int64),
        position=np.array([step.table_position for step in plan.steps], dtype=np.int64),
        target=np.array([step.target for step in plan.steps], dtype=np.int64),
        time=times(plan),
    )


def _stations(configuration: Configuration, plan: Plan, sizes: Sizes, streams: Streams) -> Floats:
    """Return where the tracer is at every step (n, 3), m."""
    noise, other = streams
    steps = steps_of(plan)
    m = len(plan.table_angles)
    arrived = arrival_errors(plan, sizes, other)
    lean = scatter_in_plane(m, sizes.get("tilt", 0.0), other)
    shift = scatter_in_plane(m, _error_motion(configuration), noise)
    shift += scatter_in_plane(m, sizes.get("error motion", 0.0), other)
    knock = sizes.get("knock", 0.0) * np.outer(steps.time >= 0.5, ALL_AXES)
    mount = np.array(configuration.simulation.tracer.mount_m) + knock
    turn = rotation_about_z(np.array(plan.table_angles)[steps.position] + arrived)
    turned = np.einsum("nij,nj->ni", turn, mount)
    at = steps.position
    leant = np.einsum("nij,nj->ni", rotation_from_vector(lean)[at], turned)
    angle = np.array(plan.table_angles)[at]
    shifted = leant + shift[at] + shifted_along(turned, angle, sizes)
    return np.asarray(shifted, dtype=np.float64)


def _reflector_places(
    configuration: Configuration,
    plan: Plan,
    steps: PlannedSteps,
    sizes: Sizes,
    noise: np.random.Generator,
) -> Floats:
    """Return where the reflector is at every step (n, 3) in the frame of the table's axis, m."""
    targets = np.array(plan.targets)
    error = configuration.solver.target_std_m * noise.standard_normal(targets.shape)
    error[:, 2] *= sizes.get("axis noise", 1.0)
    frame = rotation_from_vector(np.array([sizes.get("gauge", 0.0), 0.0, 0.0]))
    drift = sizes.get("drift", 0.0) * np.outer(steps.time, ALL_AXES)
    return np.asarray((targets + error)[steps.target] @ frame.T + drift, dtype=np.float64)


DISTURBANCES: Final = Disturbances(LISTED, measure)
