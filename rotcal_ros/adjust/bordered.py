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

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from scipy.sparse import bsr_array, coo_array, coo_matrix, csc_array, csr_array
from scipy.sparse.csgraph import connected_components

from rotcal_ros.adjust.kernels import OPEN, Design, Kernel, dense, squares_outside
from rotcal_ros.adjust.outputs import Outputs
from rotcal_ros.adjust.sensitivity import Sensitivity
from rotcal_ros.foundation.arrays import Bools, Floats, Ints

LARGEST_SHARE: Final = 1.0 / 3.0
"""Share of all unknowns that are in groups which the largest of them should not exceed."""
NEARLY_AS_MANY: Final = 0.9
"""Share of the most rows that feel an unknown from which another is felt by as many."""
DENSE: Final = 4
"""Outputs of which more than one in DENSE of the numbers is not zero are written out."""
MOST_WHOLE: Final = 2000
"""Unknowns up to which normal equations are written out (32 MB)."""
SURE: Final = 1e-10
"""Least eigenvalue, per largest, of normal equations by which rows become nearly white."""
MANY: Final = 4096
"""Rows that are made white, or summed up, at once."""
FEW_GROUPS: Final = 256
"""Groups whose rows are summed up at once."""
FIRM: Final = 1e-6
"""Share of its length that the column of an unknown has to have beside those before it."""
WEAK: Final = 0.01
"""Share that its group leaves of a combination of rows, below which it counts as nothing at first.
"""


@dataclass(frozen=True, eq=False)
class SparseDesign(Design):
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

    def weighted(self, weight: Floats) -> SparseDesign:
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

    def transpose_times(self, y: Floats) -> Floats:
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

    def rows_times(self, which: Ints, x: Floats) -> Floats:
        """Return some rows times ``x`` (p + q, k)."""
        n, p = self.few.shape
        found = np.empty((len(which), x.shape[1]))
        found[which < n] = self.few[which[which < n]] @ x[:p]
        found[which >= n] = self.known[which[which >= n] - n] @ x[:p]
        return found if self.extra is None else found + self.extra[which] @ x[p:]

    def beside(self, rows: Floats | csr_array) -> SparseDesign:
        """Return the design with further ``rows`` (k, p) at its end."""
        if isinstance(rows, csr_array) and not len(self.known):
            n = self.few.shape[0] + rows.shape[0]
            data = np.concatenate([self.few.data, rows.data])
            indices = np.concatenate([self.few.indices, rows.indices])
            begin = np.append(self.few.indptr, self.few.indptr[-1] + rows.indptr[1:])
            return replace(self, few=csr_array((data, indices, begin), shape=(n, rows.shape[1])))
        return replace(self, known=np.concatenate([self.known, dense(rows)]))

    def with_extra(self, columns: Floats) -> SparseDesign:
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
    def prefers_normal_equations(self) -> bool:  # type: ignore[override]
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
        return None if self.structure is None else BorderedKernel.of(self, self.structure, weak)


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
        at, at_row = index_within_group(group), index_within_group(of_row)
        size, depth = int(at.max()) + 1, int(at_row.max()) + 1
        own, shared = np.full((len(groups), size), -1), np.flatnonzero(~alone)
        own[group, at] = np.flatnonzero(alone)
        slot = np.zeros(p, dtype=np.int64)
        slot[alone], slot[~alone] = at, size + np.arange(len(shared))
        lacking, absent = np.nonzero(own < 0)
        more = index_within_group(lacking)
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

    def stacked(self, design: SparseDesign) -> tuple[Floats, Floats]:
        """Return rows of each group: of its own unknowns (g, d, s), of the border (g, d, c)."""
        (groups, size), border = self.own.shape, len(self.shared)
        flat = np.zeros(groups * self.depth * (size + border))
        flat[self.entries], flat[self.missing] = design.few.data, 1.0
        stack = flat.reshape(groups, self.depth, size + border)
        own, shared = stack[:, :, :size], stack[:, :, size:]
        if design.extra is None:
            return own, shared
        extra = np.zeros((groups * self.depth, design.columns.shape[1]))
        extra[self.place] = design.columns[: len(self.place)]
        return own, np.concatenate([shared, extra.reshape(groups, self.depth, -1)], axis=2)


