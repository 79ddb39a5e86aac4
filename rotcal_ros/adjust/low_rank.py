"""Large symmetric matrices that are blocks on a diagonal and little else.

Where every point has unknowns of its own and shares few with the others, a covariance of all
points is block diagonal but for a low rank, and so are the slopes of what is computed of them.
Kept so, n points cost n where whole matrices cost n^2 and their products n^3.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from scipy.linalg import block_diag

from rotcal_ros.foundation.arrays import Floats, Ints

THIN: Final = 4
"""A rank of more than one in THIN of the rows is no low one: the whole matrix is quicker."""
FIRM: Final = 0.01
"""Entry of a diagonal, of matrices of order one, below which a row counts with the low rank."""
REFINED: Final = 6
"""Steps of subspace iteration; each leaves less than 1e-3 of the error before it."""


@dataclass(frozen=True, eq=False)
class LowRank:
    """The symmetric matrix B + X M X', (k s, k s).

    ``blocks`` (k, s, s): B. ``columns`` (k s, r): X, ``core`` (r, r): M. ``columns`` None: X is
    the identity, and the core a whole matrix.
    """

    blocks: Floats
    columns: Floats | None
    core: Floats

    @classmethod
    def whole(cls, matrix: Floats, size: int = 1) -> LowRank:
        """Return a whole ``matrix`` (k s, k s) with blocks of this ``size`` s."""
        return cls(np.zeros((len(matrix) // size, size, size)), None, matrix)

    @classmethod
    def outer(cls, columns: Floats) -> LowRank:
        """Return ``columns`` (k, r) times their transposed, with s = 1."""
        return cls(np.zeros((len(columns), 1, 1)), columns, np.eye(columns.shape[1]))

    @property
    def order(self) -> int:
        """The number k s of rows."""
        return int(self.blocks.shape[0] * self.blocks.shape[1])

    def dense(self) -> Floats:
        """Return the whole matrix."""
        k, s, _ = self.blocks.shape
        outer = self.core if self.columns is None else self.columns @ self.core @ self.columns.T
        whole = outer.reshape(k, s, k, s).copy()
        whole[np.arange(k), :, np.arange(k)] += self.blocks
        return np.asarray(whole.reshape(k * s, k * s))

    def quick(self) -> LowRank:
        """Return it as a whole matrix where its rank is no low one."""
        if self.columns is None or THIN * len(self.core) < self.order:
            return self
        return LowRank.whole(self.dense(), self.blocks.shape[1])

    def if_low(self) -> LowRank | None:
        """Return it where its rank is a low one; else None."""
        return None if self.quick().columns is None else self

    def __add__(self, other: LowRank) -> LowRank:
        """Return the sum of two with blocks of the same size."""
        blocks = self.blocks + other.blocks
        if self.columns is other.columns:
            return LowRank(blocks, self.columns, self.core + other.core)
        if self.columns is None or other.columns is None:
            size = blocks.shape[1]
            return LowRank.whole(self.dense() + other.dense(), size)
        columns = np.hstack([self.columns, other.columns])
        return LowRank(blocks, columns, np.asarray(block_diag(self.core, other.core)))

    def scaled(self, factor: float) -> LowRank:
        """Return ``factor`` times the matrix."""
        return replace(self, blocks=factor * self.blocks, core=factor * self.core)

    def diagonal_blocks(self) -> Floats:
        """Return the blocks (k, s, s) on the diagonal of the whole matrix."""
        k, s, _ = self.blocks.shape
        if self.columns is None:
            at = np.arange(k)
            return np.asarray(self.blocks + self.core.reshape(k, s, k, s)[at, :, at])
        columns = self.columns.reshape(k, s, -1)
        return np.asarray(self.blocks + (columns @ self.core) @ columns.swapaxes(1, 2))

    def diagonal(self) -> Floats:
        """Return the diagonal (k s,)."""
        return np.diagonal(self.diagonal_blocks(), axis1=1, axis2=2).ravel()

    def between(self, first: Ints, second: Ints) -> Floats:
        """Return the variances (q,) of what rows differ by, of a covariance with s = 1.

        ``first``, ``second`` (q,): the rows; zero where they are the same.
        """
        if self.columns is None:
            part = self.core
            both = part[first, first] + part[second, second] - 2.0 * part[first, second]
        else:
            apart = self.columns[second] - self.columns[first]
            both = ((apart @ self.core) * apart).sum(axis=1)
        own = self.blocks[:, 0, 0]
        return np.where(first == second, 0.0, both + own[first] + own[second])

    def from_first(self) -> Floats:
        """Return the covariance (k, k) of what all rows differ from the first by, with s = 1."""
        own = self.blocks[:, 0, 0]
        if self.columns is None:
            left = self.core - self.core[0]
            joint = left - left[:, :1]
        else:
            apart = self.columns - self.columns[0]
            joint = (apart @ self.core) @ apart.T
        joint[1:, 1:] += own[0]
        joint[np.arange(1, len(own)), np.arange(1, len(own))] += own[1:]
        joint += joint.T.copy()
        joint *= 0.5
        return np.asarray(joint)

    # what follows is for s = 1: a diagonal and a low rank

    def solved(self, right: Floats) -> tuple[Floats, float]:
        """Return the inverse times ``right`` (k, c), and ln of the determinant (Woodbury)."""
        if self.columns is None:
            whole = self.dense()
            return np.asarray(np.linalg.solve(whole, right)), float(np.linalg.slogdet(whole)[1])
        own = self.blocks[:, 0]
        divided = self.columns / own
        middle = np.eye(len(self.core)) + self.core @ (self.columns.T @ divided)
        solved = np.linalg.solve(middle, self.core @ (divided.T @ right))
        determinant = np.log(np.abs(own)).sum() + np.linalg.slogdet(middle)[1]
        return np.asarray(right / own - divided @ solved), float(determinant)

    def lifted(self, by: float) -> LowRank:
        """Return the matrix with ``by`` added to its diagonal."""
        return LowRank(self.blocks + by, self.columns, self.core)

    def squares(self, vector: Floats, least: float) -> tuple[float, int]:
        """Return v'R^+v of a ``vector`` (k,) and the rank of R, whose eigenvalues are 0 to 1.

        Those up to ``least``, which is far below FIRM, are taken for zero.
        """
        if self.columns is None or (plain := self._firm()) is None:
            values, vectors = np.linalg.eigh(self.dense())
            seen = values > least
            along = vectors[:, seen].T @ vector
            return float((along**2 / values[seen]).sum()), int(seen.sum())
        if plain._least > 2.0 * least:
            inverse = plain.solved(vector[:, None])[0][:, 0]
            return float(vector @ inverse), self.order
        unseen = plain._below(least)
        inside = vector - unseen @ (unseen.T @ vector)
        filled = plain + LowRank(np.zeros_like(plain.blocks), unseen, np.eye(unseen.shape[1]))
        squares = inside @ filled.solved(inside[:, None])[0]
        return float(squares[0]), self.order - unseen.shape[1]

    def _firm(self) -> LowRank | None:
        """Return the same matrix without small diagonal entries; None where they are many."""
        assert self.columns is not None
        weak = np.flatnonzero(self.blocks[:, 0, 0] < FIRM)
        if THIN * (len(weak) + len(self.core)) > self.order:
            return None
        unit, blocks = np.zeros((self.order, len(weak))), self.blocks.copy()
        unit[weak, np.arange(len(weak))] = 1.0
        blocks[weak] = 1.0
        lack = LowRank(np.zeros_like(blocks), unit, np.diag(self.blocks[weak, 0, 0] - 1.0))
        return replace(self, blocks=blocks) + lack

    @property
    def _least(self) -> float:
        """What no eigenvalue is below, of a matrix without small diagonal entries."""
        assert self.columns is not None
        own = self.blocks[:, 0, 0]
        size, ways = np.linalg.eigh((self.columns / own[:, None]).T @ self.columns)
        root = ways * np.sqrt(np.maximum(size, 0.0))
        beside = np.linalg.eigvalsh(root.T @ self.core @ root)
        return float(own.min() * min(1.0, 1.0 + beside.min(initial=0.0)))

    def _below(self, least: float) -> Floats:
        """Return the eigenvectors (k, c) of eigenvalues up to ``least``.

        Of a positive semi-definite matrix with a diagonal from FIRM on: they lie in a space of no
        more dimensions than the low rank, to which inverse iteration leads.
        """
        assert self.columns is not None
        raised = self.lifted(least)
        space = self.columns
        for _ in range(REFINED):
            space = np.linalg.qr(raised.solved(space)[0])[0]
        values, vectors = np.linalg.eigh(space.T @ self.times(space))
        return np.asarray(space @ vectors[:, values <= least])

    def times(self, right: Floats) -> Floats:
        """Return the matrix times ``right`` (k s, c)."""
        k, s, _ = self.blocks.shape
        own = (self.blocks @ right.reshape(k, s, -1)).reshape(k * s, -1)
        if self.columns is None:
            return np.asarray(own + self.core @ right)
        return np.asarray(own + self.columns @ (self.core @ (self.columns.T @ right)))


@dataclass(frozen=True, eq=False)
class Slopes:
    """The matrix (k, k s) of rows that feel their own block, and what is common to all.

    ``own`` (k, s): of each row by its own block. ``common`` (k, c) times ``along`` (c, k s): what
    all feel.
    """

    own: Floats
    common: Floats
    along: Floats

    @classmethod
    def alone(cls, own: Floats) -> Slopes:
        """Return slopes of rows that feel nothing but their ``own`` (k, s)."""
        return cls(own, np.zeros((len(own), 0)), np.zeros((0, own.size)))

    def dense(self) -> Floats:
        """Return the whole matrix (k, k s)."""
        k, s = self.own.shape
        whole = (self.common @ self.along).reshape(k, k, s)
        whole[np.arange(k), np.arange(k)] += self.own
        return whole.reshape(k, k * s)

    def times(self, right: Floats) -> Floats:
        """Return the matrix times ``right`` (k s, c)."""
        k, s = self.own.shape
        own = (self.own[:, None] @ right.reshape(k, s, -1))[:, 0]
        return np.asarray(own + self.common @ (self.along @ right))

    @cached_property
    def from_first(self) -> Slopes:
        """What all rows differ from the first by; that one is exactly zero."""
        k, s = self.own.shape
        own, first = self.own.copy(), np.zeros((1, k * s))
        own[0], first[0, :s] = 0.0, -self.own[0]
        others = (np.arange(k) > 0).astype(np.float64)
        common = np.column_stack([self.common - self.common[0], others])
        return Slopes(own, common, np.vstack([self.along, first]))

    def spread(self, covariance: LowRank) -> LowRank:
        """Return the covariance of the rows, s = 1, from that of what they are computed of."""
        k, s = self.own.shape
        if covariance.columns is None:
            half = self.times(covariance.dense())
            return LowRank.whole(self.times(half.T))
        mapped = (covariance.blocks @ self.along.T.reshape(k, s, -1)).reshape(k * s, -1)
        mixed = (self.own[:, None] @ mapped.reshape(k, s, -1))[:, 0]
        own = (self.own[:, None] @ covariance.blocks) @ self.own[:, :, None]
        c = self.common.shape[1]
        core = np.block([[self.along @ mapped, np.eye(c)], [np.eye(c), np.zeros((c, c))]])
        return LowRank(
            own,
            np.hstack([self.common, mixed, self.times(covariance.columns)]),
            np.asarray(block_diag(core, covariance.core)),
        )
