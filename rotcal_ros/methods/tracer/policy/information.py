"""What lengths determine of the table's angles: covariance, and the gain of each candidate.

A plan starts from a :class:`Scene`: stations, possible targets, how well all is known. A *length*
is a pair of table position and target, measured within a segment: as long as the beam is not
broken, all lengths share one unknown zero.

All of it is the solver's: its lengths and what it knows of targets and axis
(:mod:`rotcal_ros.methods.tracer.solver.posed`) at the nominal geometry, and the engine's kernel.
So what a plan promises is what a result states whose noise is as planned. With the rows g of the
lengths, their weights w and variances v

    F(w) = sum w g g' / v + what is known beforehand

By Sherman and Morrison a further length lowers the mean variance of the angles t = C x by
|C a|^2 / (m (v + s)), with a = F^-1 g and s = g' F^-1 g; the derivative by its weight is the same
without s. Exact to first order; nothing depends on the readings, for the model is linear.

A tracer and its mirror image in the plane of its targets are equally far from all of them: no
length distinguishes the two. So the targets of a station need some depth
(:class:`Spread`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array, diags, vstack

from rotcal_ros.adjust.bordered import Groups, SparseDesign
from rotcal_ros.adjust.distributions import normal_isf
from rotcal_ros.adjust.kernels import DenseKernel
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.methods.tracer.settings import TracerLimits
from rotcal_ros.methods.tracer.solver.carried_lengths import CarriedLengths
from rotcal_ros.methods.tracer.solver.circle import bearing_slopes, table_motion
from rotcal_ros.methods.tracer.solver.posed import (
    axis_knowledge,
    carrying_axis,
    outward_direction,
    target_knowledge,
)
from rotcal_ros.methods.tracer.solver.problem import TracerProblem

Which: TypeAlias = Ints | Bools | slice | list[int]
"""Some of the lengths, by index or mask."""
NOMINAL_STD: Final = 0.02
"""How well (m) stations and zeros are known before anything is measured. It keeps every inverse
finite, and is so wide beside micrometres that it adds no knowledge (1e-9 of a variance)."""
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
    def error_motion_angles(self) -> Floats:
        """What the error motion adds to the covariance (m, m) of the zero-mean angles, rad^2.

        Of exact lengths it is all.
        """
        motion = table_motion(self.stations, self.table_angles)
        bearing = bearing_slopes(self.stations, motion)[:]
        turning = (bearing - bearing.mean(axis=0)).reshape(len(bearing), -1, 3)
        felt = (self.error_motion_std or 0.0) * turning @ motion.plane.basis().T
        felt = felt.reshape(len(felt), -1)
        return np.asarray(felt @ felt.T, dtype=np.float64)

    @cached_property
    def _carriage(self) -> tuple[Floats, Floats, Floats]:
        return carrying_axis(self.stations, self.table_angles)

    def posed(self, lengths: Lengths, segments: int) -> CarriedLengths:
        """Return ``lengths`` with so many zeros as the solver has them, to all targets."""
        axes, place, origin = self._carriage
        none, every = np.zeros(0), np.arange(len(lengths))
        return CarriedLengths(
            observed=none, std=none, position=lengths.position, place=np.zeros_like(every),
            target=lengths.target, zero=lengths.segment, row=every, order=every,
            station=lengths.position, angles=self.table_angles, places=place[None],
            targets=self.targets, zeros=np.zeros(segments), axes=axes, origin=origin,
            place_ways=outward_direction(place),
            more={"frame": 2} | ({} if self.circle_std is None else {"lean": 3}),
        )  # fmt: skip

    @cached_property
    def _known(self) -> dict[int, csr_array]:
        return {}

    def known(self, segments: int) -> csr_array:
        """Return what is known beforehand, over its standard deviation; the targets come last."""
        if segments not in self._known:
            empty, motion = self.posed(Lengths.of([], []), segments), self.error_motion_std
            if motion is None:
                motion = self.circle_std or 0.0
            _, across, along = axis_knowledge(empty, motion, self.circle_std)
            nominal = np.full(empty.size, 1.0 / NOMINAL_STD)
            turn = empty.first["turn"]
            nominal[turn : turn + empty.blocks["turn"]] *= np.linalg.norm(empty.places)
            target = empty.first["target"] + np.arange(self.targets.size)
            held = np.delete(np.arange(empty.size), target)
            entries = nominal[held], held, np.arange(len(held) + 1)
            stated = [across, *along, *target_knowledge(empty, self.target_std, free=False)]
            parts = [diags(1.0 / each.std) @ each.rows for each in stated]
            first = csr_array(entries, shape=(len(held), empty.size))
            self._known[segments] = csr_array(vstack([first, *parts], format="csr"))
        return self._known[segments]

    def beams(self, position: Ints, target: Ints) -> tuple[Floats, Floats]:
        """Return unit vectors (k, 3) from targets to stations and variances (k,) of lengths."""
        apart = self.stations[position] - self.targets[target]
        distance = np.sqrt((apart**2).sum(axis=1))
        variance = self.length_std**2 + (self.length_std_relative * distance) ** 2
        return apart / distance[:, None], variance


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


@dataclass(frozen=True, eq=False)
class Beams:
    """What k lengths do to what is known, and how noisy they are.

    ``angles`` (k, m): C F^-1 g in rad/m, zero-mean over the angles. ``variance`` (k,), m^2.
    """

    angles: Floats
    variance: Floats

    @property
    def power(self) -> Floats:
        """Mean square (k,) over the angles, (rad/m)^2."""
        return np.asarray((self.angles**2).mean(axis=1), dtype=np.float64)


class Information:
    """What ``lengths`` determine in a ``scene``; ``segments`` is the number of zeros (q).

    Nothing here changes: :meth:`with_lengths` and :meth:`without` return another one.
    """

    def __init__(self, scene: Scene, lengths: Lengths, segments: int) -> None:
        self.scene, self.lengths, self.segments = scene, lengths, segments
        known, n = scene.known(segments), len(scene.targets)
        touched = np.unique(lengths.target)
        last, first = known.shape[0] - 3 * n, scene.posed(lengths[[]], segments).first
        target = first["target"] + (3 * touched[:, None] + np.arange(3)).ravel()
        left = np.delete(np.arange(known.shape[1]), first["target"] + np.arange(3 * n))
        self._fresh = np.ones(n, dtype=np.bool_)
        """Which targets (n,) no length touches: their errors are as large as they are stated."""
        self._fresh[touched] = False
        self._unknown = np.sort(np.append(left, target))
        stated = last + (n * np.arange(3)[:, None] + touched).ravel()
        known = known[np.append(np.arange(last), stated)][:, self._unknown]
        rows, variance = self._rows(lengths)
        rows = diags(np.sqrt(lengths.weight / variance)) @ rows
        few = csr_array(vstack([rows, known], format="csr"))
        shared = np.searchsorted(self._unknown, left)
        design = SparseDesign(few, np.zeros((0, few.shape[1])), groups=Groups.of(few, shared))
        self._kernel = design.kernel() or DenseKernel.of(design, np.zeros(0, dtype=np.int64))
        turn = np.searchsorted(self._unknown, first["turn"])
        outputs = np.zeros((len(scene.stations), len(self._unknown)))
        m = len(outputs)
        outputs[:, turn : turn + m] = np.eye(m) - 1.0 / m
        self._outputs, self._moved = outputs, self._kernel.times(outputs.T)
        self.covariance: Floats = outputs @ self._moved
        """Covariance (m, m) of the angles less their mean, rad^2, error motion included."""

    def _rows(self, lengths: Lengths) -> tuple[csr_array, Floats]:
        """Return what ``lengths`` feel of the unknowns here (k, p), and their variances (k,)."""
        posed = self.scene.posed(lengths, self.segments)
        rows = posed.computed(np.zeros(posed.size))[1][:, self._unknown]
        return rows, self.scene.beams(lengths.position, lengths.target)[1]

    def with_lengths(self, lengths: Lengths) -> Information:
        """Return what is known with further ``lengths``."""
        return Information(self.scene, self.lengths + lengths, self.segments)

    def without(self, which: Which) -> Information:
        """Return what is known without the lengths that the index ``which`` names."""
        kept = np.ones(len(self.lengths), dtype=np.bool_)
        kept[which] = False
        return Information(self.scene, self.lengths[kept], self.segments)

    @property
    def mean_variance(self) -> float:
        """Mean variance of the angles less their mean, rad^2: phi."""
        return float(np.trace(self.covariance)) / len(self.covariance)

    def variances(self) -> Floats:
        """Return the variances (m,) of the angles less their mean, rad^2."""
        return np.array(self.covariance.diagonal())

    @property
    def rms_std(self) -> float:
        """Root mean square of the standard deviations of the angles less their mean, rad."""
        return float(np.sqrt(self.mean_variance))

    @property
    def redundancy(self) -> Floats:
        """Share (k,) of an error of each length that shows in the residuals."""
        leverage = self._kernel.leverage[: len(self.lengths)]
        return np.asarray(1.0 - leverage / self.lengths.weight, dtype=np.float64)

    def beams(self, lengths: Lengths) -> Beams:
        """Return what ``lengths``, in it or not, do to what is known here."""
        rows, variance = self._rows(lengths)
        return Beams(np.asarray(rows @ self._moved), variance)

    @cached_property
    def _inverse(self) -> Floats:
        return self._kernel.times(np.eye(len(self._unknown)))

    def spread(self, lengths: Lengths) -> Floats:
        """Return g' F^-1 g (k,), the variance of each computed length, m^2."""
        rows, _ = self._rows(lengths)
        found = np.asarray(rows.multiply(rows @ self._inverse).sum(axis=1)).ravel()
        unit, _ = self.scene.beams(lengths.position, lengths.target)
        own = ((unit * self.scene.target_std[lengths.target]) ** 2).sum(axis=1)
        return np.asarray(found + own * self._fresh[lengths.target], dtype=np.float64)

    def between(self, first: Lengths, second: Lengths) -> Floats:
        """Return the covariance (k, l) of the computed lengths ``first`` and ``second``, m^2."""
        (ours, _), (theirs, _) = self._rows(first), self._rows(second)
        found = np.asarray(theirs @ (ours @ self._inverse).T).T
        alike = first.target[:, None] == second.target
        a, b = np.nonzero(alike & self._fresh[second.target])
        unit, other = (self.scene.beams(e.position, e.target)[0] for e in (first, second))
        std = self.scene.target_std[first.target[a]]
        found[a, b] += (std**2 * unit[a] * other[b]).sum(axis=1)
        return np.asarray(found, dtype=np.float64)

    def gains(self, candidates: Lengths) -> Floats:
        """Return by how much one length at each of k ``candidates`` lowers phi, (k,) rad^2."""
        beams = self.beams(candidates)
        gains = beams.power / (beams.variance + self.spread(candidates))
        return np.asarray(gains, dtype=np.float64)

    def slopes(self, candidates: Lengths) -> Floats:
        """Return - d phi / d weight (k,) of each candidate, rad^2: its gain for a tiny weight."""
        beams = self.beams(candidates)
        return np.asarray(beams.power / beams.variance, dtype=np.float64)


def detectable_in_std(count: int, significance: float, power: float) -> float:
    """Return delta0: the two-sided limit shared among ``count`` lengths, plus that of power."""
    return normal_isf(0.5 * significance / count) + normal_isf(1.0 - power)
