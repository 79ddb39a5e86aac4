"""Least squares of many unknowns that few observations feel each, and of few that all feel.

Where every position, station or point has unknowns of its own and shares few with the others, the
normal matrix has blocks along the diagonal, and a border. The blocks follow from what the
observations feel; QR takes out each by itself, and what is left is small. That costs n where whole
matrices cost n^3.

Of a group with the rows a of its own unknowns and b of the border, a = QR, t = b - QQ'b. What is
known beside the groups is H u + k x, with u = R x_own + Q'b x: rows that feel what is own to many
groups, as a mean of all does. Given the border x, u has the covariance I - H'M^-1 H, M = I + HH';
the border itself that of the rows t and M^-1/2 k. Square roots throughout, no normal equations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from rotcal_ros.adjust.kernels import OPEN, Design, Kernel, dense
from rotcal_ros.adjust.outputs import Outputs
from rotcal_ros.adjust.sensitivity import Sensitivity
from rotcal_ros.foundation.arrays import Bools, Floats, Ints

LARGEST_SHARE: Final = 1.0 / 3.0
"""Share of all unknowns that are in groups which the largest of them should not exceed."""
NEARLY_AS_MANY: Final = 0.9
"""Share of the most rows that feel an unknown from which another is felt by as many."""
MOST_WHOLE: Final = 2000
"""Unknowns up to which normal equations are written out (32 MB)."""
FIRM: Final = 1e-6
"""Share of its length that the column of an unknown has to have beside those before it."""


@dataclass(frozen=True, eq=False)
class FewEach(Design):
    """A design (n + m, p + q): rows ``few`` (n, p) that feel few unknowns each, others below.

    Those, ``known`` (m, p), may feel any, as what is known beforehand does. ``extra`` (n + m, q):
    columns of further unknowns. ``groups``: those of ``few``, where they are known.
    """

    few: csr_array
    known: Floats
    extra: Floats | None = None
    groups: Groups | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers n + m of observations and p + q of unknowns."""
        n, p = self.few.shape
        return n + len(self.known), p + self.columns.shape[1]

    @property
    def columns(self) -> Floats:
        """``extra``, or no columns (n + m, 0)."""
        if self.extra is None:
            return np.zeros((self.few.shape[0] + len(self.known), 0))
        return self.extra

    @property
    def finite(self) -> bool:
        """Whether all derivatives are finite."""
        return bool(np.isfinite(self.few.data).all())

    def dense(self) -> Floats:
        """Return the whole design."""
        return np.hstack([np.concatenate([self.few.toarray(), self.known]), self.columns])

    def weighted(self, weight: Floats) -> FewEach:
        """Return the same, its rows times ``weight`` (n + m,)."""
        n, p = self.few.shape
        data = self.few.data * np.repeat(weight[:n], np.diff(self.few.indptr))
        few = csr_array((data, self.few.indices, self.few.indptr), shape=(n, p))
        extra = None if self.extra is None else self.extra * weight[:, None]
        return replace(self, few=few, known=self.known * weight[n:, None], extra=extra)

    def times(self, x: Floats) -> Floats:
        """Return the design times ``x`` (p + q,) or (p + q, k)."""
        p = self.few.shape[1]
        found = np.concatenate([self.few @ x[:p], self.known @ x[:p]])
        return np.asarray(found if self.extra is None else found + self.extra @ x[p:])

    def adjoint(self, y: Floats) -> Floats:
        """Return the transposed design times ``y`` (n + m,) or (n + m, k)."""
        n = self.few.shape[0]
        first = self.few.T @ y[:n]
        first = first if isinstance(first, np.ndarray) else first.toarray()
        found = first + self.known.T @ y[n:] if len(self.known) else first
        return np.asarray(
            found if self.extra is None else np.concatenate([found, self.extra.T @ y])
        )

    def rows(self, which: Ints) -> Floats:
        """Return some rows (k, p + q)."""
        n, found = self.few.shape[0], np.zeros((len(which), self.few.shape[1]))
        found[which < n] = self.few[which[which < n]].toarray()
        found[which >= n] = self.known[which[which >= n] - n]
        return np.hstack([found, self.columns[which]])

    def beside(self, rows: Floats | csr_array) -> FewEach:
        """Return the design with further ``rows`` (k, p) at its end."""
        if isinstance(rows, csr_array) and not len(self.known):
            n = self.few.shape[0] + rows.shape[0]
            data = np.concatenate([self.few.data, rows.data])
            indices = np.concatenate([self.few.indices, rows.indices])
            begin = np.append(self.few.indptr, self.few.indptr[-1] + rows.indptr[1:])
            return replace(self, few=csr_array((data, indices, begin), shape=(n, rows.shape[1])))
        return replace(self, known=np.concatenate([self.known, dense(rows)]))

    def with_extra(self, columns: Floats) -> FewEach:
        """Return the design with the ``columns`` (n + m, q) of further unknowns."""
        return replace(self, extra=np.hstack([self.columns, columns]))

    @property
    def lengths(self) -> Floats:
        """The length (p + q,) of each column."""
        squares = np.bincount(self.few.indices, self.few.data**2, self.few.shape[1])
        squares = squares + (self.known**2).sum(axis=0)
        return np.asarray(np.sqrt(np.append(squares, (self.columns**2).sum(axis=0))))

    def normal(self) -> Floats:
        """Return the normal matrix (p + q, p + q)."""
        if self.extra is not None:
            return super().normal()
        return np.asarray((self.few.T @ self.few).toarray() + self.known.T @ self.known)

    @cached_property
    def structure(self) -> Groups | None:
        """The groups of ``few``; None where these do not fall into some."""
        known = self.groups
        return known if known is not None and known.fit(self.few) else Groups.of(self.few)

    @cached_property
    def rough_first(self) -> bool:  # type: ignore[override]
        """Whether the normal equations are solved in less time than a wide border."""
        (n, p), groups = self.shape, self.structure
        if groups is None or p > MOST_WHOLE:
            return False
        border = len(groups.shared) + self.columns.shape[1]
        return bool(p**3 < 4 * n * border**2)  # of which QR takes each row twice

    def kernel(self, weak: float = OPEN) -> Kernel | None:
        """Return the kernel by blocks; None where there are none, or most are not firm.

        What is determined by no more than a share ``weak`` of its length counts as open.
        """
        return None if self.structure is None else Bordered.of(self, self.structure, weak)


