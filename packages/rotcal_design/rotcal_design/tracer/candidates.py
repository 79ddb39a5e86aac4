"""Which lengths can be measured: places in the volume, and what is in the way of the beams."""

from __future__ import annotations

from itertools import product
from math import prod
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from rotcal_design.settings import ANY, DIRECTION, PER_STATION, TracerDesignSettings
from rotcal_ros.foundation.arrays import Bools, Floats
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.geometry.rotations import positions_on_table
from rotcal_ros.methods.tracer.plan import require_beams, within_reach
from rotcal_ros.methods.tracer.policy.information import Lengths, Scene
from rotcal_ros.planning.table_angles import table_angles

MOST_PLACES: Final = 20_000
"""Places of the reflector beyond which a plan would take minutes and gigabytes."""
LEAST_POSITIONS: Final = 3
"""Positions of the table that a circle needs."""
LEAST_RADIUS: Final = 1e-3
"""Smallest radius of the tracer's circle, m."""


def make_scene(settings: TracerDesignSettings, targets: ArrayLike | None = None) -> Scene:
    """Return the scene: stations at the table angles, and the possible ``targets`` (n, 3), m.

    Without given ones, a lattice in the volume whose points keep ``spacing_m``. Boxes that the
    reflector has to keep out of are taken away. Raises PlanError when none is left, when there are
    too many, and for a tracer that the table does not carry round a circle.
    """
    angles = np.array(table_angles(settings))
    if len(angles) < LEAST_POSITIONS:
        raise PlanError(
            f"{len(angles)} table positions: a circle takes {LEAST_POSITIONS}, see table_positions"
        )
    if np.hypot(*settings.mount_m[:2]) < LEAST_RADIUS:
        raise PlanError(
            f"mount_m {list(settings.mount_m)} stands on the table's axis: a tracer that is not "
            "carried round a circle does not see the table turn; give its place beside the axis"
        )
    places = target_lattice(settings) if targets is None else np.asarray(targets, dtype=np.float64)
    for box in obstacle_boxes(settings):
        places = places[~((places > box[0]) & (places < box[1])).all(axis=1)]
    if not len(places):
        raise PlanError("no target is left in the volume: see volume_min_m, keep_out_m")
    return Scene(
        stations=positions_on_table(settings.mount_m, angles, settings.axis_m),
        table_angles=angles,
        targets=places,
        target_std=np.asarray(settings.target_std_m),
        length_std=settings.length_std_m,
        length_std_relative=settings.length_std_relative,
        circle_std=settings.circle_std_m,
        error_motion_std=settings.error_motion,
    )


def candidates(scene: Scene, settings: TracerDesignSettings) -> Lengths:
    """Return all pairs with a free beam, each with the segment it will be measured in.

    Raises PlanError for a station without enough of them.
    """
    m, n = len(scene.stations), len(scene.targets)
    position, target = (axis.ravel() for axis in np.indices((m, n)))
    start, apart = scene.stations[position], scene.targets[target] - scene.stations[position]
    distances = settings.min_distance_m, settings.max_distance_m
    free = within_reach(apart, distances, (settings.min_elevation_deg, settings.max_elevation_deg))
    azimuth = np.arctan2(apart[:, 1], apart[:, 0]) / DEGREE
    free &= ~_in_sectors(azimuth, settings.blocked_azimuth_deg)
    on_turning = azimuth - scene.table_angles[position] / DEGREE
    free &= ~_in_sectors(on_turning, settings.blocked_on_table_deg)
    beam = apart / np.linalg.norm(apart, axis=1)[:, None]
    free &= _accepted(scene.targets[target], beam, settings)
    for box in obstacle_boxes(settings):
        free &= ~beams_cross_box(start, apart, box)
    require_beams(
        position[free],
        scene.table_angles,
        "min_elevation_deg, keep_out_m (the tracer itself may stand in a box), "
        "blocked_azimuth_deg, blocked_on_table_deg, reflector_faces",
    )
    segment = position[free] if settings.zero == PER_STATION else 0
    return Lengths.of(position[free], target[free], segment)


def target_lattice(settings: TracerDesignSettings) -> Floats:
    """Return the points (n, 3) of a lattice that fills the volume, ``spacing_m`` or more apart.

    Raises PlanError when there are more than MOST_PLACES.
    """
    axes = []
    for low, high in zip(settings.volume_min_m, settings.volume_max_m, strict=True):
        steps = int((high - low) / settings.spacing_m + 1e-9)
        axes.append(np.linspace(low, high, steps + 1) if steps else [0.5 * (low + high)])
    if (count := prod(len(axis) for axis in axes)) > MOST_PLACES:
        raise PlanError(
            f"the volume has {count} places {settings.spacing_m:g} m apart, more than can be "
            f"looked at ({MOST_PLACES}): give a larger spacing_m or a smaller volume"
        )
    return np.array(list(product(*axes)), dtype=np.float64)


def obstacle_boxes(settings: TracerDesignSettings) -> Floats:
    """Return the boxes (b, 2, 3): smallest and largest corner, widened by the margin."""
    corners = np.array(settings.keep_out_m, dtype=np.float64).reshape(-1, 2, 3)
    return np.asarray(corners + settings.margin_m * np.array([-1.0, 1.0])[:, None])


def _in_sectors(angle_deg: Floats, sectors_deg: tuple[float, ...]) -> Bools:
    """Return which angles (k,) lie in one of the sectors, given as from, to, from, to, ..."""
    inside = np.zeros(len(angle_deg), dtype=np.bool_)
    for start, end in zip(sectors_deg[::2], sectors_deg[1::2], strict=True):
        inside |= np.mod(angle_deg - start, 360.0) <= np.mod(end - start, 360.0)
    return inside


def beams_cross_box(start: Floats, apart: Floats, box: Floats) -> Bools:
    """Return which beams, from ``start`` (k, 3) along ``apart`` (k, 3), meet the ``box`` (2, 3).

    The slabs of the box are met between two fractions of the beam; they have to overlap.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = (box[:, None] - start) / apart
    beside = (apart == 0.0) & ((start < box[0]) | (start > box[1]))
    within = (apart == 0.0) & ~beside
    near = np.where(within, -np.inf, ends.min(axis=0)).max(axis=1)
    far = np.where(within, np.inf, ends.max(axis=0)).min(axis=1)
    return np.asarray(
        (np.maximum(near, 0.0) <= np.minimum(far, 1.0)) & ~beside.any(axis=1), dtype=np.bool_
    )


def _accepted(targets: Floats, beam: Floats, settings: TracerDesignSettings) -> Bools:
    """Return where the reflector accepts the beam (k, 3), a unit vector from the tracer."""
    if settings.reflector_faces == ANY:
        return np.ones(len(beam), dtype=np.bool_)
    if settings.reflector_faces == DIRECTION:
        facing = np.tile(settings.reflector_direction, (len(beam), 1))
    else:
        facing = np.array([*settings.axis_m, settings.mount_m[2]]) - targets
    facing = facing / np.maximum(np.linalg.norm(facing, axis=1), 1e-9)[:, None]
    cosine = -(facing * beam).sum(axis=1)
    return np.asarray(cosine >= np.cos(settings.reflector_acceptance_deg * DEGREE))
