"""What a plan of a laser tracer starts from: stations, possible targets, how well all is known.

A *length* is a pair of table position and target, measured within a segment: as long as the beam
is not broken, all lengths share one unknown zero. Which lengths can be measured at all follows
from the volume and from what is in the way of the beams (:func:`candidates`).

A tracer and its mirror image in the plane of its targets are equally far from all of them: no
length tells the one from the other. So the targets of a station need some depth
(:class:`Spread`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from math import prod
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.methods.tracer.design.settings import (
    ANY,
    DIRECTION,
    PER_STATION,
    TracerDesignSettings,
)
from rotcal_ros.methods.tracer.solver.circle import (
    TableMotion,
    bearing_jacobian,
    circle_contrasts,
    table_motion,
)
from rotcal_ros.methods.tracer.solver.uncertainty import error_motion_covariance
from rotcal_ros.planning.table_angles import table_angles

Which: TypeAlias = Ints | Bools | slice | list[int]
"""Some of the lengths, by index or mask."""
MOST_PLACES: Final = 20_000
"""Places of the reflector beyond which a plan would take minutes and gigabytes."""
LEAST_POSITIONS: Final = 3
"""Of the table, for a circle."""
LEAST_RADIUS: Final = 1e-3
"""Of the tracer's circle, m."""
LEAST_DEPTH: Final = 0.1
"""Of the targets of a station, across the plane they lie nearest to, over their extent."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Where the tracer will stand, where the reflector may go, and the noise of both.

    ``stations`` (m, 3): nominal places of the tracer at ``table_angles`` (m,), rad, in the
    machine's frame, m. ``targets`` (n, 3): possible places of the reflector, m; ``target_std``:
    their standard deviation, one number, (3,) or (n, 3), m; zero for targets that are known.
    ``length_std`` (m) and ``length_std_relative`` (m/m) of one length join in squares.

    ``circle_std``: standard deviation (m) by which stations leave one circle, radially and along
    the axis; the circle itself is unknown. None: nothing is said about it.
    ``error_motion_std`` (m): the table's own radial error motion, which no length can tell from
    the angle; it joins the predicted covariance. None: the solver estimates it, and nothing is
    predicted of it.

    Raises PlanError where the shapes do not fit each other.
    """

    stations: Floats
    table_angles: Floats
    targets: Floats
    target_std: Floats
    length_std: float
    length_std_relative: float = 0.0
    circle_std: float | None = None
    error_motion_std: float | None = 0.0

    def __post_init__(self) -> None:
        """Bring everything to its shape."""
        stations, targets = _floats(self.stations), _floats(self.targets)
        angles = _floats(self.table_angles)
        if stations.shape != (len(angles), 3) or targets.ndim != 2 or targets.shape[1] != 3:
            raise PlanError(
                f"{stations.shape} stations, {angles.shape} table angles and {targets.shape} "
                "targets: expected (m, 3), (m,) and (n, 3)"
            )
        std = np.broadcast_to(_floats(self.target_std), targets.shape)
        values = {"stations": stations, "targets": targets, "table_angles": angles}
        for name, value in {**values, "target_std": std}.items():
            object.__setattr__(self, name, value)

    def with_targets(self, which: Which) -> Scene:
        """Return the scene with those targets only."""
        return replace(self, targets=self.targets[which], target_std=self.target_std[which])

    @cached_property
    def motion(self) -> TableMotion:
        """Plane and circle of the nominal stations."""
        return table_motion(self.stations, self.table_angles)

    @cached_property
    def bearing(self) -> Floats:
        """Jacobian (m, 3 m) of the table's angles by the stations, up to a common turn, rad/m."""
        return bearing_jacobian(self.stations, self.motion)

    @cached_property
    def turning(self) -> Floats:
        """Jacobian (m, 3 m) of the angles less their mean by the stations, rad/m."""
        return np.asarray(self.bearing - self.bearing.mean(axis=0), dtype=np.float64)

    @cached_property
    def error_motion_angles(self) -> Floats:
        """What the error motion adds to the covariance (m, m) of the zero-mean angles, rad^2."""
        motion = error_motion_covariance(self.motion, self.error_motion_std or 0.0)
        return np.asarray(self.turning @ motion @ self.turning.T, dtype=np.float64)

    def beams(self, position: Ints, target: Ints) -> tuple[Floats, Floats]:
        """Return unit vectors (k, 3) from targets to stations and variances (k,) of lengths."""
        apart = self.stations[position] - self.targets[target]
        distance = np.sqrt((apart**2).sum(axis=1))
        variance = self.length_std**2 + (self.length_std_relative * distance) ** 2
        return apart / distance[:, None], variance

    def circle_information(self) -> Floats:
        """Return what the circle tells of the stations that stand on it, (3 m, 3 m), 1/m^2.

        Centre, radius and axis of the circle are unknown: m - 3 contrasts of the radial and as
        many of the axial distances remain.
        """
        if self.circle_std is None:
            return np.zeros((self.stations.size, self.stations.size))
        rows = circle_contrasts(self.stations).slope / self.circle_std
        return np.asarray(rows.T @ rows, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Lengths:
    """k lengths: table ``position`` (k,), ``target`` (k,) and ``segment`` (k,), all from 0.

    The same pair may come more than once. ``weight`` (k,): how many times each is measured, which
    may be a fraction in an ideal plan.
    """

    position: Ints
    target: Ints
    segment: Ints
    weight: Floats

    @classmethod
    def of(
        cls,
        position: ArrayLike,
        target: ArrayLike,
        segment: ArrayLike = 0,
        weight: ArrayLike = 1.0,
    ) -> Lengths:
        """Return the lengths of these pairs; ``segment`` and ``weight`` may be one number.

        A zero per station is ``segment=position``.
        """
        place = np.atleast_1d(np.asarray(position, dtype=np.int64))
        shape = place.shape
        return cls(
            place,
            np.broadcast_to(np.asarray(target, dtype=np.int64), shape),
            np.broadcast_to(np.asarray(segment, dtype=np.int64), shape),
            np.broadcast_to(np.asarray(weight, dtype=np.float64), shape),
        )

    def __len__(self) -> int:
        return len(self.position)

    def __add__(self, other: Lengths) -> Lengths:
        mine, theirs = vars(self), vars(other)
        return Lengths(**{name: np.concatenate([mine[name], theirs[name]]) for name in mine})

    def __getitem__(self, which: Which) -> Lengths:
        return Lengths(**{name: values[which] for name, values in vars(self).items()})

    def weighing(self, weight: ArrayLike) -> Lengths:
        """Return the same pairs with other weights."""
        return Lengths.of(self.position, self.target, self.segment, weight)


def on_table(mount: ArrayLike, table_angles: ArrayLike, centre: ArrayLike = (0.0, 0.0)) -> Floats:
    """Return the stations (m, 3) of a tracer that stands at ``mount`` (3,) in the table's frame.

    ``centre`` (2,): where the table's axis meets the xy-plane of the machine; metres and radians.
    """
    angle = _floats(table_angles)
    x, y, z = _floats(mount)
    x0, y0 = _floats(centre)
    cos, sin = np.cos(angle), np.sin(angle)
    stations = [x0 + cos * x - sin * y, y0 + sin * x + cos * y, np.full_like(angle, z)]
    return np.column_stack(stations)


def _floats(values: ArrayLike) -> Floats:
    return np.asarray(values, dtype=np.float64)


def scene_of(settings: TracerDesignSettings, targets: ArrayLike | None = None) -> Scene:
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
            "carried round a circle does not see the table turn"
        )
    places = lattice(settings) if targets is None else np.asarray(targets, dtype=np.float64)
    for box in boxes(settings):
        places = places[~((places > box[0]) & (places < box[1])).all(axis=1)]
    if not len(places):
        raise PlanError("no target is left in the volume: see volume_min_m, keep_out_m")
    return Scene(
        stations=on_table(settings.mount_m, angles, settings.axis_m),
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
    distance = np.linalg.norm(apart, axis=1)
    free = (distance >= settings.min_distance_m) & (distance <= settings.max_distance_m)
    elevation = np.arcsin(np.clip(apart[:, 2] / np.maximum(distance, 1e-9), -1.0, 1.0)) / DEGREE
    free &= (elevation >= settings.min_elevation_deg) & (elevation <= settings.max_elevation_deg)
    azimuth = np.arctan2(apart[:, 1], apart[:, 0]) / DEGREE
    free &= ~_in_sectors(azimuth, settings.blocked_azimuth_deg)
    on_turning = azimuth - scene.table_angles[position] / DEGREE
    free &= ~_in_sectors(on_turning, settings.blocked_on_table_deg)
    free &= _accepted(scene.targets[target], apart / distance[:, None], settings)
    for box in boxes(settings):
        free &= ~crosses(start, apart, box)
    few = np.flatnonzero(np.bincount(position[free], minlength=m) < 4)
    if len(few):
        raise PlanError(
            f"station {few[0]} at {scene.table_angles[few[0]] / DEGREE:g} deg has fewer than 4 "
            "targets with a free beam: see min_elevation_deg, keep_out_m (the tracer itself may "
            "stand in a box), blocked_azimuth_deg, blocked_on_table_deg, reflector_faces"
        )
    segment = position[free] if settings.zero == PER_STATION else 0
    return Lengths.of(position[free], target[free], segment)


def lattice(settings: TracerDesignSettings) -> Floats:
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


def boxes(settings: TracerDesignSettings) -> Floats:
    """Return the boxes (b, 2, 3): smallest and largest corner, widened by the margin."""
    corners = np.array(settings.keep_out_m, dtype=np.float64).reshape(-1, 2, 3)
    return np.asarray(corners + settings.margin_m * np.array([-1.0, 1.0])[:, None])


def _in_sectors(angle_deg: Floats, sectors_deg: tuple[float, ...]) -> Bools:
    """Return which angles (k,) lie in one of the sectors, given as from, to, from, to, ..."""
    inside = np.zeros(len(angle_deg), dtype=np.bool_)
    for start, end in zip(sectors_deg[::2], sectors_deg[1::2], strict=True):
        inside |= np.mod(angle_deg - start, 360.0) <= np.mod(end - start, 360.0)
    return inside


def crosses(start: Floats, apart: Floats, box: Floats) -> Bools:
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


@dataclass(frozen=True, eq=False)
class Spread:
    """Targets by station: ``count`` (m,), ``total`` (m, 3) in m and ``products`` (m, 3, 3)."""

    count: Floats
    total: Floats
    products: Floats

    @classmethod
    def of(cls, scene: Scene, lengths: Lengths) -> Spread:
        """Return the targets that each station of ``scene`` sees with the ``lengths``."""
        targets = _centred(scene)[lengths.target]
        at = (lengths.position == np.arange(len(scene.stations))[:, None]).astype(np.float64)
        products = (at[:, :, None] * targets).swapaxes(1, 2) @ targets
        return cls(at.sum(axis=1), at @ targets, products)

    @property
    def depth(self) -> Floats:
        """Depth (m,) at each station, 0 to 1; 0 of targets in a plane."""
        return _depth(self.count, self.total, self.products)

    def depth_after(self, scene: Scene, lengths: Lengths, sign: float) -> Floats:
        """Return the depth (k,) at its station after each of k changes by itself.

        ``sign``: 1 where one of the ``lengths`` comes, -1 where one goes.
        """
        targets, at = _centred(scene)[lengths.target], lengths.position
        squares = targets[:, :, None] * targets[:, None]
        return _depth(
            self.count[at] + sign,
            self.total[at] + sign * targets,
            self.products[at] + sign * squares,
        )


def least_depth(scene: Scene, lengths: Lengths) -> float:
    """Return the smallest depth of the targets of any station."""
    return float(Spread.of(scene, lengths).depth.min())


def flat_stations(scene: Scene, lengths: Lengths, least: float = LEAST_DEPTH) -> Ints:
    """Return the stations whose targets are less than ``least`` deep."""
    return np.flatnonzero(Spread.of(scene, lengths).depth < least)


def _centred(scene: Scene) -> Floats:
    return np.asarray(scene.targets - scene.targets.mean(axis=0), dtype=np.float64)


def _depth(count: Floats, total: Floats, products: Floats) -> Floats:
    mean = total / np.maximum(count, 1.0)[:, None]  # a station may have none
    values = np.linalg.eigvalsh(products - total[:, :, None] * mean[:, None])
    tiny = np.finfo(np.float64).tiny
    shares = np.maximum(values[:, 0], 0.0) / np.maximum(values[:, 2], tiny)
    return np.asarray(np.sqrt(shares), dtype=np.float64)
