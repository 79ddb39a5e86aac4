"""What is asked of the unknowns: rows that differ little from a few that they share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import DTypeLike
from scipy.linalg import block_diag
from scipy.sparse import csc_array, csr_array, vstack

from rotcal_ros.adjust.sensitivity import Sensitivity
from rotcal_ros.foundation.arrays import Bools, Floats, Ints

AT_ONCE: Final = 1024
"""Rows or columns that are worked out at once: what is dense of them stays small."""
FEW_ROWS: Final = 256
"""The same of what is dense beside other things that are."""
ROUNDED: Final = 1e-12
"""Share of the largest number below which one is the rounding of zero."""


@dataclass(frozen=True, eq=False)
class Outputs:
    """Rows C (o, p) that differ little from a few that they share: of many, little is kept.

    They are ``few`` (o, p), and ``share`` (o, g) times the rows of ``common`` (g, p).
    """

    few: csr_array
    common: Floats
    share: Floats

    @classmethod
    def of(cls, parts: Sequence[Floats | Outputs]) -> Outputs:
        """Return those of ``parts`` (o, p), one below the other, that share rows each."""
        found = [rows if isinstance(rows, Outputs) else cls._sharing(rows) for rows in parts]
        return cls(
            csr_array(vstack([each.few for each in found], format="csr")),
            np.concatenate([each.common for each in found]),
            block_diag(*(each.share for each in found)),
        )

    @classmethod
    def _sharing(cls, rows: Floats) -> Outputs:
        common = np.zeros((1, rows.shape[1]))
        if len(rows):  # what two of three rows share
            common[0] = np.median(rows[[0, len(rows) // 2, -1]], axis=0)
        return cls(csr_array(rows - common), common, np.ones((len(rows), 1)))

    @classmethod
    def alone(cls, rows: csr_array) -> Outputs:
        """Return ``rows`` (o, p) that share nothing."""
        return cls(rows, np.zeros((0, rows.shape[1])), np.zeros((rows.shape[0], 0)))

    @classmethod
    def picked(cls, unknowns: Ints, common: Floats) -> Outputs:
        """Return some ``unknowns`` (o,) of p, each beside the row ``common`` (p,)."""
        o = len(unknowns)
        few = csr_array((np.ones(o), unknowns, np.arange(o + 1)), shape=(o, len(common)))
        return cls(few, common[None], np.ones((o, 1)))

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers o of outputs and p of unknowns."""
        o, p = self.few.shape
        return int(o), int(p)

    def __len__(self) -> int:
        """Return their number o."""
        return int(self.few.shape[0])

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> Floats:
        """Return all of them, written out."""
        return np.asarray(self[:], dtype=dtype)

    def __getitem__(self, which: slice) -> Floats:
        """Return some of them, written out."""
        return np.asarray(self.few[which].toarray() + self.share[which] @ self.common)

    def some(self, which: Ints) -> Floats:
        """Return some of them (k,), written out."""
        return np.asarray(self.few[which].toarray() + self.share[which] @ self.common)

    def columns(self, which: Ints) -> Floats:
        """Return some columns (o, k), written out."""
        return np.asarray(self._by_column[:, which].toarray() + self.share @ self.common[:, which])

    @cached_property
    def _by_column(self) -> csc_array:
        return csc_array(self.few)

    def weighted(self, weight: Floats) -> Outputs:
        """Return them with each column times its ``weight`` (p,)."""
        entries = self.few.data * weight[self.few.indices], self.few.indices, self.few.indptr
        few = csr_array(entries, shape=self.few.shape)
        return Outputs(few, self.common * weight, self.share)

    def after(self, right: csr_array) -> Outputs:
        """Return C times ``right`` (p, k)."""
        return Outputs(csr_array(self.few @ right), (right.T @ self.common.T).T, self.share)

    def products(self) -> Floats:
        """Return C C', (o, o)."""
        both = self.share @ (self.few @ self.common.T).T
        both += both.T + (self.share @ (self.common @ self.common.T)) @ self.share.T
        for begin in range(0, len(self), FEW_ROWS):
            here = slice(begin, begin + FEW_ROWS)
            both[here] += (self.few[here] @ self.few.T).toarray()
        return np.asarray(both)

    def sensitivity(self, which: Ints) -> Sensitivity:
        """Return some columns in parts that are few."""
        if not len(self.common):
            return Sensitivity.whole(self.columns(which))
        own = self._by_column[:, which].tocsr()
        at = np.flatnonzero(np.diff(own.indptr))
        return Sensitivity(self.common[:, which], self.share, at, own[at].toarray())

    def __matmul__(self, x: Floats) -> Floats:
        """Return C times ``x`` (p,) or (p, k)."""
        return self.times(x)

    def fixed(self, fixing: Floats, rows: Floats) -> Outputs:
        """Return C (I - F G) of a ``fixing`` F (p, g) and ``rows`` G (g, p)."""
        share = -self.times(fixing)
        share[np.abs(share) < ROUNDED * np.abs(share).max(initial=0.0)] = 0.0
        more = (0, 0), (0, rows.shape[1] - self.common.shape[1])
        common = np.concatenate([np.pad(self.common, more), rows])
        few = self.few.tocsr(copy=False)
        few = csr_array((few.data, few.indices, few.indptr), shape=(len(self), rows.shape[1]))
        return Outputs(few, common, np.hstack([self.share, share]))

    @cached_property
    def each(self) -> int:
        """The most entries of a row beside what it shares."""
        return int(np.diff(self.few.indptr).max(initial=0))

    @cached_property
    def entries(self) -> tuple[Ints, Floats]:
        """Columns and values of those entries, (o, each): zeros where there are fewer."""
        counts = np.diff(self.few.indptr)
        there = np.arange(self.each) < counts[:, None]
        column, value = np.zeros(there.shape, dtype=np.int64), np.zeros(there.shape)
        column[there], value[there] = self.few.indices, self.few.data
        return column, value

    def of_first(self, unknowns: int) -> Outputs:
        """Return what they make of the first ``unknowns`` alone."""
        if self.shape[1] <= unknowns:
            return self
        return Outputs(self.few[:, :unknowns], self.common[:, :unknowns], self.share)

    def part(self, which: slice | Ints) -> Outputs:
        """Return some of them."""
        share = self.share[which]
        used = share.any(axis=0)
        return Outputs(self.few[which], self.common[used], share[:, used])

    def times(self, x: Floats) -> Floats:
        """Return C times ``x`` (p + q,) or (p + q, k); the last q unknowns count nothing."""
        x = x[: self.common.shape[1]]
        return np.asarray(self.few @ x + self.share @ (self.common @ x))

    def parts(self, unknowns: int) -> Iterator[tuple[slice, Floats]]:
        """Yield some rows after the other, (r, ``unknowns``) and which they are."""
        more = ((0, 0), (0, unknowns - self.common.shape[1]))
        for begin in range(0, len(self), AT_ONCE):
            here = slice(begin, min(begin + AT_ONCE, len(self)))
            yield here, np.pad(self[here], more)

    def lengths(self, scale: Floats) -> Floats:
        """Return the length (o,) of each, of unknowns times ``scale`` (p + q,)."""
        over = 1.0 / scale[: self.common.shape[1]] ** 2
        mixed = ((self.few @ (self.common * over).T) * self.share).sum(axis=1)
        common = ((self.share @ (self.common * over @ self.common.T)) * self.share).sum(axis=1)
        squares = (self.few * self.few) @ over + 2.0 * mixed + common
        return np.asarray(np.sqrt(np.maximum(squares, 0.0)))

    @cached_property
    def idle(self) -> Bools:
        """Which (o,) are always zero, as the first that is counted from itself."""
        return np.asarray(self.lengths(np.ones(self.shape[1])) == 0.0)

    @cached_property
    def influenced(self) -> Bools:
        """Which unknowns (p,) one of them feels."""
        return np.asarray((self.common != 0.0).any(axis=0) | (abs(self.few).sum(axis=0) > 0.0))

    def run(self, count: int, size: int) -> tuple[int, int] | None:
        """Return circle and first place where all read one place after the next alike; else None.

        Of the first ``count`` unknowns, circles of ``size`` places each.
        """
        if self.each != 1 or not len(self) or np.ptp(self.few.data):
            return None
        circle, place = np.divmod(self.few.indices, size)
        here = (place[0] + np.arange(len(place))) % size
        follow = (circle == circle[0]).all() and (place == here).all() and len(self) == len(circle)
        return (int(circle[0]), int(place[0])) if follow and circle[0] * size < count else None
