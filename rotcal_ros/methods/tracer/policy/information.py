"""What lengths determine of the table's angles: covariance, and the gain of each candidate.

A plan starts from a :class:`Scene`: stations, possible targets, how well all is known. A *length*
is a pair of table position and target, measured within a segment: as long as the beam is not
broken, all lengths share one unknown zero.

The linear model of the joint network (:mod:`rotcal_ros.methods.tracer.solver.posed`) at the
nominal geometry: unknown are the stations (3 m), a zero per segment (q), and the targets with the
machine's prior. A length moves with u (dP - dA) - dz; with weights w and variances v its
information is

    F(w) = sum w g g' / v + prior,     g = (h, -u),   h = u at its station, -1 at its zero

Targets are eliminated one by one (Schur complement), which leaves M of 3 m + q unknowns. The
angles are t = G dP. By Sherman and Morrison a further length lowers the mean variance of the
angles by |G a|^2 / (m (v + s)), with a = F^-1 g and s = g' F^-1 g; the derivative by its weight is
the same without s. Exact to first order; nothing depends on the readings, for the model is linear.

A tracer and its mirror image in the plane of its targets are equally far from all of them: no
length distinguishes the two. So the targets of a station need some depth
(:class:`Spread`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve

from rotcal_ros.adjust.distributions import normal_isf
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.methods.tracer.settings import TracerLimits
from rotcal_ros.methods.tracer.solver.circle import (
    TableMotion,
    bearing_slopes,
    circle_contrasts,
    table_motion,
)
from rotcal_ros.methods.tracer.solver.problem import TracerProblem

Which: TypeAlias = Ints | Bools | slice | list[int]
"""Some of the lengths, by index or mask."""
LEAST_DEPTH: Final = 0.1
"""Least depth of a station's targets across the plane they lie nearest to, over their extent."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Where the tracer will stand, where the reflector may go, and the noise of both.

    ``stations`` (m, 3): nominal places of the tracer at ``table_angles`` (m,), rad, in the
    machine's frame, m. ``targets`` (n, 3): possible places of the reflector, m; ``target_std``:
    their standard deviation, one number, (3,) or (n, 3), m; zero for targets that are known.
    ``length_std`` (m) and ``length_std_relative`` (m/m) of one length join in squares.

    ``circle_std``: standard deviation (m) by which stations leave one circle, radially and along
    the axis; the circle itself is unknown. None: nothing is said about it.
    ``error_motion_std`` (m): the table's own radial error motion, which no length can separate
    from the angle; it joins the predicted covariance. None: the solver estimates it, and nothing
    is predicted of it.

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
        turning = self.turning.reshape(len(self.turning), -1, 3) @ self.motion.plane.basis().T
        felt = (self.error_motion_std or 0.0) * turning.reshape(len(turning), -1)
        return np.asarray(felt @ felt.T, dtype=np.float64)

    def beams(self, position: Ints, target: Ints) -> tuple[Floats, Floats]:
        """Return unit vectors (k, 3) from targets to stations and variances (k,) of lengths."""
        apart = self.stations[position] - self.targets[target]
        distance = np.sqrt((apart**2).sum(axis=1))
        variance = self.length_std**2 + (self.length_std_relative * distance) ** 2
        return apart / distance[:, None], variance

    def circle_information(self) -> Floats:
        """Return what the circle determines of the stations that stand on it, (3 m, 3 m), 1/m^2.

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


NOMINAL_STD: Final = 0.02
"""How well (m) stations and zeros are known before anything is measured. It keeps every inverse
finite, and is so wide beside micrometres that it adds no knowledge (1e-9 of a variance)."""


@dataclass(frozen=True, eq=False)
class Beams:
    """What k lengths feel of the unknowns.

    ``angles`` (k, m): G F^-1 g in rad/m, zero-mean over the angles. ``spread`` (k,): g' F^-1 g,
    the variance of the computed length, m^2. ``variance`` (k,): that of the measured one, m^2.
    """

    angles: Floats
    spread: Floats
    variance: Floats

    @property
    def power(self) -> Floats:
        """Mean square (k,) over the angles, (rad/m)^2."""
        return np.asarray((self.angles**2).mean(axis=1), dtype=np.float64)


class _Felt(NamedTuple):
    rows: Floats
    unit: Floats
    own: Floats


class Information:
    """What ``lengths`` determine in a ``scene``; ``segments`` is the number of zeros (q).

    Nothing here changes: :meth:`with_lengths` and :meth:`without` return another one.
    """

    def __init__(self, scene: Scene, lengths: Lengths, segments: int) -> None:
        self.scene, self.lengths, self.segments = scene, lengths, segments
        m = len(scene.stations)
        touched, inverse = np.unique(lengths.target, return_inverse=True)
        own = np.asarray(inverse, dtype=np.int64)
        unit, variance = scene.beams(lengths.position, lengths.target)
        weight = lengths.weight / variance
        size = 3 * m + segments
        rows = np.zeros((len(lengths), size))
        each = np.arange(len(lengths))
        rows[each[:, None], 3 * lengths.position[:, None] + np.arange(3)] = unit
        rows[each, 3 * m + lengths.segment] = -1.0
        weighted = rows * weight[:, None]
        normal = rows.T @ weighted
        normal[: 3 * m, : 3 * m] += scene.circle_information()
        normal.flat[:: size + 1] += NOMINAL_STD**-2
        self._slot = np.full(len(scene.targets), -1)
        self._slot[touched] = np.arange(len(touched))
        self._own = _spread_of_targets(scene.target_std[touched], own, unit, weight)
        cross = _sums(-weighted[:, :, None] * unit[:, None], own, len(touched))
        self._transfer = cross @ self._own
        flat = self._transfer.swapaxes(1, 2).reshape(-1, size)
        normal -= flat.T @ cross.swapaxes(1, 2).reshape(-1, size)
        scale = 1.0 / np.sqrt(normal.diagonal())
        factor = cho_factor(normal * scale * scale[:, None], lower=True, check_finite=False)
        unscaled = cho_solve(factor, np.eye(size), check_finite=False)
        self.covariance = unscaled * scale * scale[:, None]
        """Covariance (3 m + q, 3 m + q) of stations and zeros, m^2."""

    def with_lengths(self, lengths: Lengths) -> Information:
        """Return what is known with further ``lengths``."""
        return Information(self.scene, self.lengths + lengths, self.segments)

    def without(self, which: Which) -> Information:
        """Return what is known without the lengths that the index ``which`` names."""
        kept = np.ones(len(self.lengths), dtype=np.bool_)
        kept[which] = False
        return Information(self.scene, self.lengths[kept], self.segments)

    @cached_property
    def angle_covariance(self) -> Floats:
        """Covariance (m, m) of the angles less their mean, rad^2, without error motion."""
        turn, n = self.scene.turning, self.scene.stations.size
        covariance = turn @ self.covariance[:n, :n] @ turn.T
        return np.asarray(0.5 * (covariance + covariance.T), dtype=np.float64)

    @property
    def mean_variance(self) -> float:
        """Mean variance of the angles less their mean, rad^2, without error motion: phi."""
        return float(np.trace(self.angle_covariance)) / len(self.scene.stations)

    def variances(self) -> Floats:
        """Return the variances (m,) of the angles less their mean, rad^2, with error motion."""
        motion = self.scene.error_motion_angles
        return np.asarray(np.diagonal(self.angle_covariance + motion), dtype=np.float64)

    @property
    def rms_std(self) -> float:
        """Root mean square of the standard deviations of the angles less their mean, rad."""
        return float(np.sqrt(self.variances().mean()))

    @property
    def redundancy(self) -> Floats:
        """Share (k,) of an error of each length that shows in the residuals."""
        beams = self.beams(self.lengths)
        return np.asarray(1.0 - beams.spread / beams.variance, dtype=np.float64)

    @cached_property
    def _responses(self) -> tuple[Floats, Floats, Floats, Floats]:
        """G K (m, d); for each touched target K W (d, 3), G K W (m, 3) and its block (3, 3)."""
        n = self.scene.stations.size
        turn = self.scene.turning @ self.covariance[:n]
        through = self.covariance @ self._transfer
        own = self._own + self._transfer.swapaxes(1, 2) @ through
        return turn, through, turn @ self._transfer, own

    def beams(self, lengths: Lengths) -> Beams:
        """Return what ``lengths`` feel of what is known here, in it or not.

        A few milliseconds for ten thousand of them.
        """
        turn, through, angles_of, own = self._responses
        m, place = len(self.scene.stations), lengths.position
        zero = 3 * m + lengths.segment
        unit, variance = self.scene.beams(place, lengths.target)
        by_station = np.ascontiguousarray(turn[:, : 3 * m].reshape(m, m, 3).transpose(1, 2, 0))
        angles = (unit[:, None] @ by_station[place])[:, 0] - turn.T[zero]
        blocks = _diagonal_blocks(self.covariance, m)
        between = self.covariance[zero[:, None], 3 * place[:, None] + np.arange(3)]
        spread = _quadratic(blocks[place], unit) - 2.0 * (unit * between).sum(axis=1)
        spread += self.covariance[zero, zero]
        fresh_std = self.scene.target_std[lengths.target]
        slot = self._slot[lengths.target]
        seen = np.flatnonzero(slot >= 0)
        spread += np.where(slot >= 0, 0.0, ((fresh_std * unit) ** 2).sum(axis=1))
        if len(seen):
            slot, u, z, p = slot[seen], unit[seen], zero[seen], place[seen]
            angles[seen] += (angles_of[slot] @ u[:, :, None])[:, :, 0]
            mixed = through[slot[:, None], 3 * p[:, None] + np.arange(3)]
            mixed = (u[:, :, None] * mixed).sum(axis=1) - through[slot, z]
            spread[seen] += 2.0 * (mixed * u).sum(axis=1) + _quadratic(own[slot], u)
        return Beams(angles, spread, variance)

    def between(self, first: Lengths, second: Lengths) -> Floats:
        """Return the covariance (k, l) of the computed lengths ``first`` and ``second``, m^2."""
        ours, theirs = self._felt(first), self._felt(second)
        covariance = ours.rows @ (self.covariance @ theirs.rows.T)
        a, b = np.nonzero(first.target[:, None] == second.target)
        by_target = np.einsum("ka,kab,kb->k", ours.unit[a], ours.own[a], theirs.unit[b])
        covariance[a, b] += by_target
        return np.asarray(covariance, dtype=np.float64)

    def _felt(self, lengths: Lengths) -> _Felt:
        """Return rows (k, 3 m + q) with the targets eliminated, and what targets have alone."""
        m, each = len(self.scene.stations), np.arange(len(lengths))
        unit, _ = self.scene.beams(lengths.position, lengths.target)
        rows = np.zeros((len(lengths), 3 * m + self.segments))
        rows[each[:, None], 3 * lengths.position[:, None] + np.arange(3)] = unit
        rows[each, 3 * m + lengths.segment] = -1.0
        slot = self._slot[lengths.target]
        seen = np.flatnonzero(slot >= 0)
        own = self.scene.target_std[lengths.target][:, :, None] ** 2 * np.eye(3)
        if len(seen):
            own[seen] = self._own[slot[seen]]
            rows[seen] += (self._transfer[slot[seen]] @ unit[seen][:, :, None])[:, :, 0]
        return _Felt(rows, unit, own)

    def gains(self, candidates: Lengths) -> Floats:
        """Return by how much one length at each of k ``candidates`` lowers phi, (k,) rad^2."""
        beams = self.beams(candidates)
        return np.asarray(beams.power / (beams.variance + beams.spread), dtype=np.float64)

    def slopes(self, candidates: Lengths) -> Floats:
        """Return - d phi / d weight (k,) of each candidate, rad^2: its gain for a tiny weight."""
        beams = self.beams(candidates)
        return np.asarray(beams.power / beams.variance, dtype=np.float64)


def _spread_of_targets(std: Floats, own: Ints, unit: Floats, weight: Floats) -> Floats:
    """Return the inverse target blocks (n, 3, 3), m^2; a known target (std 0) has none.

    S (1 + S U S)^-1 S with S the prior's standard deviations and U the sum of w u u'.
    """
    seen = _sums(unit[:, :, None] * (unit * weight[:, None])[:, None], own, len(std))
    inner = np.eye(3) + std[:, :, None] * seen * std[:, None]
    return np.asarray(std[:, :, None] * np.linalg.inv(inner) * std[:, None], dtype=np.float64)


def _sums(values: Floats, group: Ints, groups: int) -> Floats:
    """Return the sums of ``values`` (k, ...) by ``group`` (k,)."""
    order = np.argsort(group, kind="stable")
    starts = np.searchsorted(group[order], np.arange(groups))
    if not len(values):
        return np.zeros((groups, *values.shape[1:]))
    return np.asarray(np.add.reduceat(values[order], starts, axis=0), dtype=np.float64)


def _diagonal_blocks(covariance: Floats, m: int) -> Floats:
    whole = covariance[: 3 * m, : 3 * m].reshape(m, 3, m, 3)
    return np.asarray(whole[np.arange(m), :, np.arange(m)], dtype=np.float64)


def _quadratic(matrix: Floats, vector: Floats) -> Floats:
    return np.asarray(np.einsum("ka,kab,kb->k", vector, matrix, vector), dtype=np.float64)


def detectable_in_std(count: int, significance: float, power: float) -> float:
    """Return delta0: the two-sided limit shared among ``count`` lengths, plus that of power."""
    return normal_isf(0.5 * significance / count) + normal_isf(1.0 - power)
