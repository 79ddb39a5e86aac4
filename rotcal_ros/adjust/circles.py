"""Least squares of circles that are read against each other, order by order.

Where every place of a circle is read at every shift against another, the normal matrix is block
circulant: a discrete Fourier transform along the places takes it apart into orders, of each of
which there are as many unknowns as circles. What belongs to no circle, as the zero of a setting,
meets order 0 alone. So n places cost n ln n where whole matrices cost n^3 (Davis, *Circulant
Matrices*, 1979). Readings that are missing, left out or there twice, and effects that became
unknowns, are a low rank beside that (Woodbury).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, eigvalsh_tridiagonal, lapack
from scipy.sparse import csr_array, vstack
from scipy.sparse.linalg import LinearOperator, cg

from rotcal_ros.adjust.arrow import FewEach
from rotcal_ros.foundation.arrays import Bools, Floats, Ints

FIRM: Final = 1e-6
"""Least eigenvalue of normal equations of unit diagonal whose inverse keeps nine digits."""
ROUGH: Final = 1e-12
"""The same of a step, or of a variance that is only compared."""
OPEN: Final = 1e-12
"""Eigenvalue of order 0, of unit diagonal, below which nothing determines a direction."""
LARGE: Final = 1000
"""Places of a circle from which on steps are iterated: whole matrices cost their third power."""
STEPS: Final = 300
"""Steps of conjugate gradients after which another way is taken."""
CONVERGED: Final = 1e-12
"""Share of what is asked, and of the sizes it is the sum of, that such a solution may leave."""
STEADY: Final = 1e-3
"""Relative change of an extreme eigenvalue in LOOKED steps that ends looking for it."""
LOOKED: Final = 10
SAME: Final = 1e-12
"""Difference of squared weights, in the largest of them, that is rounding."""
AT_ONCE: Final = 1024
"""Rows or columns that are worked out at once: what is dense of them stays small."""

Orders: TypeAlias = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class Turns:
    """Which places rows read: those of one turn read circles that are shifted alike.

    There are C circles of ``size`` N places each, whose unknowns come first, and s others. The row
    at place j of turn t is ``sign`` (t, C) times place j + ``shift`` (t, C) of each circle, and
    ``tied`` (t, s) times the others. ``turn`` (n,), ``place`` (n,): those of each row.
    """

    size: int
    sign: Floats
    shift: Ints
    tied: Floats
    turn: Ints
    place: Ints

    @classmethod
    def of(cls, rows: csr_array, circles: int, size: int) -> Turns | None:
        """Return those of ``rows`` (n, p); None where turns are not nearly complete."""
        n, p = rows.shape
        if circles * size > p or not rows.nnz:
            return None
        row, column = np.repeat(np.arange(n), np.diff(rows.indptr)), rows.indices
        inside = column < circles * size
        circle, at = np.divmod(column[inside], size)
        sign, place = np.zeros((n, circles)), np.zeros((n, circles), dtype=np.int64)
        sign[row[inside], circle], place[row[inside], circle] = rows.data[inside], at
        there = sign != 0.0
        if there.sum() != inside.sum() or not there.any(axis=1).all():
            return None  # a row reads one place of a circle, and of one circle at least
        begin = place[np.arange(n), there.argmax(axis=1)]
        shift = np.where(there, (place - begin[:, None]) % size, 0)
        tied = np.zeros((n, p - circles * size))
        tied[row[~inside], column[~inside] - circles * size] = rows.data[~inside]
        kinds, turn = np.unique(np.hstack([sign, shift, tied]), axis=0, return_inverse=True)
        found = cls(
            size, kinds[:, :circles], kinds[:, circles : 2 * circles].astype(np.int64),
            kinds[:, 2 * circles :], turn.ravel(), begin,
        )  # fmt: skip
        usual, odd = found.shares(np.ones(n))[1:]
        return found if usual.all() and odd.sum() <= size else None

    @property
    def circles(self) -> int:
        """The number C of circles."""
        return int(self.sign.shape[1])

    @property
    def unknowns(self) -> int:
        """The number p of unknowns."""
        return int(self.circles * self.size + self.tied.shape[1])

    def shares(self, weight: Floats) -> tuple[Floats, Floats, Bools]:
        """Return squared weights (t, N) by place, the usual (t,) of a turn, and which differ.

        ``weight`` (n,): of each row.
        """
        cell, whole = self.turn * self.size + self.place, self.sign.shape[0] * self.size
        cells: Floats = np.bincount(cell, weight**2, whole).astype(np.float64)
        share = cells.reshape(-1, self.size)
        usual = np.median(share, axis=1)
        return share, usual, np.abs(share - usual[:, None]) > SAME * share.max()

    def rows_of(self, turn: Ints, place: Ints) -> csr_array:
        """Return the rows (r, p) at places of turns, each (r,)."""
        circle = np.arange(self.circles) * self.size
        at = circle + (place[:, None] + self.shift[turn]) % self.size
        others = np.broadcast_to(
            np.arange(self.circles * self.size, self.unknowns), self.tied[turn].shape
        )
        column = np.hstack([at, others])
        data = np.hstack([self.sign[turn], self.tied[turn]])
        begin = np.arange(len(turn) + 1) * column.shape[1]
        return csr_array((data.ravel(), column.ravel(), begin), shape=(len(turn), self.unknowns))


@dataclass(frozen=True, eq=False)
class Circular(FewEach):
    """A design (n, p + q) of the rows of ``turns``, each times its ``weight`` (n,).

    ``few`` (n, p): those rows, weighted; ``extra`` (n, q): columns of further unknowns, too.
    Nothing is ``known`` beside them.
    """

    turns: Turns
    weight: Floats
    extra: Floats

    @classmethod
    def of(cls, rows: csr_array, circles: int, size: int) -> Circular | csr_array:
        """Return the design of ``rows`` (n, p), whose first unknowns are those of circles.

        These are ``circles`` of ``size`` places each. Where the turns are not nearly complete,
        the ``rows`` come back as they are: then they are solved as any others.
        """
        turns = Turns.of(rows, circles, size)
        if turns is None:
            return rows
        n, p = rows.shape
        return cls(rows, np.zeros((0, p)), turns, np.ones(n), np.zeros((n, 0)))

    def dense(self) -> Floats:
        """Return the whole design."""
        return np.concatenate([self.few.toarray(), self.extra], axis=1)

    def weighted(self, weight: Floats) -> Circular:
        """Return the same, its rows times ``weight`` (n,)."""
        few = super().weighted(weight).few
        return replace(
            self, few=few, weight=self.weight * weight, extra=self.extra * weight[:, None]
        )

    def times(self, x: Floats) -> Floats:
        """Return the design times ``x`` (p + q,) or (p + q, k)."""
        p = self.few.shape[1]
        return np.asarray(self.few @ x[:p] + self.extra @ x[p:])

    def adjoint(self, y: Floats) -> Floats:
        """Return the transposed design times ``y`` (n,) or (n, k)."""
        return np.concatenate([self.few.T @ y, self.extra.T @ y])

    def beside(self, rows: Floats) -> FewEach:
        """Return the design with further ``rows`` (k, p) at its end, turns too where they can."""
        few = csr_array(vstack([self.few, csr_array(rows)], format="csr"))
        found = Circular.of(few, self.turns.circles, self.turns.size)
        return found if isinstance(found, Circular) else FewEach(self.few, rows)

    def with_extra(self, columns: Floats) -> Circular:
        """Return the design with the ``columns`` (n, q) of further unknowns."""
        return replace(self, extra=np.concatenate([self.extra, columns], axis=1))

    def rows(self, which: Ints) -> Floats:
        """Return some rows (r, p + q) as a whole."""
        return np.concatenate([self.few[which].toarray(), self.extra[which]], axis=1)


@dataclass(frozen=True, eq=False)
class Outputs:
    """Rows C (o, p) that differ little from one that they share: of many, little is kept.

    ``few`` (o, p) beside the row of ``common`` (g, p) that each belongs to, by ``part`` (o,).
    """

    few: csr_array
    common: Floats
    part: Ints

    @classmethod
    def of(cls, parts: Sequence[Floats]) -> Outputs:
        """Return those of ``parts`` (o, p), one below the other, that share a row each."""
        common = np.zeros((len(parts), parts[0].shape[1]))
        for k, rows in enumerate(parts):
            if len(rows):  # what two of three rows share
                common[k] = np.median(rows[[0, len(rows) // 2, -1]], axis=0)
        few = [csr_array(rows - row) for rows, row in zip(parts, common, strict=True)]
        part = np.repeat(np.arange(len(parts)), [len(rows) for rows in parts])
        return cls(csr_array(vstack(few, format="csr")), common, part)

    def __len__(self) -> int:
        """Return their number o."""
        return len(self.part)

    def first(self, count: int) -> Outputs:
        """Return the first ``count`` of them."""
        return replace(self, few=self.few[:count], part=self.part[:count])

    def times(self, x: Floats) -> Floats:
        """Return C times ``x`` (p + q,) or (p + q, k); the last q unknowns count nothing."""
        x = x[: self.common.shape[1]]
        return np.asarray(self.few @ x + (self.common @ x)[self.part])

    def parts(self, unknowns: int) -> Iterator[tuple[slice, Floats]]:
        """Yield some rows after the other, (r, ``unknowns``) and which they are."""
        more = ((0, 0), (0, unknowns - self.common.shape[1]))
        for begin in range(0, len(self), AT_ONCE):
            here = slice(begin, min(begin + AT_ONCE, len(self)))
            yield here, np.pad(self.few[here].toarray() + self.common[self.part[here]], more)

    @cached_property
    def lengths(self) -> Floats:
        """The length (o,) of each."""
        every = self.parts(self.common.shape[1])
        return np.concatenate([np.linalg.norm(rows, axis=1) for _, rows in every])

    @cached_property
    def felt(self) -> Bools:
        """Which unknowns (p,) one of them feels."""
        every = [(rows != 0.0).any(axis=0) for _, rows in self.parts(self.common.shape[1])]
        return np.asarray(np.any(every, axis=0))


@dataclass(frozen=True, eq=False)
class ByOrder:
    """The inverse normal matrix of complete ``turns``, order by order.

    ``inverse`` (N // 2 + 1, C, C): the pseudo inverse of each order but 0; ``zero`` (C + s,
    C + s): that of order 0, of sums of each circle over root N and the other unknowns. ``open``
    (C + s, k): directions of order 0 that nothing determines; ``lost``: how many of all others.
    """

    turns: Turns
    inverse: Orders
    zero: Floats
    open: Floats
    lost: int

    @classmethod
    def of(cls, turns: Turns, share: Floats) -> ByOrder | None:
        """Return that of rows with the squared weight ``share`` (t,) of their turn.

        None where an order is so badly determined that digits go.
        """
        size, orders = turns.size, np.arange(turns.size // 2 + 1)
        wave = _waves(turns, orders)
        normal = np.einsum("t,tch,tdh->hcd", share, wave.conj(), wave)
        at_zero = np.hstack([turns.sign, np.sqrt(size) * turns.tied])
        values, vectors, scale = _of_unit_diagonal((at_zero * share[:, None]).T @ at_zero)
        seen = values > OPEN
        length = np.sqrt(np.einsum("hcc->hc", normal).real)
        if (values[seen] < FIRM).any() or not length.all():
            return None
        length, inverse = length[1:, :, None], np.zeros_like(normal)
        each, axes = np.linalg.eigh(normal[1:] / length / length.swapaxes(1, 2))
        firm = each > OPEN
        if (each[firm] < FIRM).any():
            return None
        root = np.where(firm, 1.0 / np.sqrt(np.where(firm, each, 1.0)), 0.0)
        axes = root[:, None] * axes / length
        inverse[1:] = axes @ axes.conj().swapaxes(1, 2)
        # an order is a cosine and a sine, but for the last one of an even number of places
        twice = np.where(2 * orders[1:] == size, 1, 2)
        open_ = vectors[:, ~seen] / scale[:, None]
        at_root = vectors[:, seen] / np.sqrt(values[seen]) / scale[:, None]
        lost = int(twice @ (~firm).sum(axis=1))
        return cls(turns, inverse, at_root @ at_root.T, open_, lost)

    @cached_property
    def directions(self) -> Floats:
        """What nothing determines (p, k), as directions of the unknowns."""
        each = self.open[: self.turns.circles] / np.sqrt(self.turns.size)
        return np.concatenate(
            [np.repeat(each, self.turns.size, axis=0), self.open[self.turns.circles :]]
        )

    def times(self, right: Floats) -> Floats:
        """Return the inverse times ``right`` (p, k)."""
        size, circles = self.turns.size, self.turns.circles
        inside = right[: circles * size].reshape(circles, size, -1)
        orders = np.fft.rfft(inside, axis=1)
        zero = self.zero @ np.concatenate(
            [orders[:, 0].real / np.sqrt(size), right[circles * size :]]
        )
        found = (self.inverse @ orders.swapaxes(0, 1)).swapaxes(0, 1)
        found[:, 0] = zero[:circles] * np.sqrt(size)
        places = np.fft.irfft(found, size, axis=1).reshape(circles * size, -1)
        return np.concatenate([places, zero[circles:]])

    def variances(self, outputs: Outputs) -> Floats:
        """Return the variances (o,) of ``outputs``."""
        parts = outputs.parts(self.turns.unknowns)
        return np.concatenate([(rows * self.times(rows.T).T).sum(axis=1) for _, rows in parts])

    @cached_property
    def between(self) -> Floats:
        """What the inverse is between rows of unit weight, (t, t, N) by the step of their places.

        J N^-1 J' of the row at place j of one turn and that at place i of another: by j - i.
        """
        turns = self.turns
        wave = _waves(turns, np.arange(turns.size // 2 + 1))
        orders = np.einsum("tch,hcd,udh->tuh", wave, self.inverse, wave.conj())
        at_zero = np.hstack([turns.sign, np.sqrt(turns.size) * turns.tied])
        orders[:, :, 0] = at_zero @ self.zero @ at_zero.T
        return np.asarray(np.fft.irfft(orders, turns.size, axis=2))


def _waves(turns: Turns, orders: Ints) -> Orders:
    """Return by how much each order (h,) of each circle turns with the shift, (t, C, h)."""
    turned = 2j * np.pi / turns.size * turns.shift[:, :, None] * orders
    return np.asarray(turns.sign[:, :, None] * np.exp(turned))


def _of_unit_diagonal(square: Floats) -> tuple[Floats, Floats, Floats]:
    """Return eigenvalues and vectors of a ``square`` brought to unit diagonal, and the scale."""
    scale = np.sqrt(np.where(square.diagonal() > 0.0, square.diagonal(), 1.0))
    values, vectors = np.linalg.eigh(square / scale / scale[:, None])
    return values, vectors, scale


@dataclass(frozen=True, eq=False)
class Cofactors:
    """The inverse normal matrix of a circular ``design``: orders, and a low rank beside them.

    It is that of ``orders``, zero for further unknowns, and ``columns`` (p + q, r) times ``core``
    (r, r) times their transposed. What nothing determines stands still in some way that outputs
    must not feel.
    """

    design: Circular
    orders: ByOrder
    columns: Floats
    core: Floats

    @classmethod
    def of(cls, design: Circular, *, lost: bool = False) -> Cofactors | None:
        """Return those of a ``design``, weights included; None where they are not firm.

        Or where so many rows are missing that they are no low rank, or where an order but 0 is
        ``lost``, unless that may be.
        """
        turns = design.turns
        share, usual, odd = turns.shares(design.weight)
        if odd.sum() > turns.size:
            return None
        orders = ByOrder.of(turns, usual)
        if orders is None or (orders.lost and not lost):
            return None
        turn, place = np.nonzero(odd)
        more = (share - usual[:, None])[odd]
        rows = turns.rows_of(turn, place)
        columns = orders.times(rows.T.toarray())
        size = np.sqrt(np.abs(more))
        left = np.diag(np.sign(more)) + size[:, None] * (rows @ columns) * size
        core = _inverse(left)
        if core is None:
            return None
        alone = cls(replace(design, extra=design.extra[:, :0]), orders, columns * size, -core)
        return alone._with_extra(design)

    def _with_extra(self, design: Circular) -> Cofactors | None:
        """Return the same of a ``design`` with extra columns; None where they are not firm."""
        extra = design.extra
        felt = self.design.adjoint(extra)
        gain = self.times(felt)
        squares, whole = extra.T @ extra - felt.T @ gain, (extra**2).sum(axis=0)
        length = np.sqrt(np.where(whole > 0.0, whole, 1.0))
        inverse = _inverse(squares / length / length[:, None])
        if inverse is None:
            return None
        q = extra.shape[1]
        columns = np.block([[self.columns, -gain / length], [np.zeros((q, len(self.core))),
                                                            np.diag(1.0 / length)]])  # fmt: skip
        return Cofactors(design, self.orders, columns, np.asarray(block_diag(self.core, inverse)))

    @property
    def rank(self) -> int:
        """How many unknowns are determined."""
        return len(self.columns) - int(self.orders.open.shape[1]) - self.orders.lost

    def times(self, right: Floats) -> Floats:
        """Return the cofactors times ``right`` (p + q, k)."""
        p = self.design.turns.unknowns
        found = self.columns @ (self.core @ (self.columns.T @ right))
        found[:p] += self.orders.times(right[:p])
        return np.asarray(found)

    def solved(self, design: FewEach, read: Floats) -> Floats:
        """Return the unknowns (p + q,) of least squares from what was ``read`` (n,), whitened."""
        return self.times(design.adjoint(read)[:, None])[:, 0]

    def _low_rank(self, rows: Ints) -> Floats:
        """Return what the low rank does to some rows of the design, (k, r)."""
        p = self.design.turns.unknowns
        return np.asarray(
            self.design.few[rows] @ self.columns[:p] + self.design.extra[rows] @ self.columns[p:]
        )

    def among(self, rows: Ints) -> Floats:
        """Return J N^-1 J' between some ``rows`` (k,), (k, k)."""
        turns, weight = self.design.turns, self.design.weight[rows]
        turn, place = turns.turn[rows], turns.place[rows].astype(np.int32)
        step = (place[:, None] - place) % np.int32(turns.size)
        if len(np.unique(turn)) == 1:
            found = self.orders.between[turn[0], turn[0]][step]
        else:
            found = self.orders.between[turn[:, None], turn, step]
        found *= weight[:, None]
        found *= weight
        low = self._low_rank(rows)
        found += low @ self.core @ low.T
        return np.asarray(found)

    @property
    def leverage(self) -> Floats:
        """The diagonal (n,) of J N^-1 J'."""
        turns, every = self.design.turns, np.arange(len(self.design.weight))
        own = self.orders.between[turns.turn, turns.turn, 0] * self.design.weight**2
        low = self._low_rank(every)
        return np.asarray(own + ((low @ self.core) * low).sum(axis=1))

    def taken(self, white: Floats) -> Floats:
        """Return what the unknowns take up of whitened errors (n, k): J N^-1 J' times them."""
        return self.design.times(self.times(self.design.adjoint(white)))

    def shared(self, part: Bools) -> Floats:
        """Return the sums of squares (c, c) of J N^-1 J' between parts (c, n) of the rows.

        These are all rows in use: as J N^-1 J' is a projection, those of the largest part follow.
        """
        total, found = part @ self.leverage, np.zeros((len(part), len(part)))
        most = int(part.sum(axis=1).argmax())
        others = np.delete(np.arange(len(part)), most)
        rows = np.flatnonzero(part[others].any(axis=0))
        mine = part[np.ix_(others, rows)].astype(np.float64)
        found[np.ix_(others, others)] = mine @ self.among(rows) ** 2 @ mine.T
        found[most, others] = found[others, most] = (total - found.sum(axis=1))[others]
        found[most, most] = total[most] - found[most].sum()
        return found

    def squares(self, rows: Floats) -> Floats:
        """Return the variances (k,) of what ``rows`` (k, p + q) make of the unknowns."""
        return np.asarray((rows * self.times(rows.T).T).sum(axis=1))

    def gained(self, rows: Ints) -> Floats:
        """Return N^-1 J' of some ``rows`` (k,), (p + q, k)."""
        return self.times(self.design.rows(rows).T)


