"""Least squares of many unknowns that few observations feel each, and of few that all feel.

Where every position, station or point has unknowns of its own and shares few with the others, the
normal matrix is an arrow: blocks along the diagonal, and a border. The blocks follow from what the
observations feel; each is taken out by itself, and what is left is small. That costs n where whole
matrices cost n^3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from scipy.linalg import lapack
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from rotcal_ros.foundation.arrays import Floats, Ints

FIRM: Final = 1e-6
"""Share of its length that the column of an unknown has to have beside those before it."""
OPEN: Final = 1e-9
"""Singular values below this share of the largest are directions that nothing determines."""


@dataclass(frozen=True, eq=False)
class FewEach:
    """A design (n + m, p): rows ``few`` (n, p) that feel few unknowns each, and below them others.

    Those, ``known`` (m, p), may feel any, as what is known beforehand does.
    """

    few: csr_array
    known: Floats

    def dense(self) -> Floats:
        """Return the whole design."""
        return np.concatenate([self.few.toarray(), self.known])

    def weighted(self, weight: Floats) -> FewEach:
        """Return the same, its rows times ``weight`` (n + m,)."""
        n, p = self.few.shape
        data = self.few.data * np.repeat(weight[:n], np.diff(self.few.indptr))
        few = csr_array((data, self.few.indices, self.few.indptr), shape=(n, p))
        return FewEach(few, self.known * weight[n:, None])

    def times(self, x: Floats) -> Floats:
        """Return the design times ``x`` (p,) or (p, k)."""
        return np.asarray(np.concatenate([self.few @ x, self.known @ x]))

    def adjoint(self, y: Floats) -> Floats:
        """Return the transposed design times ``y`` (n + m,) or (n + m, k)."""
        n = self.few.shape[0]
        return np.asarray(self.few.T @ y[:n] + self.known.T @ y[n:])

    def rows(self, which: Ints) -> Floats:
        """Return some rows (k, p)."""
        n, found = self.few.shape[0], np.zeros((len(which), self.few.shape[1]))
        found[which < n] = self.few[which[which < n]].toarray()
        found[which >= n] = self.known[which[which >= n] - n]
        return found

    def beside(self, rows: Floats) -> FewEach:
        """Return the design with further ``rows`` (k, p) at its end."""
        return FewEach(self.few, np.concatenate([self.known, rows]))


@dataclass(frozen=True, eq=False)
class Turned:
    """Columns (n + m, q + c): F (I - V diag(d) V') and others, and below them whole rows.

    ``few`` (n, q): F, ``ways`` (q, m): V, orthonormal; ``lost`` (m,): d; ``others`` (n, c);
    ``below`` (m, q + c).
    """

    few: csr_array
    ways: Floats
    lost: Floats
    others: Floats
    below: Floats

    def times(self, x: Floats) -> Floats:
        """Return the columns times ``x`` (q + c,) or (q + c, k)."""
        own = x[: len(self.ways)]
        own = own - (self.ways * self.lost) @ (self.ways.T @ own)
        return np.concatenate([self.few @ own + self.others @ x[len(own) :], self.below @ x])

    def adjoint(self, y: Floats | csr_array) -> Floats:
        """Return the transposed columns times ``y`` (n + m,) or (n + m, k)."""
        n = self.few.shape[0]
        first, last = (dense(part) for part in (y[:n], y[n:]))
        own = self.few.T @ first
        own -= (self.ways * self.lost) @ (self.ways.T @ own)
        return np.asarray(np.concatenate([own, self.others.T @ first]) + self.below.T @ last)

    def rows(self, which: Ints) -> Floats:
        """Return some rows (k, q + c)."""
        n, found = self.few.shape[0], np.zeros((len(which), self.below.shape[1]))
        first = which[which < n]
        few = self.few[first]
        own = few.toarray() - (few @ self.ways * self.lost) @ self.ways.T
        found[which < n] = np.hstack([own, self.others[first]])
        found[which >= n] = self.below[which[which >= n] - n]
        return found

    def among(self, which: Ints) -> Floats:
        """Return the scalar products (k, k) of some rows."""
        if (which >= self.few.shape[0]).any():
            rows = self.rows(which)
            return np.asarray(rows @ rows.T)
        few, others = self.few[which], self.others[which]
        along = few @ self.ways
        taken = along * (self.lost * (2.0 - self.lost))
        return np.asarray((few @ few.T).toarray() - taken @ along.T + others @ others.T)

    @property
    def squares(self) -> Floats:
        """The squared length (n + m,) of each row."""
        along, whole = self.few @ self.ways, np.asarray((self.few * self.few).sum(axis=1))
        own = whole - along**2 @ (self.lost * (2.0 - self.lost))
        return np.append(own + (self.others**2).sum(axis=1), (self.below**2).sum(axis=1))


Design: TypeAlias = "Floats | csr_array | FewEach"
"""Derivatives (n, p), whole or only those that may not be zero."""


def dense(design: Design) -> Floats:
    """Return the whole design (n, p)."""
    if isinstance(design, FewEach):
        return design.dense()
    return design if isinstance(design, np.ndarray) else np.asarray(design.toarray())


def beside(design: Design, rows: Floats) -> Design:
    """Return a design with further ``rows`` (k, p) at its end."""
    if isinstance(design, np.ndarray):
        return np.concatenate([design, rows])
    if isinstance(design, FewEach):
        return design.beside(rows)
    return FewEach(design, rows)


def weighted(design: Design, weight: Floats) -> Floats | FewEach:
    """Return a design, its rows times ``weight`` (n,)."""
    if isinstance(design, np.ndarray):
        return np.asarray(design * weight[:, None])
    few = (
        design if isinstance(design, FewEach) else FewEach(design, np.zeros((0, design.shape[1])))
    )
    return few.weighted(weight)


def times(design: Design | Turned, x: Floats) -> Floats:
    """Return a design (n, p) times ``x`` (p,) or (p, k)."""
    return design.times(x) if isinstance(design, FewEach | Turned) else np.asarray(design @ x)


def adjoint(design: Floats | FewEach | Turned, y: Floats) -> Floats:
    """Return a transposed design (p, n) times ``y`` (n,) or (n, k)."""
    return design.adjoint(y) if isinstance(design, FewEach | Turned) else np.asarray(design.T @ y)


def normal(design: Floats | FewEach) -> Floats:
    """Return the normal matrix (p, p) of a design."""
    if isinstance(design, FewEach):
        of_few = (design.few.T @ design.few).toarray()
        return np.asarray(of_few + design.known.T @ design.known)
    return np.asarray(design.T @ design)


@dataclass(frozen=True, eq=False)
class Arrow:
    """The blocks of rows that feel few unknowns each.

    ``own`` (g, s): unknowns of each group, -1 where one has fewer; ``shared`` (c,): all others.
    In a stack of blocks (g, r, s + c + 1), flat, stand the ``entries`` of the rows, what they read
    (``read``), and a 1 in ``missing`` places, which ties down the unknowns that are none.
    """

    own: Ints
    shared: Ints
    depth: int
    entries: Ints
    read: Ints
    missing: Ints

    @classmethod
    def of(cls, few: csr_array, joined: Ints | None = None) -> Arrow | None:
        """Return those of rows (n, p); None where these do not fall into groups.

        Unknowns that are ``joined`` (k,) count as shared, whoever feels them.
        """
        n, p = few.shape
        row, column = np.repeat(np.arange(n), np.diff(few.indptr)), few.indices
        count = np.bincount(column, minlength=p)
        # what many feel joins everything: many is between one group's rows and all of them
        alone = (count > 0) & (count <= np.sqrt(n * np.median(count[count > 0])))
        if joined is not None:
            alone[joined] = False
        inside = alone[column]
        ones = np.ones(int(inside.sum()))
        graph = coo_array((ones, (row[inside], n + column[inside])), shape=(n + p, n + p))
        label = connected_components(graph, directed=False)[1]
        groups, group = np.unique(label[n:][alone], return_inverse=True)
        if len(groups) < 2:
            return None
        number = np.full(label.max() + 1, -1)
        number[groups] = np.arange(len(groups))
        of_row = number[label[:n]]
        idle = of_row < 0  # rows of shared unknowns alone fit into any group
        of_row[idle] = np.arange(int(idle.sum())) % len(groups)
        at, at_row = _within(group), _within(of_row)
        size, depth = int(at.max()) + 1, int(at_row.max()) + 1
        own, shared = np.full((len(groups), size), -1), np.flatnonzero(~alone)
        own[group, at] = np.flatnonzero(alone)
        place = np.zeros(p, dtype=np.int64)
        place[alone], place[~alone] = at, size + np.arange(len(shared))
        width = size + len(shared) + 1
        lacking, slot = np.nonzero(own < 0)
        extra = _within(lacking)
        whole = depth + int(extra.max(initial=-1)) + 1
        begin = (of_row * whole + at_row) * width
        return cls(
            own, shared, whole, begin[row] + place[column], begin + width - 1,
            (lacking * whole + depth + extra) * width + slot,
        )  # fmt: skip

    def solved(self, design: FewEach, read: Floats) -> Floats | None:
        """Return the unknowns (p,) of least squares, None where these are not firm.

        ``design`` (n + m, p) and what it ``read`` (n + m,), both whitened. Square roots, no normal
        equations: of each group QR leaves rows of its own unknowns, and rows of shared ones. With
        u for what its own rows are left with, what is known is H u + K x = k: variance I + H H'.
        """
        (groups, size), n, shared = self.own.shape, design.few.shape[0], len(self.shared)
        width = size + shared + 1
        stack = np.zeros(groups * self.depth * width)
        stack[self.entries], stack[self.read], stack[self.missing] = design.few.data, read[:n], 1.0
        upper = _triangle(stack.reshape(groups, self.depth, width))
        if upper.shape[1] < size:
            return None
        triangle, rest = upper[:, :size, :size], upper[:, size:, size:].reshape(-1, shared + 1)
        length = np.linalg.norm(triangle, axis=1)
        if (np.abs(np.diagonal(triangle, axis1=1, axis2=2)) <= FIRM * length).any():
            return None
        of_own = np.where(self.own >= 0, design.known[:, self.own], 0.0)  # (m, g, s)
        felt = np.linalg.solve(triangle, upper[:, :size, size:])
        open_ = np.column_stack([design.known[:, self.shared], read[n:]])
        open_ -= np.einsum("mgs,gsc->mc", of_own, felt)
        by_left = np.linalg.solve(np.swapaxes(triangle, 1, 2), of_own.transpose(1, 2, 0))
        by_left = by_left.reshape(groups * size, -1)  # H'
        root = _triangle(np.concatenate([np.eye(len(open_)), by_left]))
        white = np.linalg.solve(root.T, open_)
        least = _triangle(np.concatenate([rest, white]))
        x = np.zeros(design.few.shape[1] + 1)  # the last for unknowns that are none
        if shared:
            border = least[:shared, :shared]
            length = np.linalg.norm(border, axis=0)
            whole = np.bincount(design.few.indices, design.few.data**2, design.few.shape[1])
            whole = np.sqrt(whole + (design.known**2).sum(axis=0))[self.shared]
            if len(border) < shared or (length <= FIRM * whole).any():
                return None  # what is left of a column is rounding
            if lapack.dtrcon(border / length)[0] <= FIRM:
                return None
            x[self.shared] = lapack.dtrtrs(border, least[:shared, shared])[0]
        along = np.append(-x[self.shared], 1.0)
        left = by_left @ np.linalg.solve(root, white @ along)
        own = felt @ along + np.linalg.solve(triangle, left.reshape(groups, size, 1))[:, :, 0]
        x[self.own] = own
        return x[:-1]

    def factored(self, design: FewEach) -> tuple[Turned, Turned, Floats] | None:
        """Return orthonormal columns that span a whitened ``design`` (n + m, p), and a root.

        That (p, rank) times its transposed is the inverse of the normal matrix. And what is open:
        orthonormal directions (k, p). None where most blocks are not firm. As in :meth:`solved`,
        with u for what own unknowns and their share of the shared ones make of own rows: these
        have I + H'H = (I - V diag(d) V')^-2, by the SVD of H.
        """
        (groups, size), n, shared = self.own.shape, design.few.shape[0], len(self.shared)
        width = size + shared + 1
        stack = np.zeros(groups * self.depth * width)
        stack[self.entries], stack[self.missing] = design.few.data, 1.0
        stack = stack.reshape(groups, self.depth, width)
        blocks, border = stack[:, :, :size], stack[:, :, size:-1]
        basis, triangle = np.linalg.qr(blocks)
        if triangle.shape[1] < size:
            return None
        diagonal = np.abs(np.diagonal(triangle, axis1=1, axis2=2))
        weak = (diagonal <= FIRM * np.linalg.norm(triangle, axis=1)).any(axis=1)
        if weak.any():
            own = self.own[weak]
            rest = Arrow.of(design.few, own[own >= 0]) if 2 * weak.sum() < groups else None
            return None if rest is None else rest.factored(design)
        inverse, felt = np.linalg.inv(triangle), np.swapaxes(basis, 1, 2) @ border
        known = design.known[:, self.shared]
        of_own = np.where(self.own >= 0, design.known[:, self.own], 0.0)  # (m, g, s)
        of_own = np.einsum("mgs,gst->mgt", of_own, inverse)  # H
        left, stretch, ways = np.linalg.svd(
            of_own.reshape(len(known), groups * size), full_matrices=False
        )
        ways, grown = ways.T, np.sqrt(1.0 + stretch**2)
        open_ = known - np.einsum("mgs,gsc->mc", of_own, felt)
        along = left.T @ open_
        beside_own = (border - basis @ felt).reshape(-1, shared)
        rows = np.concatenate([beside_own, open_ - left @ along, along / grown[:, None]])
        moved = -(ways * (stretch / grown**2)) @ along
        moved = (inverse @ (moved.reshape(groups, size, shared) - felt)).reshape(-1, shared)
        real = self.own.ravel() >= 0
        every = np.zeros((design.few.shape[1], shared))
        every[self.own.ravel()[real]], every[self.shared] = moved[real], np.eye(shared)
        length = np.linalg.norm(np.concatenate([border.reshape(-1, shared), known]), axis=0)
        length = np.where(length > 0.0, length, 1.0)
        _, share, turn = np.linalg.svd(_triangle(rows / length))
        determined = np.arange(shared) < (share > OPEN * share.max(initial=0.0)).sum()
        every = every @ (turn.T / length[:, None])
        nothing = every[:, ~determined]
        every = every[:, determined] / share[: int(determined.sum())]
        ways, lost = ways[real], 1.0 - 1.0 / grown
        below = np.hstack([(left * (stretch / grown)) @ ways.T, design.known @ every])
        none = np.zeros((0, below.shape[1]))
        at, to = np.full(groups * self.depth, -1), np.where(real, np.cumsum(real) - 1, -1)
        at[self.read // width] = np.arange(n)
        to = to.reshape(groups, 1, size)
        spanning = _blocks(basis, at.reshape(groups, -1, 1), to, (n, len(ways)))
        root = _blocks(inverse, self.own[:, :, None], to, (len(every), len(ways)))
        spanned = Turned(spanning, ways, lost, design.few @ every, below)
        return spanned, Turned(root, ways, lost, every, none), nothing.T


def _blocks(blocks: Floats, row: Ints, column: Ints, shape: tuple[int, int]) -> csr_array:
    """Return the matrix of the entries of ``blocks`` where ``row`` and ``column`` are not -1."""
    row, column = np.broadcast_arrays(row, column)
    real = (row >= 0) & (column >= 0)
    return csr_array(coo_array((blocks[real], (row[real], column[real])), shape=shape))


def _triangle(matrix: Floats) -> Floats:
    """Return R of the QR decomposition of each matrix (..., n, p)."""
    return np.asarray(np.linalg.qr(matrix, mode="r"))


def _within(group: Ints) -> Ints:
    """Return which one of its group each member (k,) is, from 0."""
    order = np.argsort(group, kind="stable")
    sizes = np.bincount(group)
    found = np.empty(len(group), dtype=np.int64)
    found[order] = np.arange(len(group)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    return found
