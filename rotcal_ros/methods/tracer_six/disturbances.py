"""What may spoil six deviations from lengths: the plan measured again, with one thing wrong."""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.geometry.rotations import rotation_about_z, rotation_from_vector
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.disturbance import (
    ALL_AXES,
    Disturbances,
    DisturbedMeasurement,
    Sizes,
    angle_numbers,
    arrivals,
    error_motion,
    repeatability,
    streams,
    table_deviations,
    tilt,
)
from rotcal_ros.methods.tracer.disturbances import (
    TANGENTIAL,
    leaning_axis,
    observed,
    of_lengths,
    shifted_along,
    steps_of,
)
from rotcal_ros.methods.tracer_six.plan import places_of
from rotcal_ros.planning.plan import Plan

LISTED: Final = (
    *of_lengths(0.3, 0.1, 0.3),
    error_motion(0.1, 10.0),
    repeatability(0.05, 10.0),
    tilt(0.1, 10.0),
    leaning_axis(2000.0),
    TANGENTIAL,
)


def measure(
    configuration: Configuration, plan: Plan, sizes: Sizes, seed: int
) -> DisturbedMeasurement:
    """Return what a tracer reads at its places, with the stated noise and effects of ``sizes``.

    The table has no deviations but those that ``sizes`` give it, which are true ones.
    """
    noise, other = streams(seed)
    true = table_deviations(len(plan.distinct_angles), sizes, other)
    stations = _stations(configuration, plan, sizes, true, other)
    observations = observed(configuration, plan, stations, sizes, (noise, other))
    return DisturbedMeasurement(observations, true)


def _stations(
    configuration: Configuration,
    plan: Plan,
    sizes: Sizes,
    true: dict[str, Floats],
    other: np.random.Generator,
) -> Floats:
    """Return where the tracer is at every step (n, 3), m, from the axis."""
    steps = steps_of(plan)
    mount = np.array(places_of(configuration.plan))[steps.place]
    mount = mount + sizes.get("knock", 0.0) * np.outer(steps.time >= 0.5, ALL_AXES)
    turn = rotation_about_z(np.array(plan.table_angles)[steps.position])
    turned = np.einsum("nij,nj->ni", turn, mount)
    angle = angle_numbers(plan)[steps.position]
    rotation = np.column_stack([true["EAC"], true["EBC"], true["ECC"]])[angle]
    scatter = other.standard_normal((len(plan.steps), 3))[arrivals(plan)]
    rotation = rotation + sizes.get("repeatability", 0.0) * scatter
    moved = np.einsum("nij,nj->ni", rotation_from_vector(rotation), turned)
    shift = np.column_stack([true["EXC"], true["EYC"], true["EZC"]])[angle]
    along = shifted_along(turned, np.array(plan.table_angles)[steps.position], sizes)
    return np.asarray(moved + shift + along, dtype=np.float64)


DISTURBANCES: Final = Disturbances(LISTED, measure)