def _inverse(square: Floats) -> Floats | None:
    """Return the inverse of a symmetric matrix of entries of order one; None if it is not firm."""
    values, vectors = np.linalg.eigh(square)
    if len(values) and np.abs(values).min() < FIRM:
        return None
    return np.asarray((vectors / values) @ vectors.T)


@dataclass(frozen=True, eq=False)
class Eliminated:
    """The normal equations of a circular design with any weights, circle by circle.

    No row reads two of the circles but the last one: their unknowns are taken out one by one,
    ``own`` (m,) on the diagonal, and what is left is small. ``shared`` (m, r): between these and
    the others, over ``own``; ``root``: the lower Cholesky factor of what is left of the others.
    """

    own: Floats
    shared: csr_array
    root: Floats

    @classmethod
    def of(cls, design: Circular) -> Eliminated | None:
        """Return those of a ``design``; None where it has extra columns, or they are not firm."""
        turns = design.turns
        count = (turns.circles - 1) * turns.size
        plain = ByOrder.of(turns, np.ones(len(turns.sign)))
        if design.extra.shape[1] or plain is None:
            return None
        first, last = design.few[:, :count], design.few[:, count:]
        between = csr_array(first.T @ first)
        own = between.diagonal()
        if np.count_nonzero(between.data) != count or not (own > 0.0).all():
            return None
        shared = csr_array(first.T @ last)
        over = shared.multiply(1.0 / own[:, None]).tocsr()
        rest = (last.T @ last - shared.T @ over).toarray()
        scale = np.sqrt(last.multiply(last).sum(axis=0))
        if not scale.all():
            return None
        open_ = plain.directions[count:] * scale[:, None]
        open_ /= np.linalg.norm(open_, axis=0)
        unit = rest / scale / scale[:, None] + open_ @ open_.T
        root, failed = lapack.dpotrf(unit, lower=1)
        if failed or lapack.dpocon(root, np.abs(unit).sum(axis=0).max(), uplo="L")[0] < ROUGH:
            return None
        return cls(own, csr_array(over), np.asarray(np.tril(root)) * scale[:, None])

    def solved(self, design: FewEach, read: Floats) -> Floats:
        """Return the unknowns (p,) of least squares from what was ``read`` (n,), whitened."""
        asked, count = design.adjoint(read), len(self.own)
        left = asked[count:] - self.shared.T @ asked[:count]
        others = lapack.dpotrs(self.root, left, lower=1)[0]
        return np.append(asked[:count] / self.own - self.shared @ others, others)

    def squares(self, rows: Floats) -> Floats:
        """Return the variances (k,) of what ``rows`` (k, p) make of the unknowns."""
        count = len(self.own)
        mine = rows[:, :count]
        others = rows[:, count:] - (self.shared.T @ mine.T).T
        along = lapack.dtrtrs(self.root, others.T, lower=1)[0]
        return np.asarray((mine**2 / self.own).sum(axis=1) + (along**2).sum(axis=0))


