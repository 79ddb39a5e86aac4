"""What may spoil a ball plate calibration: the plan measured again, with one thing wrong."""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.units import ARCSEC, DEGREE, MICROMETRE
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
    angle_numbers,
    arrival_errors,
    error_motion,
    repeatability,
    streams,
    table_deviations,
    tilt,
    times,
)
from rotcal_ros.planning.plan import Plan

USUAL_STD: Final = 5e-8
"""Standard deviation (m) of a centre along each axis where the configuration states none."""
PLATE_STD: Final = 5e-6
MACHINE_STD: Final = 5e-7
"""How far (m) balls are from their places, and the machine's systematic error; both are solved."""
OFF_CENTRE: Final = 0.5
"""Metres that the plate stands off centre per radian that the axis leans."""

LISTED: Final = (
    Disturbance(
        "drift",
        "the origin of the machine drifts along x, y and z alike, linearly over the whole run",
        "um", MICROMETRE, 0.05, 100.0,
    ),
    Disturbance(
        "knock",
        "half-way through the run the plate is shifted by so much, along x, y and z alike, and "
        "turned by as much at its circle",
        "um", MICROMETRE, 0.05, 100.0,
    ),
    Disturbance(
        "axis noise",
        "the centres scatter along z so many times as much as along x and y",
        "times", 1.0, 1.5, 100.0, scatters=True,
    ),
    error_motion(0.1, 10.0),
    repeatability(0.02, 10.0),
    Disturbance(
        "refraction", "there is no beam: nothing happens", "ppm/m", PPM, 1000.0, 1000.0
    ),
    Disturbance(
        "scale", "the machine's x scale is too long by so much", "ppm", PPM, 1.0, 100.0
    ),
    tilt(0.1, 10.0),
    Disturbance(
        "gauge",
        "the axis leans by so much against the machine's z axis, and the plate is off centre by "
        "2.4 um for each arcsec",
        "arcsec", ARCSEC, 10.0, 2000.0,
    ),
    Disturbance(
        "growth",
        "the plate warms and grows from its centre by so much, linearly over the whole run",
        "um/m", PPM, 0.1, 100.0,
    ),
    Disturbance(
        "one place",
        "at one table position a quarter of the balls, neighbours, are displaced by so much "
        "together, along x, y and z alike",
        "um", MICROMETRE, 0.05, 10.0,
    ),
)  # fmt: skip


def measure(
    configuration: Configuration, plan: Plan, sizes: Sizes, seed: int
) -> DisturbedMeasurement:
    """Return the ball centres that a machine finds, with noise and the effects of ``sizes``.

    The table has no deviations but those that ``sizes`` give it, which are true ones.
    """
    noise, other = streams(seed)
    true = table_deviations(len(plan.distinct_angles), sizes, other)
    position = angle_numbers(plan)[[step.table_position for step in plan.steps]]
    place = np.array([step.position for step in plan.steps])
    centres = _true_centres(configuration, plan, position, sizes, true, (noise, other))
    centres = centres + np.array(configuration.plan.centre_m) + _machine_error(place, noise)
    centres[:, 0] *= 1.0 + sizes.get("scale", 0.0)
    centres += sizes.get("drift", 0.0) * np.outer(times(plan), ALL_AXES)
    centres += sizes.get("one place", 0.0) * np.outer(_in_one_place(plan), ALL_AXES)
    std = np.broadcast_to(configuration.solver.sigma_centre_m or USUAL_STD, 3).copy()
    std[2] *= sizes.get("axis noise", 1.0)
    centres += std * noise.standard_normal(centres.shape)
    observations = tuple(
        step.observed((x, y, z))
        for step, (x, y, z) in zip(plan.steps, centres.tolist(), strict=True)
    )
    return DisturbedMeasurement(observations, true)


def _in_one_place(plan: Plan) -> Bools:
    """Return which steps (n,) are a quarter of the balls, neighbours, at a middle position."""
    position = np.array([step.table_position for step in plan.steps])
    ball = np.array([step.target for step in plan.steps])
    balls = np.unique(ball)
    some = balls[: max(len(balls) // 4, 2)]
    here = position == len(plan.table_angles) // 3
    return np.asarray(here & np.isin(ball, some))


def _true_centres(
    configuration: Configuration,
    plan: Plan,
    position: Ints,
    sizes: Sizes,
    true: dict[str, Floats],
    streams: Streams,
) -> Floats:
    """Return where the balls are at every step (n, 3), m, from the axis."""
    noise, other = streams
    settings = configuration.plan
    off = sizes.get("gauge", 0.0)
    plate = settings.plate.places + PLATE_STD * noise.standard_normal((settings.plate.grid, 3))
    plate = plate + OFF_CENTRE * off * np.array([1.0, 0.0, 0.0])
    balls = plate[[step.target for step in plan.steps]]
    balls = balls * (1.0 + sizes.get("growth", 0.0) * times(plan))[:, None]
    knock = sizes.get("knock", 0.0) * ALL_AXES
    after = times(plan) >= 0.5
    turned = balls @ rotation_from_vector(knock / settings.plate.circle_radius_m).T + knock
    balls = np.where(after[:, None], turned, balls)
    angle = np.array([step.table_angle for step in plan.steps]) - settings.table_start_deg * DEGREE
    angle = angle + arrival_errors(plan, sizes, other)
    balls = np.einsum("nij,nj->ni", rotation_about_z(angle), balls)
    lean = np.column_stack([true["EAC"], true["EBC"], true["ECC"]])[position]
    balls = np.einsum("nij,nj->ni", rotation_from_vector(lean), balls)
    balls = balls + np.column_stack([true["EXC"], true["EYC"], true["EZC"]])[position]
    return np.asarray(balls @ rotation_from_vector(np.array([off, 0.0, 0.0])).T)


def _machine_error(place: Floats, noise: np.random.Generator) -> Floats:
    """Return the machine's systematic error (n, 3), m: the same whenever it is at a place."""
    _, which = np.unique(np.round(place, 6), axis=0, return_inverse=True)
    which = which.ravel()
    errors = MACHINE_STD * noise.standard_normal((int(which.max()) + 1, 3))
    return np.asarray(errors[which], dtype=np.float64)


DISTURBANCES: Final = Disturbances(LISTED, measure)
