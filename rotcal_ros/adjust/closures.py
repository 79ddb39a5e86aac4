"""Closures: what outputs are known to keep, as a table that comes to an angle again.

:func:`closures` compares positions at one angle. What a model declares (``KnownRelation``) is
tested by :class:`ClosureTest`: m = K y of the outputs with covariance V is beside all residuals,
so that an effect A, which makes K B A of it, is told by both: S = A'RA + (KBA)'V^-1 KBA.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from rotcal_ros.adjust.distributions import chi2_sf, f_sf, normal_isf
from rotcal_ros.adjust.effects import ObservableEffect, ObservableFamily
from rotcal_ros.adjust.fit import Fit
from rotcal_ros.adjust.model import Disturbing, KnownRelation, Steps
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.compact import Spread, difference_variance
from rotcal_ros.foundation.units import TURN

MISSED: Final = 1e-7
"""Rad by which typed steps, and their sums, may miss a whole turn; 20 milliarcsec."""
ROUNDED: Final = 1e-14
"""Share of the largest variance of what a relation misses, below which another is rounding."""


@dataclass(frozen=True, slots=True)
class Closure:
    """Two positions at the same table angle, whole turns apart: what should agree, and how well.

    ``error`` is the deviation at position ``last`` minus that at ``first``, with its standard
    deviation ``std``; SI.
    """

    first: int
    last: int
    error: float
    std: float

    def open(self, significance: float) -> bool:
        """Whether they differ by more than chance, two-sided, explains."""
        return abs(self.error) > normal_isf(0.5 * significance) * self.std


def closures(
    angles: Floats,
    deviations: Floats,
    covariance: Spread,
    position_ids: Ints,
    upward: Bools | None = None,
) -> tuple[Closure, ...]:
    """Return the closures of ``angles`` (m,), rad: later positions against the first at theirs.

    ``deviations`` (m,) with the ``covariance`` (m, m). Positions are called by ``position_ids``
    (m,). ``upward`` (m,): from which side the table came; what differs between the sides is a
    reversal.
    """
    pairs = np.array([*repeated_angles(angles, upward)], dtype=np.int64).reshape(-1, 2)
    std = np.sqrt(difference_variance(covariance, pairs[:, 0], pairs[:, 1]))
    apart = deviations[pairs[:, 1]] - deviations[pairs[:, 0]]
    each = zip(position_ids[pairs].tolist(), apart.tolist(), std.tolist(), strict=True)
    return tuple(Closure(first, last, error, own) for (first, last), error, own in each)


def repeated_angles(angles: Floats, upward: Bools | None = None) -> Iterator[tuple[int, int]]:
    """Yield which of the ``angles`` (m,), rad, comes first, and which is the same again.

    ``upward`` (m,): from which side each is reached; None: that is no matter.
    """
    order, wrapped = np.argsort(angles % TURN), np.sort(angles % TURN)
    near = np.diff(wrapped, append=wrapped[:1] + TURN) < 2.0 * MISSED
    again = np.sort(order[near | np.roll(near, 1)])  # the others are alone
    for last in again[again > 0].tolist():
        apart = angles[last] - angles[:last]
        meets = np.abs(apart - TURN * np.round(apart / TURN)) < MISSED
        if upward is not None:
            meets &= upward[:last] == upward[last]
        for first in np.flatnonzero(meets)[:1].tolist():
            yield first, last


@dataclass(frozen=True, eq=False)
class ClosureTest:
    """How a ``relation`` of outputs is kept in a ``fit``, whose uncertainties are times ``scale``.

    ``log_std`` (c,): of the estimated noise of each component; zero of what is stated, None: all.
    """

    fit: Fit
    relation: KnownRelation
    scale: float = 1.0
    log_std: Floats | None = None

    @cached_property
    def error(self) -> Floats:
        """By how much (k,) it is missed."""
        rows = self.relation.rows
        return np.asarray(rows @ self.fit.value[: rows.shape[1]])

    @cached_property
    def response(self) -> Floats:
        """What whitened errors do to that, (k, n)."""
        return self.fit.response_to(self.relation.rows)

    @cached_property
    def _root(self) -> Floats:
        """What makes it white: V^-1/2 (q, k), of what is known of it."""
        own = self.relation.std**2 * np.eye(len(self.error))
        values, axes = np.linalg.eigh(self.scale**2 * self.response @ self.response.T + own)
        kept = values > ROUNDED * max(values[-1], np.finfo(np.float64).tiny)
        return np.asarray(axes[:, kept].T / np.sqrt(values[kept])[:, None])

    @property
    def std(self) -> Floats:
        """Standard deviations (k,) of the error."""
        variance = (self.scale * self.response) ** 2
        return np.asarray(np.sqrt(variance.sum(axis=1) + self.relation.std**2))

    @property
    def squares(self) -> tuple[float, int]:
        """Chi-squared of the error, and its rank q."""
        white = self._root @ self.error
        return float(white @ white), len(white)

    @property
    def probability(self) -> float:
        """How probably chance misses it by as much.

        Where the noise was estimated by F with q / sum(tr(D^2) / dof) degrees of freedom, of each
        component its share D (q, q) of the error's covariance and the dof of its own estimate:
        those of few must not be taken for as sure as all together.
        """
        squares, rank = self.squares
        if not rank:
            return 1.0
        influence, unsure = self._root @ (self.scale * self.response), 0.0
        for k, known in enumerate(() if self.log_std is None else self.log_std.tolist()):
            mine = influence[:, self.fit.model.of_component == k]
            unsure += 2.0 * known**2 * float(((mine @ mine.T) ** 2).sum())
        if not unsure:
            return chi2_sf(squares, rank)
        return f_sf(squares / rank, rank, rank / unsure)

    def beside(
        self, effect: Disturbing, seen: ObservableEffect | ObservableFamily
    ) -> ObservableEffect | ObservableFamily:
        """Return what is ``seen`` of an ``effect`` with what this tells of it."""
        columns = effect.at(self.fit.computed)
        by = np.where(self.fit.used, 1.0 / self.fit.std, 0.0)
        influence, white = self._root @ (self.response * by), self._root @ self.error
        if isinstance(columns, Steps) and not columns.centred:
            parts = [np.zeros((0, columns.width, len(white)))]
            for rows, first in columns.runs:
                mine = columns.influence[rows][:, :, None] * influence.T[rows][:, None]
                parts.append(np.cumsum(mine[::-1], axis=0)[::-1][first])
            moved = np.concatenate(parts)
        else:
            written = columns.whole() if isinstance(columns, Steps) else columns
            moved = (written.T @ influence.T).reshape(-1, effect.width, len(white))
        if isinstance(seen, ObservableEffect):
            flat = moved.reshape(-1, len(white))
            information, score = seen.information + flat @ flat.T, seen.score + flat @ white
            return replace(seen, information=information, score=score)
        return replace(
            seen,
            information=seen.information + moved @ moved.swapaxes(1, 2),
            beside=seen.beside + moved[:-1] @ moved[1:].swapaxes(1, 2),
            score=seen.score + moved @ white,
        )
