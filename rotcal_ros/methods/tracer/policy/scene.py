"""What a plan of a laser tracer starts from: stations, possible targets, how well all is known.

A *length* is a pair of table position and target, measured within a segment: as long as the beam
is not broken, all lengths share one unknown zero.

A tracer and its mirror image in the plane of its targets are equally far from all of them: no
length tells the one from the other. So the targets of a station need some depth
(:class:`Spread`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.methods.tracer.solver.circle import (
    TableMotion,
    bearing_slopes,
    circle_contrasts,
    table_motion,
)
from rotcal_ros.methods.tracer.solver.problem import TracerProblem
from rotcal_ros.methods.tracer.solver.uncertainty import error_motion_spread
from rotcal_ros.methods.tracer.solver_settings import TracerLimits

Which: TypeAlias = Ints | Bools | slice | list[int]
"""Some of the lengths, by index or mask."""
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
        return bearing_slopes(self.stations, self.motion).dense()

    @cached_property
    def turning(self) -> Floats:
        """Jacobian (m, 3 m) of the angles less their mean by the stations, rad/m."""
        return np.asarray(self.bearing - self.bearing.mean(axis=0), dtype=np.float64)

    @cached_property
    def error_motion_angles(self) -> Floats:
        """What the error motion adds to the covariance (m, m) of the zero-mean angles, rad^2."""
        motion = error_motion_spread(self.motion, self.error_motion_std or 0.0).dense()
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


def _floats(values: ArrayLike) -> Floats:
    return np.asarray(values, dtype=np.float64)


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


def _centred(scene: Scene) -> Floats:
    return np.asarray(scene.targets - scene.targets.mean(axis=0), dtype=np.float64)


def _depth(count: Floats, total: Floats, products: Floats) -> Floats:
    mean = total / np.maximum(count, 1.0)[:, None]  # a station may have none
    values = np.linalg.eigvalsh(products - total[:, :, None] * mean[:, None])
    tiny = np.finfo(np.float64).tiny
    shares = np.maximum(values[:, 0], 0.0) / np.maximum(values[:, 2], tiny)
    return np.asarray(np.sqrt(shares), dtype=np.float64)


def noisy_problem(
    scene: Scene, lengths: Lengths, *, one_zero: bool, seed: int, slip: float, limits: TracerLimits
) -> TracerProblem:
    """Return ``lengths`` with the stated noise as the solver would have to solve them.

    ``one_zero``: all of one unbroken beam, else each station with a zero of its own. ``slip``: a
    fringe (m) that may slip unseen, ``limits`` of the solver.
    """
    rng, ours = np.random.default_rng(seed), scene.targets[lengths.target]
    distance = np.linalg.norm(scene.stations[lengths.position] - ours, axis=1)
    std = np.hypot(scene.length_std, scene.length_std_relative * distance)
    moved = scene.target_std * rng.standard_normal(scene.targets.shape)
    return TracerProblem(
        position=lengths.position,
        target=lengths.target,
        length=distance + std * rng.standard_normal(len(std)),
        length_std=std,
        targets=scene.targets + moved,
        target_std=scene.target_std,
        table_angles=scene.table_angles,
        error_motion_std=scene.error_motion_std,
        circle_std=scene.circle_std,
        again=_earlier(lengths),
        start_stations=scene.stations,
        segment=lengths.segment if one_zero else None,
        slip=slip,
        settings=limits,
    )


def _earlier(lengths: Lengths) -> Ints:
    """Return how often the pair of each length (k,) stands before it."""
    pair = np.column_stack([lengths.position, lengths.target])
    same = (pair[:, None] == pair).all(axis=2)
    return np.asarray(np.tril(same, -1).sum(axis=1), dtype=np.int64)