@dataclass(frozen=True, eq=False)
class BorderedKernel(Kernel):
    """The kernel of a design whose unknowns fall into groups and a border, see above.

    ``basis`` (g, d, s): Q, and ``inverse`` (g, s, s): R^-1 of each group. ``tied`` (g s, m):
    H'G^-1 and ``root`` (m, m): G of orthogonal rows, M = G'G. ``columns`` (p + q, r) of the
    unknowns, times their transposed, hold what the border adds to N^-1. ``low`` (g d + m, m + r):
    J N^-1 J' is a block diagonal beside this low rank of all rows, those of groups and the known
    ones. Its first columns count minus, what known rows take of those of a group; the others are
    what rows feel of ``columns``.
    """

    design: SparseDesign
    directions: Floats
    groups: Groups
    basis: Floats
    inverse: Floats
    tied: Floats
    root: Floats
    columns: Floats
    low: Floats

    @classmethod
    def of(
        cls, design: SparseDesign, groups: Groups, open_: float = OPEN
    ) -> BorderedKernel | None:
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
        inverse, on_basis = np.linalg.inv(triangle), np.swapaxes(basis, 1, 2) @ border
        known = np.hstack([design.known[:, groups.shared], design.columns[n:]])
        of_own = _own_of(groups, design.known.T)  # (g, s, m)
        of_own = (np.swapaxes(inverse, 1, 2) @ of_own).reshape(count * size, -1)  # H'
        _, grown, ways = np.linalg.svd(_triangle(np.concatenate([np.eye(len(known)), of_own])))
        root, tied = grown[:, None] * ways, of_own @ (ways.T / grown)
        left_known = known - of_own.T @ on_basis.reshape(count * size, known.shape[1])
        white = np.linalg.solve(root.T, left_known)
        flat = border.reshape(count * groups.depth, known.shape[1])
        length = np.sqrt(np.einsum("rc,rc->c", flat, flat) + (known**2).sum(axis=0))
        length = np.where(length > 0.0, length, 1.0)
        border -= basis @ on_basis  # what is left beside the own unknowns
        ways, nothing = _determined((flat, white), length, open_)
        by_known = (tied @ white).reshape(on_basis.shape)
        moved, m = -(on_basis + by_known), len(known)
        at = np.append(groups.shared, np.arange(design.few.shape[1], sum(design.shape[1:])))

        low = np.empty((len(flat) + m, m + ways.shape[1]))
        if m:
            border -= basis @ by_known
            low[: len(flat), :m] = (basis @ tied.reshape(count, size, m)).reshape(-1, m)
            low[len(flat) :, :m] = -np.linalg.inv(root)
            low[len(flat) :, m:] = np.linalg.solve(root, white @ ways)
        np.matmul(flat, ways, out=low[: len(flat), m:])
        del blocks, border, flat  # of many groups that is much

        def with_own(found: Floats) -> Floats:
            every = np.zeros((sum(design.shape[1:]), found.shape[1]))
            every[at] = found
            _to_own(groups, every, inverse @ (moved @ found))
            return every

        return cls(
            design, with_own(nothing), groups, basis, inverse, tied, root, with_own(ways), low,
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
        m = len(self.root)
        found = self.columns @ (self.low[: len(stack), m:].T @ stack)
        found += self.columns @ (self.low[len(stack) :, m:].T @ read[n:])
        own = own + self.tied @ np.linalg.solve(self.root.T, known)
        _to_own(groups, found, self.inverse @ own.reshape(*groups.own.shape, -1))
        return np.asarray(found.reshape(-1, *white.shape[1:]))

    def hat_block(self, rows: Ints) -> Floats:
        """Return J N^-1 J' between some ``rows`` (k,), (k, k)."""
        return np.asarray(self.hat_blocks(rows[None])[0][0])

    def hat_blocks(self, rows: Ints) -> tuple[Floats, Ints]:
        """Return J N^-1 J' between rows of groups (g, e), each kind once (k, e, e)."""
        place, stacked = self._place[rows], self._stacked
        low, mine = self.low[place], place < stacked
        group, at = np.divmod(np.minimum(place, stacked - 1), self.groups.depth)
        basis = self.basis[group, at] * mine[:, :, None]
        alike = group[:, :, None] == group[:, None]
        found = (low * self._signs) @ low.swapaxes(1, 2)
        found += basis @ basis.swapaxes(1, 2) * alike
        if not mine.all():
            found += (place[:, :, None] == place[:, None]) & ~mine[:, :, None]
        return found, np.arange(len(rows))

    def together(self, rows: Ints, white: Floats) -> tuple[float, int]:
        """Return T = r'R^+r of the residuals r = ``white`` (k,) of some ``rows``, and R's rank.

        What groups leave of their rows, 1 - QQ', is made white along its axes. Where it is nearly
        nothing it is taken for 1, and what that is too much joins the low rank.
        """
        place, of_groups = self._place[rows], self._stacked
        mine = place < of_groups
        number, line = np.divmod(np.minimum(place, of_groups - 1), self.groups.depth)
        basis = np.where(mine[:, None], self.basis[number, line], 0.0)
        each = np.where(mine, number, len(self.basis) + place)  # known rows are alone
        group = np.unique(each, return_inverse=True)[1]
        at = group, index_within_group(group)
        shape = [int(k.max()) + 1 for k in at]

        def stacked(values: Floats) -> Floats:
            found = np.zeros((*shape, values.shape[1]))
            found[at] = values
            return found

        own = stacked(np.hstack([basis, ~mine[:, None]]))
        taken, axes = np.linalg.eigh(own @ own.swapaxes(1, 2))
        weak = taken > 1.0 - WEAK
        scale = 1.0 / np.sqrt(np.where(weak, 1.0, 1.0 - taken))[:, :, None]
        turned = axes.swapaxes(1, 2) @ stacked(np.hstack([white[:, None], self.low[place]]))
        turned = (scale * turned).reshape(weak.size, -1)
        lack = np.zeros((weak.size, int(weak.sum())))
        lack[np.flatnonzero(weak), np.arange(lack.shape[1])] = np.sqrt(taken[weak])
        sign = np.append(self._signs, np.ones(lack.shape[1]))
        squares, rank = squares_outside(turned[:, 0], np.hstack([turned[:, 1:], lack]), sign)
        return squares, rank - weak.size + len(rows)

    @cached_property
    def leverage(self) -> Floats:
        """The diagonal (n + m,) of J N^-1 J'."""
        own = np.append((self.basis**2).sum(axis=2), np.ones(len(self.root)))
        beside = np.einsum("nr,nr,r->n", self.low, self.low, self._signs)
        return np.asarray((own + beside)[self._place])

    def hat_square_sums(self, share: Floats) -> Floats:
        """Return sums of squares (c, c) of J N^-1 J' between rows, ``share`` (c, n + m) of each.

        Of blocks QQ' on the diagonal, and the low rank beside them.
        """
        sign, c, weight = self._signs, len(share), self._stacked_share(share)
        known = weight[:, self._stacked :]
        squares = (self.low[self._stacked :] ** 2) @ sign
        found = (known * (1.0 + 2.0 * squares)) @ known.T
        for begin in range(0, len(self.basis), FEW_GROUPS):
            every = self._moments(weight, slice(begin, begin + FEW_GROUPS))
            own, mixed = (each.reshape(c, -1) for each in every)
            found += own @ own.T + 2.0 * (every[1] * sign).reshape(c, -1) @ mixed.T
        low = np.stack([self._low_moment(each) for each in weight])
        found += (low * sign * sign[:, None]).reshape(c, -1) @ low.reshape(c, -1).T
        return np.asarray(found)

    def output_products(
        self, outputs: Outputs, first: Ints, second: Ints, weight: Floats
    ) -> Floats:
        """Return sums (o, c) of what a unit of one row does to each output times one of another.

        Of the pairs ``first`` and ``second`` (k,) with the ``weight`` (c, k).
        """
        if _dense(outputs) or not np.array_equal(first, second):
            return super().output_products(outputs, first, second, weight)
        share = np.stack(
            [np.bincount(first, each, len(self._place)).astype(np.float64) for each in weight]
        )
        influence, found = self._influence_on(outputs), np.empty((len(outputs), len(share)))
        groups, size = self.groups.own.shape
        common = influence.common.reshape(-1, groups, size)
        for k, each in enumerate(self._stacked_share(share)):
            own, mixed = (moment[0] for moment in self._moments(each[None], slice(None)))
            low = self._low_moment(each)
            mixed = np.concatenate([mixed, own @ common.transpose(1, 2, 0)], axis=2)
            along = mixed.reshape(groups * size, -1)
            beside = influence.common @ along
            whole = np.vstack([np.hstack([low, beside[:, : len(low)].T]), beside])
            blocks = bsr_array((own, np.arange(groups), np.arange(groups + 1)))
            squares = (influence.own * (influence.own @ blocks)).sum(axis=1)
            both = (2.0 * (influence.own @ along) + influence.low @ whole) * influence.low
            found[:, k] = squares + both.sum(axis=1)
        return found

    def variances_of(self, outputs: Outputs) -> Floats:
        """Return the variances (o,) of ``outputs``."""
        if _dense(outputs):
            return super().variances_of(outputs)
        influence = self._influence_on(outputs)
        root, core = influence.spread(self._signs)
        return np.asarray((influence.own**2).sum(axis=1) + ((root @ core) * root).sum(axis=1))

    def covariance_of(self, outputs: Outputs) -> Floats:
        """Return the covariance (o, o) of ``outputs``."""
        parts = self.parts_of(outputs)
        if parts is None:
            return super().covariance_of(outputs)
        near, root, core = parts
        found, own = (root @ core) @ root.T, coo_array(near @ near.T)
        found[own.row, own.col] += own.data
        return np.asarray(found)

    def parts_of(self, outputs: Outputs) -> tuple[csr_array, Floats, Floats] | None:
        """Return what outputs feel of their own unknowns, and of those in common."""
        if _dense(outputs):
            return None
        influence = self._influence_on(outputs)
        return influence.own, *influence.spread(self._signs)

    def sensitivity(self, outputs: Outputs, rows: Ints) -> Sensitivity:
        """Return what unit errors of some ``rows`` (k,) do to ``outputs`` (o,) by few numbers.

        By way of the border all feel them, else those of their own groups.
        """
        influence, place = self._influence_on(outputs), self._place[rows]
        mine = np.flatnonzero(place < self._stacked)
        along = np.zeros((influence.low.shape[1], len(rows)))
        along[: len(self._signs)] = self.low[place].T
        along[len(self._signs) :, mine] = influence.shared[place[mine]].T
        columns = influence.lines
        begin = columns.indptr[place[mine]]
        many = columns.indptr[place[mine] + 1] - begin
        entry = np.repeat(begin - np.cumsum(many) + many, many) + np.arange(many.sum())
        touched, which = np.unique(columns.indices[entry], return_inverse=True)
        own = np.zeros((len(touched), len(rows)))
        own[which, np.repeat(mine, many)] = columns.data[entry]
        return Sensitivity(along, influence.low, touched, own)

    def response(self, outputs: Outputs, rows: Ints) -> Floats:
        """Return what unit errors of some ``rows`` (k,) do to ``outputs`` C: C N^-1 J', (o, k)."""
        return self.sensitivity(outputs, rows).dense()

    @cached_property
    def _place(self) -> Ints:
        """Where each row (n + m,) stands: those of groups as they are stacked, then the known."""
        return np.append(self.groups.place, self._stacked + np.arange(len(self.root)))

    @property
    def _stacked(self) -> int:
        """How many rows g d the groups have as they are stacked."""
        return len(self.low) - len(self.root)

    @cached_property
    def _signs(self) -> Floats:
        return np.repeat([-1.0, 1.0], [len(self.root), self.columns.shape[1]])

    def _stacked_share(self, share: Floats) -> Floats:
        """Return the ``share`` (c, n + m) of each row where it stands, (c, g d + m)."""
        weight = np.zeros((len(share), len(self.low)))
        weight[:, self._place] = share
        return weight

    def _moments(self, weight: Floats, some: slice) -> tuple[Floats, Floats]:
        """Return sums over the rows of ``some`` groups: of Q'Q (c, g, s, s), of Q'l (c, g, s, l).

        ``weight`` (c, g d + m) of each row, l its part of :attr:`low`.
        """
        basis, lines = self.basis[some], self.low[: self._stacked]
        of_groups = weight[:, : self._stacked].reshape(len(weight), *self.basis.shape[:2])
        turned = basis.swapaxes(1, 2) * of_groups[:, some, None]
        return turned @ basis, turned @ lines.reshape(*self.basis.shape[:2], -1)[some]

    def _low_moment(self, weight: Floats) -> Floats:
        """Return the sum of l'l, of the ``weight`` (g d + m,) of each row."""
        found, used = np.zeros((self.low.shape[1],) * 2), np.flatnonzero(weight)
        for rows in np.array_split(used, len(used) // MANY + 1):
            some = self.low[rows]
            found += some.T @ (some * weight[rows, None])
        return found

    def _influence_on(self, outputs: Outputs) -> _InfluenceOfGroups:
        """Return what ``outputs`` (o,) feel of the groups, the known rows and the border."""
        if not self._last or self._last[0][0] is not outputs:
            few, common, share = outputs.few, outputs.common, outputs.share
            (groups, size), real = self.groups.own.shape, self.groups.own >= 0
            column = np.broadcast_to(np.arange(groups * size).reshape(groups, 1, size),
                                     self.inverse.shape)[real]  # fmt: skip
            begin = np.arange(0, column.size + 1, size)
            lines = csr_array((self.inverse[real].ravel(), column.ravel(), begin),
                              shape=(len(column), groups * size))  # fmt: skip
            unknown = self.groups.own[real]
            mine, common = csr_array(few[:, unknown] @ lines), common[:, unknown] @ lines
            tied = -(mine @ self.tied + share @ (common @ self.tied))
            low = np.hstack([tied, outputs.times(self.columns), share])
            influence = _InfluenceOfGroups(mine, low, common, self.basis)
            self._last[:] = [(outputs, influence)]
        return self._last[0][1]

    @cached_property
    def _last(self) -> list[tuple[Outputs, _InfluenceOfGroups]]:
        """The outputs that were asked for last, and what they feel."""
        return []


@dataclass(frozen=True, eq=False)
class _InfluenceOfGroups:
    """What o outputs feel of u, the own unknowns of groups along Q, and of a low rank.

    ``own`` (o, g s): of u alone. ``low`` (o, m + r + k): of the low rank, and of k rows ``common``
    (k, g s) of u, which many share. ``basis`` (g, d, s): Q.
    """

    own: csr_array
    low: Floats
    common: Floats
    basis: Floats

    @cached_property
    def lines(self) -> csc_array:
        """What they feel of the rows (o, g d) of groups by ``own``."""
        each = np.arange(len(self.basis) + 1)
        return csc_array(self.own @ bsr_array((self.basis.swapaxes(1, 2), each[:-1], each)))

    @cached_property
    def shared(self) -> Floats:
        """What the rows (g d, k) of groups do by ``common``."""
        k, (groups, rows, own) = len(self.common), self.basis.shape  # k may be 0
        found = self.basis @ self.common.reshape(k, groups, own, 1)
        return np.ascontiguousarray(found.reshape(k, groups * rows).T)

    def spread(self, sign: Floats) -> tuple[Floats, Floats]:
        """Return L (o, l) and M (l, l): LML' is the covariance beside that by own unknowns."""
        k, m = len(self.common), len(sign)
        core = np.zeros((m + 2 * k, m + 2 * k))
        core[np.arange(m), np.arange(m)] = sign
        core[m : m + k, m : m + k] = self.common @ self.common.T
        core[m : m + k, m + k :] = core[m + k :, m : m + k] = np.eye(k)
        return np.hstack([self.low, self.own @ self.common.T]), core


def _dense(outputs: Outputs) -> bool:
    """Whether ``outputs`` feel so much each that nothing is saved by what they do not feel."""
    return bool(outputs.few.nnz * DENSE > outputs.few.shape[0] * outputs.few.shape[1])


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
        # a matrix, not an array: of 64-bit indices scipy 1.11 makes labels that are wrong
        graph = coo_matrix((ones, (row[inside], n + column[inside])), shape=(n + p, n + p))
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


def _determined(rows: Sequence[Floats], length: Floats, open_: float) -> tuple[Floats, Floats]:
    """Return what ``rows`` (n, c) determine: W, N^-1 = WW' (c, r), and what they do not (c, k).

    They are what is left of columns of a ``length`` (c,): nothing where that is a share ``open_``
    of it.
    """
    products = sum((part.T @ part for part in rows), np.zeros((len(length), len(length))))
    squares, axes = np.linalg.eigh(products / length / length[:, None])
    if len(squares) and squares[0] > max(SURE, open_**2) * max(squares[-1], 1.0):
        ways = axes / np.sqrt(squares) / length[:, None]
        # of what is nearly white once more: that gives back the digits which squares took, as in
        # CholeskyQR2 (Yamamoto et al. 2015)
        every = (
            some @ ways for part in rows for some in np.array_split(part, len(part) // MANY + 1)
        )
        again, turn = np.linalg.eigh(sum(white.T @ white for white in every))
        return ways @ (turn / np.sqrt(again)), np.zeros((len(length), 0))
    _, share, turn = np.linalg.svd(_triangle(np.concatenate(rows) / length))
    determined = np.arange(len(length)) < (share > open_ * share.max(initial=1.0)).sum()
    ways, nothing = turn[determined].T / share[: int(determined.sum())], turn[~determined].T
    return ways / length[:, None], nothing / length[:, None]


def _triangle(matrix: Floats) -> Floats:
    """Return R of the QR decomposition of a matrix (n, p)."""
    return np.asarray(np.linalg.qr(matrix, mode="r"))


def index_within_group(group: Ints) -> Ints:
    """Return which one of its group each member (k,) is, from 0."""
    order = np.argsort(group, kind="stable")
    sizes = np.bincount(group)
    found = np.empty(len(group), dtype=np.int64)
    found[order] = np.arange(len(group)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    return found
