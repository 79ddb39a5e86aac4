"""What may spoil six deviations from lengths: the plan measured again, with one thing wrong."""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.catalogue.configuration import Configuration
from rotcal_ros.catalogue.disturbance import (
    ALL_AXES,
    PPM,
    Disturbance,
    Disturbances,
    DisturbedMeasurement,
    Sizes,
    arrivals,
    streams,
)
from rotcal_ros.catalogue.tracer.disturbances import (
    Steps,
    readings,
    reflector_places,
    steps_of,
)
from rotcal_ros.catalogue.tracer_six.plan import places_of
from rotcal_ros.geometry.rotations import rotation_about_z, rotation_from_vector
from rotcal_ros.planning.plan import Plan
from rotcal_ros.units import ARCSEC, MICROMETRE

LISTED: Final = (
    Disturbance(
        "drift",
        "the origin of the machine drifts along x, y and z alike, linearly over the whole run",
        "um", MICROMETRE, 0.3, 100.0,
    ),
    Disturbance(
        "knock",
        "the tracer is shifted on the table, along x, y and z alike, half-way through the run",
        "um", MICROMETRE, 0.1, 100.0,
    ),
    Disturbance(
        "axis noise",
        "the machine's errors along z are so many times the stated ones",
        "times", 1.0, 1.5, 100.0, scatters=True,
    ),
    Disturbance(
        "error motion",
        "EXC and EYC scatter from position to position by so much (k = 1)",
        "um", MICROMETRE, 0.1, 10.0, scatters=True,
    ),
    Disturbance(
        "repeatability",
        "every arrival of the table is off by itself, by so much about x, y and z (k = 1)",
        "arcsec", ARCSEC, 0.05, 10.0, scatters=True,
    ),
    Disturbance(
        "refraction",
        "the index of the air changes with the height by so much per metre",
        "ppm/m", PPM, 0.3, 1000.0,
    ),
    Disturbance(
        "scale", "the tracer's lengths are too long by so much", "ppm", PPM, 0.3, 1000.0
    ),
    Disturbance(
        "tilt",
        "EAC and EBC scatter from position to position by so much (k = 1)",
        "arcsec", ARCSEC, 0.1, 10.0, scatters=True,
    ),
    Disturbance(
        "gauge",
        "the table's axis leans by so much against the machine's z axis",
        "arcsec", ARCSEC, 100.0, 2000.0,
    ),
)  # fmt: skip


def measure(
    configuration: Configuration, plan: Plan, sizes: Sizes, seed: int
) -> DisturbedMeasurement:
    """Return what a tracer reads at its places, with the stated noise and effects of ``sizes``.

    The table has no deviations but those that ``sizes`` give it, which are true ones.
    """
    noise, other = streams(seed)
    true = _deviations(len(plan.table_angles), sizes, other)
    steps = steps_of(plan)
    stations = _stations(configuration, plan, steps, sizes, true, other)
    places = reflector_places(configuration, plan, steps, sizes, noise)
    read = readings(configuration, stations, places, sizes, noise)
    observations = tuple(
        step.observed((value,)) for step, value in zip(plan.steps, read.tolist(), strict=True)
    )
    return DisturbedMeasurement(observations, true)


def _deviations(count: int, sizes: Sizes, other: np.random.Generator) -> dict[str, Floats]:
    """Return the true deviations (count,) of the table, m and rad."""
    motion = sizes.get("error motion", 0.0) * other.standard_normal((2, count))
    tilt = sizes.get("tilt", 0.0) * other.standard_normal((2, count))
    zero = np.zeros(count)
    return {
        "EXC": motion[0], "EYC": motion[1], "EZC": zero,
        "EAC": tilt[0], "EBC": tilt[1], "ECC": zero,
    }  # fmt: skip


def _stations(
    configuration: Configuration,
    plan: Plan,
    steps: Steps,
    sizes: Sizes,
    true: dict[str, Floats],
    other: np.random.Generator,
) -> Floats:
    """Return where the tracer is at every step (n, 3), m, from the axis."""
    place = np.array([step.station for step in plan.steps], dtype=np.int64)
    mount = np.array(places_of(configuration.plan))[place]
    mount = mount + sizes.get("knock", 0.0) * np.outer(steps.time >= 0.5, ALL_AXES)
    turn = rotation_about_z(np.array(plan.table_angles)[steps.position])
    turned = np.einsum("nij,nj->ni", turn, mount)
    rotation = np.column_stack([true["EAC"], true["EBC"], true["ECC"]])[steps.position]
    scatter = other.standard_normal((len(place), 3))[arrivals(plan)]
    rotation = rotation + sizes.get("repeatability", 0.0) * scatter
    moved = np.einsum("nij,nj->ni", rotation_from_vector(rotation), turned)
    shift = np.column_stack([true["EXC"], true["EYC"], true["EZC"]])[steps.position]
    return np.asarray(moved + shift, dtype=np.float64)


DISTURBANCES: Final = Disturbances(LISTED, measure)