@dataclass(frozen=True, eq=False)
class Groups:
    """How rows (n, p) that feel few unknowns each fall into groups.

    ``own`` (g, s): unknowns of each group, -1 where one has fewer; ``shared`` (c,): all others.
    ``place`` (n,): where each row stands in g stacks of ``depth`` rows; ``entries``: where its
    numbers do among s + c columns of those. A 1 in ``missing`` places ties down the unknowns that
    are none.
    """

    few: csr_array
    own: Ints
    shared: Ints
    place: Ints
    depth: int
    entries: Ints
    missing: Ints

    @classmethod
    def of(cls, few: csr_array, joined: Ints | None = None) -> Groups | None:
        """Return those of rows (n, p); None where these do not fall into groups.

        Unknowns that are ``joined`` (k,) count as shared, whoever feels them.
        """
        n, p = few.shape
        row, column = np.repeat(np.arange(n), np.diff(few.indptr)), few.indices
        found = _apart(few, row, joined)
        if found is None:
            return None
        alone, label, groups, group = found
        number = np.full(label.max() + 1, -1)
        number[groups] = np.arange(len(groups))
        of_row = number[label[:n]]
        idle = of_row < 0  # rows of shared unknowns alone fit into any group
        of_row[idle] = np.arange(int(idle.sum())) % len(groups)
        at, at_row = within(group), within(of_row)
        size, depth = int(at.max()) + 1, int(at_row.max()) + 1
        own, shared = np.full((len(groups), size), -1), np.flatnonzero(~alone)
        own[group, at] = np.flatnonzero(alone)
        slot = np.zeros(p, dtype=np.int64)
        slot[alone], slot[~alone] = at, size + np.arange(len(shared))
        lacking, absent = np.nonzero(own < 0)
        more = within(lacking)
        whole, width = depth + int(more.max(initial=-1)) + 1, size + len(shared)
        place = of_row * whole + at_row
        return cls(
            few, own, shared, place, whole, place[row] * width + slot[column],
            (lacking * whole + depth + more) * width + absent,
        )  # fmt: skip

    def fit(self, few: csr_array) -> bool:
        """Whether these are the groups of rows that are not zero in the same places."""
        return np.array_equal(self.few.indptr, few.indptr) and np.array_equal(
            self.few.indices, few.indices
        )

    def stacked(self, design: FewEach) -> tuple[Floats, Floats]:
        """Return rows of each group: of its own unknowns (g, d, s), of the border (g, d, c)."""
        (groups, size), border = self.own.shape, len(self.shared)
        flat = np.zeros(groups * self.depth * (size + border))
        flat[self.entries], flat[self.missing] = design.few.data, 1.0
        stack = flat.reshape(groups, self.depth, size + border)
        extra = np.zeros((groups * self.depth, design.columns.shape[1]))
        extra[self.place] = design.columns[: len(self.place)]
        own, shared = stack[:, :, :size], stack[:, :, size:]
        return own, np.concatenate([shared, extra.reshape(groups, self.depth, -1)], axis=2)


