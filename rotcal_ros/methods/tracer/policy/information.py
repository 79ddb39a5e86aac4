"""What lengths tell about the table's angles: covariance, and the gain of each candidate.

The linear model of the joint network (:mod:`rotcal_ros.methods.tracer.solver.joint`) at the
nominal geometry. Unknown are the stations (3 m), a zero per segment (q), and the targets with the
machine's prior. A length moves with u (dP - dA) - dz; with weights w and variances v its
information is

    F(w) = sum w g g' / v + prior,     g = (h, -u),   h = u at its station, -1 at its zero

Targets are eliminated one by one (Schur complement), which leaves M of 3 m + q unknowns. The
angles are t = G dP. By Sherman and Morrison a further length lowers the mean variance of the
angles by |G a|^2 / (m (v + s)), with a = F^-1 g and s = g' F^-1 g; the derivative by its weight is
the same without s. Exact to first order; nothing depends on the readings, for the model is linear.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from rotcal_ros.adjust.distributions import normal_isf
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.methods.tracer.policy.scene import Lengths, Scene, Which

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
    """What ``lengths`` tell in a ``scene``; ``segments`` is the number of zeros (q).

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