@dataclass(frozen=True, eq=False)
class Iterated:
    """The normal equations of a large circular ``design`` with any weights, by iteration.

    Conjugate gradients, led by the ``orders`` of complete turns of the mean weight.
    """

    design: Circular
    orders: ByOrder

    @classmethod
    def of(cls, design: Circular) -> Iterated | None:
        """Return those of a large ``design``; None of a small one, or where an order is lost."""
        turns = design.turns
        if turns.size < LARGE or design.extra.shape[1]:
            return None
        orders = ByOrder.of(turns, turns.shares(design.weight)[0].mean(axis=1))
        return None if orders is None or orders.lost else cls(design, orders)

    def _normal(self, x: Floats) -> Floats:
        return self.design.adjoint(self.design.times(x))

    def solved(self, design: FewEach, read: Floats) -> Floats | None:
        """Return the unknowns (p,) of least squares from what was ``read`` (n,), whitened.

        None where the iteration does not converge.
        """
        asked, size = design.adjoint(read), (self.design.few.shape[1],) * 2
        rounding = CONVERGED * float(np.linalg.norm(abs(design.few).T @ np.abs(read)))
        found, failed = cg(
            LinearOperator(size, matvec=self._normal), asked, rtol=CONVERGED,
            atol=rounding, maxiter=STEPS,
            M=LinearOperator(size, matvec=self._led),
        )  # fmt: skip
        return None if failed else np.asarray(found)

    @cached_property
    def extremes(self) -> tuple[float, float]:
        """The least and the largest eigenvalue of the normal equations per those of ``orders``.

        By the Lanczos process, from directions that complete turns determine: what is not
        determined of them makes the least one zero.
        """
        turns, random = self.design.turns, np.random.default_rng(0)
        every = np.divmod(np.arange(len(turns.sign) * turns.size), turns.size)
        full = turns.rows_of(*every)
        left = full.T @ random.standard_normal(full.shape[0])
        way = self._led(left)
        now, carried, found = float(left @ way), 0.0, np.array([np.inf, 0.0])
        nothing, diagonal, beside = OPEN**2 * now, list[float](), list[float]()
        for step in range(1, STEPS):
            felt = self._normal(way)
            along = float(way @ felt)
            if along <= OPEN * now:
                return 0.0, float(found[1])  # nothing is determined along this way
            length = now / along
            diagonal.append(1.0 / length + carried)
            left = left - length * felt
            gain = self._led(left)
            after = float(left @ gain)
            if step % LOOKED == 0 or after < nothing:
                before, found = found, eigvalsh_tridiagonal(diagonal, beside)[[0, -1]]
                if after < nothing or (np.abs(found - before) < STEADY * found).all():
                    break
            beside.append(float(np.sqrt(after / now)) / length)
            carried, way, now = after / now / length, gain + after / now * way, after
        return float(found[0]), float(found[1])

    def _led(self, x: Floats) -> Floats:
        return self.orders.times(x[:, None])[:, 0]