@dataclass(frozen=True, eq=False)
class Bordered(Kernel):
    """The kernel of a design whose unknowns fall into groups and a border, see above.

    ``basis`` (g, d, s): Q, and ``inverse`` (g, s, s): R^-1 of each group. ``tied`` (g s, m):
    H'G^-1 and ``root`` (m, m): G of orthogonal rows, M = G'G. ``columns`` (p + q, r) of the
    unknowns, times their transposed, hold what the border adds to N^-1; ``along`` (g d, r) and
    ``below`` (m, r) is what the rows of the groups and the known ones feel of those.
    """

    design: FewEach
    directions: Floats
    groups: Groups
    basis: Floats
    inverse: Floats
    tied: Floats
    root: Floats
    columns: Floats
    along: Floats
    below: Floats

    @classmethod
    def of(cls, design: FewEach, groups: Groups, open_: float = OPEN) -> Bordered | None:
        """Return that of a whitened ``design``; None where most of its blocks are not firm.

        Those few that are not join the border, of which a share ``open_`` determines nothing.
        """
        (count, size), n = groups.own.shape, design.few.shape[0]
        blocks, border = groups.stacked(design)
        basis, triangle = np.linalg.qr(blocks)
        if triangle.shape[1] < size:
            return None
        diagonal = np.abs(np.diagonal(triangle, axis1=1, axis2=2))
        weak = (diagonal <= FIRM * np.linalg.norm(triangle, axis=1)).any(axis=1)
        if weak.any():
            own = groups.own[weak]
            joined = np.append(groups.shared, own[own >= 0])
            rest = Groups.of(design.few, joined) if 2 * weak.sum() < count else None
            return None if rest is None else cls.of(design, rest, open_)
        inverse, felt = np.linalg.inv(triangle), np.swapaxes(basis, 1, 2) @ border
        known = np.hstack([design.known[:, groups.shared], design.columns[n:]])
        of_own = _own_of(groups, design.known.T)  # (g, s, m)
        of_own = (np.swapaxes(inverse, 1, 2) @ of_own).reshape(count * size, -1)  # H'
        _, grown, ways = np.linalg.svd(_triangle(np.concatenate([np.eye(len(known)), of_own])))
        root, tied = grown[:, None] * ways, of_own @ (ways.T / grown)
        left_known = known - of_own.T @ felt.reshape(count * size, known.shape[1])
        white = np.linalg.solve(root.T, left_known)
        flat = border.reshape(count * groups.depth, known.shape[1])
        length = np.linalg.norm(np.concatenate([flat, known]), axis=0)
        length = np.where(length > 0.0, length, 1.0)
        beside_own = flat - (basis @ felt).reshape(flat.shape)
        left = np.concatenate([beside_own, white])
        ways, nothing = _determined(left / length, open_)
        by_known = (tied @ white).reshape(felt.shape)
        moved = -(felt + by_known)
        every = np.zeros((sum(design.shape[1:]), len(length)))
        at = np.append(groups.shared, np.arange(design.few.shape[1], len(every)))
        every[at, np.arange(len(at))] = 1.0
        _to_own(groups, every, inverse @ moved)
        ways, nothing = ways / length[:, None], nothing / length[:, None]
        below: Floats = np.asarray(np.linalg.solve(root, white @ ways), dtype=np.float64)
        return cls(
            design, np.asarray(every @ nothing), groups, basis, inverse, tied, root, every @ ways,
            (beside_own - (basis @ by_known).reshape(flat.shape)) @ ways, below,
        )  # fmt: skip

    def times(self, columns: Floats) -> Floats:
        """Return N^-1 times ``columns`` (p + q, k)."""
        own = self._half(self._half(self._along_own(columns)))
        found = self.columns @ (self.columns.T @ columns)
        _to_own(self.groups, found, self.inverse @ own.reshape(*self.groups.own.shape, -1))
        return np.asarray(found)

    def variances(self, rows: Floats) -> Floats:
        """Return the variances (k,) of what ``rows`` (k, p + q) make of the unknowns."""
        own, border = self._half(self._along_own(rows.T)), rows @ self.columns
        return np.asarray((own**2).sum(axis=0) + (border**2).sum(axis=1))

    def _along_own(self, columns: Floats) -> Floats:
        own = np.swapaxes(self.inverse, 1, 2) @ _own_of(self.groups, columns)
        return np.asarray(own.reshape(len(self.tied), -1))

    def _half(self, own: Floats) -> Floats:
        """Return the symmetric root of I - H'M^-1 H times ``own`` (g s, k)."""
        grown = np.linalg.norm(self.root, axis=1)[:, None]
        return np.asarray(own - self.tied @ (grown / (1.0 + grown) * (self.tied.T @ own)))

    def solve(self, white: Floats) -> Floats:
        """Return the unknowns (p + q,) or (p + q, k) of least squares, from whitened readings."""
        groups, n = self.groups, len(self.groups.place)
        read = white.reshape(len(white), -1)
        stack = np.zeros((len(groups.own) * groups.depth, read.shape[1]))
        stack[groups.place] = read[:n]
        own = np.swapaxes(self.basis, 1, 2) @ stack.reshape(len(groups.own), groups.depth, -1)
        own = own.reshape(len(self.tied), -1)
        known = read[n:] - self.root.T @ (self.tied.T @ own)
        found = self.columns @ (self.along.T @ stack + self.below.T @ read[n:])
        own = own + self.tied @ np.linalg.solve(self.root.T, known)
        _to_own(groups, found, self.inverse @ own.reshape(*groups.own.shape, -1))
        return np.asarray(found.reshape(-1, *white.shape[1:]))

    def gains(self, rows: Ints) -> Floats:
        """Return N^-1 J' of some ``rows`` (k,): what unit errors of them do, (p + q, k)."""
        own, low = self._parts(rows)
        found = self.columns @ low[len(self.root) :]
        size = self.groups.own.shape
        _to_own(self.groups, found, self.inverse @ own.reshape(*size, -1))
        return np.asarray(found)

    def _parts(self, rows: Ints) -> tuple[Floats, Floats]:
        """Return what errors of ``rows`` (k,) do to u (g s, k), and as :meth:`_low_rank`."""
        n, low = len(self.groups.place), self._low_rank(rows)
        own, first = np.zeros((*self.groups.own.shape, len(rows))), np.flatnonzero(rows < n)
        group, at = np.divmod(self.groups.place[rows[first]], self.groups.depth)
        own[group, :, first] = self.basis[group, at]
        flat = own.reshape(len(self.tied), -1)
        return flat - self.tied @ low[: len(self.root)], low

    def _low_rank(self, rows: Ints) -> Floats:
        """Return the parts of ``rows`` (k,) in the known ones, and in the border, (m + r, k).

        The first are minus of what those take of a group's row; and G^-T of a known one.
        """
        n, known = len(self.groups.place), len(self.root)
        first, last = rows[rows < n], rows[rows >= n] - n
        group, at = np.divmod(self.groups.place[first], self.groups.depth)
        tied = self.tied.reshape(*self.groups.own.shape, known)
        low = np.zeros((known + self.columns.shape[1], len(rows)))
        low[:known, rows < n] = np.einsum("ks,ksm->mk", self.basis[group, at], tied[group])
        low[:known, rows >= n] = -np.linalg.inv(self.root).T[:, last]
        low[known:, rows < n] = self.along[self.groups.place[first]].T
        low[known:, rows >= n] = self.below[last].T
        return low

    def among(self, rows: Ints) -> Floats:
        """Return J N^-1 J' between some ``rows`` (k,), (k, k)."""
        n, known = len(self.groups.place), len(self.root)
        low, mine = self._low_rank(rows), rows < n
        found = low[known:].T @ low[known:] - low[:known].T @ low[:known]
        group, at = np.divmod(self.groups.place[rows[mine]], self.groups.depth)
        basis = self.basis[group, at]
        found[np.ix_(mine, mine)] += basis @ basis.T * (group[:, None] == group)
        last = np.flatnonzero(~mine)
        found[last[:, None], last] += (rows[last][:, None] == rows[last]) * 1.0
        return np.asarray(found)

    def among_each(self, rows: Ints) -> Floats:
        """Return J N^-1 J' between the rows of each of many groups (g, e), (g, e, e)."""
        n, known = len(self.groups.place), len(self.root)
        if (rows >= n).any():
            return super().among_each(rows)
        low = self._low_rank(rows.ravel()).T.reshape(*rows.shape, -1)
        group, at = np.divmod(self.groups.place[rows], self.groups.depth)
        basis, alike = self.basis[group, at], group[:, :, None] == group[:, None]
        border, tied = low[:, :, known:], low[:, :, :known]
        found = border @ border.swapaxes(1, 2) - tied @ tied.swapaxes(1, 2)
        return np.asarray(found + basis @ basis.swapaxes(1, 2) * alike)

    @cached_property
    def leverage(self) -> Floats:
        """The diagonal (n + m,) of J N^-1 J'."""
        tied = self.basis @ self.tied.reshape(*self.groups.own.shape, -1)
        own = (self.basis**2).sum(axis=2) - (tied**2).sum(axis=2)
        first = own.ravel()[self.groups.place] + (self.along[self.groups.place] ** 2).sum(axis=1)
        inverse = np.linalg.inv(self.root)
        known = 1.0 - (inverse**2).sum(axis=1) + (self.below**2).sum(axis=1)
        return np.append(first, known)

    def sensitivity(self, outputs: Outputs, rows: Ints) -> Sensitivity:
        """Return what unit errors of some ``rows`` (k,) do to ``outputs`` (o,) by few numbers.

        By way of the border all feel them, else those of their own groups.
        """
        groups = self.groups
        if (rows >= len(groups.place)).any():
            return super().sensitivity(outputs, rows)
        group, at = np.divmod(groups.place[rows], groups.depth)
        felt = (self.inverse[group] @ self.basis[group, at][:, :, None])[:, :, 0]  # (k, s)
        unknown, real = groups.own[group], groups.own[group] >= 0
        error = np.broadcast_to(np.arange(len(rows))[:, None], real.shape)
        shape = outputs.few.shape[1], len(rows)
        own = csr_array(coo_array((felt[real], (unknown[real], error[real])), shape=shape))
        along = np.concatenate([self._low_rank(rows), np.asarray((own.T @ outputs.common.T).T)])
        own = csr_array(outputs.few @ own)
        touched = np.flatnonzero(np.diff(own.indptr))
        if self._carried.get("of") is not outputs:
            by = np.hstack([outputs.times(self._carriers), outputs.share])
            self._carried.update({"of": outputs, "by": by})
        return Sensitivity(along, self._carried["by"], touched, own[touched].toarray())

    @cached_property
    def _carried(self) -> dict[str, Any]:
        """What outputs that were asked for last feel of the known rows and the border."""
        return {}

    @property
    def _carriers(self) -> Floats:
        """Unknowns (p + q, m + r) by the parts that :meth:`_low_rank` returns."""
        known = np.zeros((len(self.columns), len(self.root)))
        shape = (*self.groups.own.shape, len(self.root))
        _to_own(self.groups, known, -(self.inverse @ self.tied.reshape(shape)))
        return np.hstack([known, self.columns])


def _apart(
    few: csr_array, row: Ints, joined: Ints | None
) -> tuple[Bools, Ints, Ints, Ints] | None:
    """Return which unknowns (p,) are own to groups, and which of these each is in; None: no such.

    With the labels (n + p,) of rows and unknowns, and those of the groups. ``row``: of each entry.
    """
    n, p = few.shape
    column = few.indices
    count = np.bincount(column, minlength=p)
    # what many feel joins everything: many is between one group's rows and all of them
    alone = (count > 0) & (count <= np.sqrt(n * np.median(count[count > 0])))
    if joined is not None:
        alone[joined] = False
    first = None
    while alone.any():
        inside = alone[column]
        ones = np.ones(int(inside.sum()))
        graph = coo_array((ones, (row[inside], n + column[inside])), shape=(n + p, n + p))
        label = connected_components(graph, directed=False)[1]
        groups, group = np.unique(label[n:][alone], return_inverse=True)
        if len(groups) > 1:
            first = first or (alone, label, groups, group)
            if np.bincount(group).max() <= LARGEST_SHARE * alone.sum():
                return alone, label, groups, group
        # else two sides that feel each other: those are groups which fewer feel
        alone = alone & (count < NEARLY_AS_MANY * count[alone].max())
    return first


def _own_of(groups: Groups, columns: Floats) -> Floats:
    """Return ``columns`` (p, k) of the own unknowns of each group, (g, s, k)."""
    return np.asarray(np.where(groups.own[:, :, None] >= 0, columns[groups.own], 0.0))


def _to_own(groups: Groups, columns: Floats, own: Floats) -> None:
    """Add ``own`` (g, s, k) to the ``columns`` (p, k) of the own unknowns of each group."""
    real = groups.own >= 0
    columns[groups.own[real]] += own[real]


def _determined(rows: Floats, open_: float) -> tuple[Floats, Floats]:
    """Return what ``rows`` (n, c) determine: W, N^-1 = WW' (c, r), and what they do not (c, k).

    They are what is left of columns of length 1: nothing where that is a share ``open_`` of it.
    """
    _, share, turn = np.linalg.svd(_triangle(rows))
    determined = np.arange(rows.shape[1]) < (share > open_ * share.max(initial=1.0)).sum()
    return turn[determined].T / share[: int(determined.sum())], turn[~determined].T


def _triangle(matrix: Floats) -> Floats:
    """Return R of the QR decomposition of a matrix (n, p)."""
    return np.asarray(np.linalg.qr(matrix, mode="r"))


def within(group: Ints) -> Ints:
    """Return which one of its group each member (k,) is, from 0."""
    order = np.argsort(group, kind="stable")
    sizes = np.bincount(group)
    found = np.empty(len(group), dtype=np.int64)
    found[order] = np.arange(len(group)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    return found
