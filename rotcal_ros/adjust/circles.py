"""Least squares of circles that are read against each other, order by order.

Where every place of a circle is read at every shift against another, the normal matrix is block
circulant: a discrete Fourier transform along the places takes it apart into orders, of each of
which there are as many unknowns as circles. What belongs to no circle, as the zero of a setting,
meets order 0 alone. So n places cost n ln n where whole matrices cost n^3 (Davis, *Circulant
Matrices*, 1979). Readings that are missing, left out or there twice, and effects that became
unknowns, are a low rank beside that (Woodbury).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, TypeAlias

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.linalg import eigvalsh_tridiagonal, lapack
from scipy.sparse import csr_array, vstack
from scipy.sparse.csgraph import connected_components

from rotcal_ros.adjust.bordered import Groups, SparseDesign
from rotcal_ros.adjust.kernels import (
    Design,
    Kernel,
    LowRankUpdateKernel,
    ReweightedKernel,
    dense,
)
from rotcal_ros.adjust.outputs import Outputs
from rotcal_ros.foundation.arrays import Bools, Floats, Ints

FIRM: Final = 1e-6
"""Least eigenvalue of normal equations of unit diagonal whose inverse keeps nine digits."""
ROUGH: Final = 1e-12
"""The same of a step, or of a variance that is only compared."""
OPEN: Final = 1e-12
"""Eigenvalue of order 0, of unit diagonal, below which nothing determines a direction."""
LARGE: Final = 1000
"""Places of a circle from which on steps are iterated: whole matrices cost their third power."""
FEW: Final = 16
"""Rows that differ from most in weight up to which a low rank beside the orders is quick."""
STEPS: Final = 1000
"""Steps of conjugate gradients after which another way is taken."""
CONVERGED: Final = 1e-12
"""Share of what is asked, and of the sizes it is the sum of, that such a solution may leave."""
STEADY: Final = 1e-3
"""Relative change of an extreme eigenvalue in LOOKED steps that ends looking for it."""
LOOKED: Final = 10
SURELY: Final = 0.9
"""Share of a limit below which bounds that are found by iteration need not be known exactly."""
MOST_KINDS: Final = 100
"""Ways in which two places lie to each other that are worked out one by one."""
SAME: Final = 1e-12
"""Difference of squared weights, in the largest of them, that is rounding."""
Orders: TypeAlias = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class CircleTurns:
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
    def of(cls, rows: csr_array, circles: int, size: int) -> CircleTurns | None:
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
        return found if usual.all() and odd.sum() <= found.few else None

    @property
    def few(self) -> int:
        """How many cells may differ from the others as a low rank beside the orders."""
        return max(self.size, self.unknowns // 4)

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

    @cached_property
    def last(self) -> list[tuple[Floats, Kernel | None]]:
        """With which weights (n,) of the rows kernels were asked for last, and these kernels."""
        return []

    @cached_property
    def _parts(self) -> Ints:
        """Numbers (t + C + s,) of the parts of turns, circles and others that share no unknown."""
        felt = np.hstack([self.sign, self.tied])
        graph = np.pad(felt, ((0, felt.shape[1]), (len(felt), 0)))
        return np.asarray(connected_components(graph, directed=False)[1])

    def factors(self, weight: Floats, before: Floats) -> Floats | None:
        """Return one over how many times more each unknown (p,) counts than ``before`` (n,).

        With the ``weight`` (n,) now; None where that is not the same of all rows of a part.
        """
        of_turn, of_unknown = np.split(self._parts, [len(self.sign)])
        part, used = of_turn[self.turn], before > 0.0
        ratio = np.ones(int(self._parts.max()) + 1)
        ratio[part[used]] = weight[used] / before[used]
        if (np.abs(weight - ratio[part] * before) > SAME * weight.max()).any():
            return None
        if not ratio.all():
            return None
        circles, others = np.split(1.0 / ratio[of_unknown], [self.circles])
        return np.append(np.repeat(circles, self.size), others)

    @cached_property
    def _met(self) -> tuple[Ints, Ints]:
        """Which unknown a row reads, and in which row of a turn one is read: (C, t, N) each."""
        step, cell = np.arange(self.size), np.arange(len(self.sign))[:, None] * self.size
        circle = np.arange(self.circles)[:, None, None] * self.size
        shift = self.shift.T[:, :, None]
        return circle + (step + shift) % self.size, cell + (step - shift) % self.size

    @cached_property
    def waves(self) -> Orders:
        """By how much each order h of each circle turns with the shift, (h, t, C)."""
        orders = np.arange(self.size // 2 + 1)[:, None, None]
        return np.asarray(self.sign * np.exp(2j * np.pi / self.size * self.shift * orders))

    def normal_times(self, share: Floats, x: Floats) -> Floats:
        """Return the normal matrix of rows with squared weights ``share`` (t, N) times x (p,)."""
        (read, by), sign = self._met, self.sign.T[:, :, None]
        count = self.circles * self.size
        found = (self.tied @ x[count:])[:, None] + (sign * x[read]).sum(axis=0)
        found *= share
        places = (sign * found.ravel()[by]).sum(axis=1)
        return np.concatenate([places.ravel(), self.tied.T @ found.sum(axis=1)])


@dataclass(frozen=True, eq=False)
class CircularDesign(Design):
    """A design (n, p + q) of the rows of ``turns``, each times its ``weight`` (n,).

    ``few`` (n, p): those rows, weighted; ``extra`` (n, q): columns of further unknowns, too.
    ``groups``: into which rows and unknowns fall that are solved where too many are missing.
    """

    few: csr_array
    turns: CircleTurns
    weight: Floats
    extra: Floats
    groups: Groups | None = None

    divided = False

    @classmethod
    def of(cls, rows: csr_array, circles: int, size: int) -> CircularDesign | csr_array:
        """Return the design of ``rows`` (n, p), whose first unknowns are those of circles.

        These are ``circles`` of ``size`` places each. Where the turns are not nearly complete,
        the ``rows`` come back as they are: then they are solved as any others.
        """
        turns = CircleTurns.of(rows, circles, size)
        n = rows.shape[0]
        return rows if turns is None else cls(rows, turns, np.ones(n), np.zeros((n, 0)))

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers n of observations and p + q of unknowns."""
        return self.few.shape[0], self.few.shape[1] + self.extra.shape[1]

    @property
    def finite(self) -> bool:
        """Whether all derivatives are finite."""
        return bool(np.isfinite(self.few.data).all())

    def dense(self) -> Floats:
        """Return the whole design."""
        return np.concatenate([self.few.toarray(), self.extra], axis=1)

    @property
    def lengths(self) -> Floats:
        """The length (p + q,) of each column."""
        own = np.bincount(self.few.indices, self.few.data**2, self.few.shape[1])
        return np.asarray(np.sqrt(np.append(own, (self.extra**2).sum(axis=0))))

    def weighted(self, weight: Floats) -> CircularDesign:
        """Return the same, its rows times ``weight`` (n,)."""
        few = csr_array(self.few, copy=True)
        few.data *= np.repeat(weight, np.diff(few.indptr))
        extra = self.extra * weight[:, None]
        return replace(self, few=few, weight=self.weight * weight, extra=extra)

    def normal(self) -> Floats:
        """Return the normal matrix (p + q, p + q)."""
        own, beside = (self.few.T @ self.few).toarray(), self.few.T @ self.extra
        return np.asarray(np.block([[own, beside], [beside.T, self.extra.T @ self.extra]]))

    def times(self, x: Floats) -> Floats:
        """Return the design times ``x`` (p + q,) or (p + q, k)."""
        p = self.few.shape[1]
        return np.asarray(self.few @ x[:p] + self.extra @ x[p:])

    def transpose_times(self, y: Floats) -> Floats:
        """Return the transposed design times ``y`` (n,) or (n, k)."""
        return np.concatenate([self.few.T @ y, self.extra.T @ y])

    def beside(self, rows: Floats | csr_array) -> Design:
        """Return the design with further ``rows`` (k, p) at its end, turns too where they can."""
        few = csr_array(vstack([self.few, csr_array(rows)], format="csr"))
        found = CircularDesign.of(few, self.turns.circles, self.turns.size)
        return found if isinstance(found, CircularDesign) else SparseDesign(self.few, dense(rows))

    def with_extra(self, columns: Floats) -> CircularDesign:
        """Return the design with the ``columns`` (n, q) of further unknowns."""
        return replace(self, extra=np.concatenate([self.extra, columns], axis=1))

    def rows(self, which: Ints) -> Floats:
        """Return some rows (r, p + q) as a whole."""
        return np.concatenate([self.few[which].toarray(), self.extra[which]], axis=1)

    def rows_times(self, which: Ints, x: Floats) -> Floats:
        """Return some rows times ``x`` (p + q, k)."""
        p = self.few.shape[1]
        return np.asarray(self.few[which] @ x[:p] + self.extra[which] @ x[p:])

    def kernel(self) -> Kernel | None:
        """Return the kernel order by order, or by groups; None where it is not firm.

        Order by order where so few rows are missing that they are of low rank. The last one is
        kept: the same weights come again and again, or parts of them with another noise.
        """
        if self.extra.shape[1]:
            return self._kernel()
        last = self.turns.last
        for weight, kept in last:
            if np.array_equal(weight, self.weight):
                return kept
        if last and last[0][1] is not None:
            factor = self.turns.factors(self.weight, last[0][0])
            if factor is not None:
                last[1:] = [(self.weight, ReweightedKernel(self, last[0][1], factor))]
                return last[1][1]
        last[:] = [(self.weight, self._kernel())]
        return last[0][1]

    def _kernel(self) -> Kernel | None:
        share, usual, odd = self.turns.shares(self.weight)
        orders = OrderwiseKernel.of(self.turns, usual) if odd.sum() <= self.turns.few else None
        if orders is None:
            if self.groups is None:
                return None
            none = np.zeros((0, self.few.shape[1]))
            return SparseDesign(self.few, none, self.extra, self.groups).kernel()
        changed = self.turns.rows_of(*np.nonzero(odd)), (share - usual[:, None])[odd]
        plain = replace(self, extra=self.extra[:, :0])
        return LowRankUpdateKernel.of(orders, plain, self.weight, changed, self.extra)

    @property
    def prefers_normal_equations(self) -> bool:  # type: ignore[override]
        """Whether so many rows weigh otherwise than most that iteration is quicker."""
        odd = int(self.turns.shares(self.weight)[2].sum())
        return odd > FEW and not self.extra.shape[1]

    @property
    def large(self) -> bool:  # type: ignore[override]
        """Whether its whole matrix would be too large."""
        return self.turns.size >= LARGE

    @cached_property
    def _iterated(self) -> ConjugateGradients | None:
        return ConjugateGradients.of(self)

    @cached_property
    def _eliminated(self) -> EliminatedNormals | None:
        return EliminatedNormals.of(self)

    @property
    def open_directions(self) -> Floats | None:
        """What complete turns leave open (p, k); None where that is not known."""
        return None if self._iterated is None else self._iterated.orders.directions

    def roughly(self, white: Floats) -> Floats | None:
        """Return the unknowns (p,) of least squares with any weights; None: nothing does."""
        if not self.large and self._eliminated is not None:
            return self._eliminated.solved(self, white)
        if not (self.large or self.lengths.all()):
            return None
        found = None if self._iterated is None else self._iterated.solved(self, white)
        if found is None and self._eliminated is not None:
            found = self._eliminated.solved(self, white)
        return found

    def variances(self, outputs: Outputs) -> Floats | None:
        """Return variances (o,) of ``outputs`` with any weights; None: nothing does."""
        if self._eliminated is None:
            return None
        every = outputs.parts(self.shape[1])
        return np.concatenate([self._eliminated.squares(rows) for _, rows in every])

    def is_nearly_as_precise(self, other: Design, outputs: Outputs, factor: float) -> bool:
        """Whether bounds show that no output is less sure by ``factor`` than by ``other``."""
        if not self.large and self._eliminated is not None:
            return False
        mine, others = (
            self._iterated,
            other._iterated if isinstance(other, CircularDesign) else None,
        )
        if mine is None or others is None:
            return False
        bound = mine.extremes[1] * mine.orders.variances_of(outputs)
        least = mine.extremes[0] * others.orders.variances_of(outputs)
        return bool((bound <= (SURELY * factor) ** 2 * least).all())

    def without_unused_columns(self) -> CircularDesign:
        """Return it without further unknowns that no row feels: they are none of the others."""
        return replace(self, extra=self.extra[:, self.extra.any(axis=0)])


@dataclass(frozen=True, eq=False)
class OrderwiseKernel(Kernel):
    """The kernel of rows of complete ``turns``, order by order; rows count with a weight of one.

    ``inverse`` (N // 2 + 1, C, C): the pseudo inverse of each order but 0; ``zero`` (C + s,
    C + s): that of order 0, of sums of each circle over root N and the other unknowns. ``open``
    (C + s, k): directions of order 0 that nothing determines; ``lost``: other orders (l,), and
    what nothing determines of them (l, C).
    """

    turns: CircleTurns
    inverse: Orders
    zero: Floats
    open: Floats
    lost: tuple[Ints, Orders]

    @classmethod
    def of(cls, turns: CircleTurns, share: Floats) -> OrderwiseKernel | None:
        """Return that of rows with the squared weight ``share`` (t,) of their turn.

        None where an order is so badly determined that digits go.
        """
        size, wave = turns.size, turns.waves
        normal = (wave.conj() * share[:, None]).swapaxes(1, 2) @ wave
        at_zero = np.hstack([turns.sign, np.sqrt(size) * turns.tied])
        values, vectors, scale = _of_unit_diagonal((at_zero * share[:, None]).T @ at_zero)
        seen = values > OPEN
        length = np.sqrt(np.einsum("hcc->hc", normal).real)
        if (values[seen] < FIRM).any() or not length.all():
            return None
        length, inverse = length[1:, :, None], np.zeros_like(normal)
        each, ways = np.linalg.eigh(normal[1:] / length / length.swapaxes(1, 2))
        firm = each > OPEN
        if (each[firm] < FIRM).any():
            return None
        root = np.where(firm, 1.0 / np.sqrt(np.where(firm, each, 1.0)), 0.0)
        axes = root[:, None] * ways / length
        inverse[1:] = axes @ axes.conj().swapaxes(1, 2)
        open_ = vectors[:, ~seen] / scale[:, None]
        at_root = vectors[:, seen] / np.sqrt(values[seen]) / scale[:, None]
        order, which = np.nonzero(~firm)
        lost = order + 1, ways[order, :, which] / length[order, :, 0]
        return cls(turns, inverse, at_root @ at_root.T, open_, lost)

    @cached_property
    def directions(self) -> Floats:  # type: ignore[override]
        """What nothing determines (p, k), as directions of the unknowns.

        A lost order is a cosine and a sine, but for the last one of an even number of places.
        """
        (circles, size), (orders, lost) = (self.turns.circles, self.turns.size), self.lost
        found = [np.repeat(self.open[:circles] / np.sqrt(size), size, axis=0)]
        for order, way in zip(orders.tolist(), lost, strict=True):
            wave = np.multiply.outer(way, np.exp(2j * np.pi * order / size * np.arange(size)))
            parts = [wave.real] if 2 * order == size else [wave.real, wave.imag]
            found.append(np.stack(parts, axis=-1).reshape(circles * size, -1))
        places = np.hstack(found)
        others = np.zeros((self.turns.unknowns - len(places), places.shape[1]))
        others[:, : self.open.shape[1]] = self.open[circles:]
        return np.concatenate([places, others])

    def times(self, columns: Floats) -> Floats:
        """Return N^-1 times ``columns`` (p,) or (p, k)."""
        (size, circles), right = (self.turns.size, self.turns.circles), np.atleast_2d(columns.T)
        count = circles * size
        orders = np.fft.rfft(np.ascontiguousarray(right[:, :count]).reshape(-1, circles, size))
        sums = np.concatenate([orders[:, :, 0].real / np.sqrt(size), right[:, count:]], axis=1)
        zero = sums @ self.zero
        found = (self.inverse @ orders.transpose(2, 1, 0)).transpose(2, 1, 0)
        found[:, :, 0] = zero[:, :circles] * np.sqrt(size)
        places = np.fft.irfft(found, size).reshape(-1, count)
        whole = np.concatenate([places, zero[:, circles:]], axis=1)
        return np.asarray(whole.T.reshape(columns.shape))

    @cached_property
    def _by_circle(self) -> Orders:
        return np.ascontiguousarray(self.inverse.transpose(1, 2, 0))

    def variances_of(self, outputs: Outputs) -> Floats:
        """Return the variances (o,) of ``outputs``."""
        every = np.arange(len(outputs))
        return self._between(outputs, every, every)

    def covariance_of(self, outputs: Outputs) -> Floats:
        """Return the covariance (o, o) of ``outputs``."""
        every = np.arange(len(outputs))
        found = self._between(outputs, every[:, None], every)
        # of an output that is zero by its definition, differences leave their rounding
        variance = found.diagonal()
        zero = variance <= 8.0 * np.finfo(np.float64).eps * variance.max(initial=0.0)
        found[zero], found[:, zero] = 0.0, 0.0
        return found

    def _between(self, outputs: Outputs, first: Ints, second: Ints) -> Floats:
        """Return covariances (...) of ``outputs``, by how far apart the places are they read."""
        (circles, size), (column, value) = (self.turns.circles, self.turns.size), outputs.entries
        along = np.fft.irfft(self._by_circle, size)  # between places of two circles
        circle, place = np.divmod(np.minimum(column, circles * size), size)
        there = column < circles * size
        inside, met = np.where(there, value, 0.0), np.where(there, circle, 0)
        place = place.astype(np.int32)
        sums = np.zeros((len(outputs), len(self.zero)))
        at = np.where(there, circle, column - circles * size + circles)
        by = np.where(there, value / np.sqrt(size), value)
        np.add.at(sums, (np.arange(len(outputs))[:, None], at), by)
        carried = self.times(outputs.common.T)
        # what is common: each output's own part, and half of what all of them share
        half = outputs.few @ carried + 0.5 * outputs.share @ (outputs.common @ carried)
        pairs = [(sums @ self.zero, sums), (half, outputs.share), (outputs.share, half)]
        left, right = (np.hstack([pair[k] for pair in pairs]) for k in (0, 1))
        found = left @ right.T if first.ndim > 1 else (left * right).sum(axis=1)
        for a in range(outputs.each):
            for b in range(outputs.each):
                step = (place[first, a] - place[second, b]) % np.int32(size)
                between = along[met[first, a], met[second, b], step]
                found += inside[first, a] * inside[second, b] * between
        return np.asarray(found)

    def output_products(
        self, outputs: Outputs, first: Ints, second: Ints, weight: Floats
    ) -> Floats:
        """Return sums (o, c) of what a unit of one row does to each output times one of another.

        Of the pairs ``first`` and ``second`` (k,) with the ``weight`` (c, k). Rows at one place of
        two turns move outputs by what follows from how far away these read: sums over all places
        are products of their orders.
        """
        turns, (column, value), many = self.turns, outputs.entries, outputs.each
        size, place = turns.size, turns.place[first]
        if (place != turns.place[second]).any():
            return super().output_products(outputs, first, second, weight)
        beyond = ((column >= turns.circles * size) & (value != 0.0)).any(axis=1)
        if beyond.any():  # these read what is no place
            found = np.empty((len(outputs), len(weight)))
            some, rest = (outputs.part(np.flatnonzero(which)) for which in (beyond, ~beyond))
            found[beyond] = super().output_products(some, first, second, weight)
            found[~beyond] = self.output_products(rest, first, second, weight)
            return found
        circle, at = np.divmod(np.where(value != 0.0, column, column[:, :1]), size)
        a, b = (each.ravel() for each in np.indices((many, many)))
        both = np.stack([circle[:, a], circle[:, b], (at[:, b] - at[:, a]) % size], axis=-1)
        kinds, kind = np.unique(both.reshape(-1, 3), axis=0, return_inverse=True)
        if len(kinds) > MOST_KINDS:
            return super().output_products(outputs, first, second, weight)
        kind, by = kind.reshape(at[:, a].shape), value[:, a] * value[:, b]
        met, pair = np.unique([turns.turn[first], turns.turn[second]], axis=1, return_inverse=True)
        cell = pair.ravel() * size + place
        every = np.divmod(np.arange(len(turns.sign) * size), size)
        common = turns.rows_of(*every) @ self.times(outputs.common.T)
        common = common.reshape(len(turns.sign), size, len(outputs.common))
        places, found = self._felt[0], np.empty((len(outputs), len(weight)))
        for k, part in enumerate(weight):
            share = np.bincount(cell, part, met.shape[1] * size).reshape(-1, size)
            beside, twice = share[:, :, None] * common[met[1]], np.zeros_like(common)
            np.add.at(twice, met[0], beside)
            np.add.at(twice, met[1], share[:, :, None] * common[met[0]])
            orders = np.einsum(
                "tcq,tqg->cgq", np.fft.rfft(places), np.fft.rfft(twice, axis=1), optimize=True
            )
            mixed = np.fft.irfft(orders, size)[circle, :, at] * value[:, :, None]  # (o, e, g)
            squares = np.tensordot(common[met[0]], beside, ((0, 1), (0, 1)))
            mixed = mixed.sum(axis=1) + outputs.share @ squares
            found[:, k] = (mixed * outputs.share).sum(axis=1)
            waves = np.fft.rfft(share)
            for number, (c, d, apart) in enumerate(kinds.tolist()):
                product = places[met[0], c] * np.roll(places[met[1], d], -apart, axis=1)
                here = np.fft.irfft((waves * np.fft.rfft(product)).sum(axis=0), size)
                found[:, k] += (np.where(kind == number, by, 0.0) * here[at[:, a]]).sum(axis=1)
        return found

    @cached_property
    def _felt(self) -> tuple[Floats, Floats]:
        """What a row at place 0 of a turn does to places (t, C, N) and to the others (t, s)."""
        turns = self.turns
        orders = np.einsum("cdh,htd->tch", self._by_circle, turns.waves.conj())
        rows = np.hstack([turns.sign / np.sqrt(turns.size), turns.tied])
        zero = rows @ self.zero
        orders[:, :, 0] = zero[:, : turns.circles] * np.sqrt(turns.size)
        return np.fft.irfft(orders, turns.size), zero[:, turns.circles :]

    def response(self, outputs: Outputs, rows: Ints) -> Floats:
        """Return what unit errors of some ``rows`` (k,) do to ``outputs`` C: C N^-1 J', (o, k)."""
        if outputs.each != 1:
            return self._response_of_few(outputs, rows)
        (circles, size), (places, others) = (self.turns.circles, self.turns.size), self._felt
        turn, place = self.turns.turn[rows], self.turns.place[rows]
        column, value = (each[:, 0] for each in outputs.entries)
        if len(np.unique(turn)) == 1 and (run := outputs.run(circles * size, size)):
            read = np.tile(places[turn[0], run[0]], 2 + len(outputs) // size)
            found = sliding_window_view(read, len(outputs))[(run[1] - place) % size]
            return self._beside_common(found * value[0], outputs, turn, place)
        found = np.empty((len(rows), len(outputs)))
        for number, begin in enumerate(range(0, circles * size, size)):
            mine = np.flatnonzero((column >= begin) & (column < begin + size))
            for k in np.unique(turn) if len(mine) else ():
                read, here = places[k, number], np.flatnonzero(turn == k)
                turned = sliding_window_view(np.append(read, read[:-1]), size)[-place[here] % size]
                found[np.ix_(here, mine)] = turned[:, column[mine] - begin] * value[mine]
        beyond = np.flatnonzero(column >= circles * size)
        found[:, beyond] = others[turn[:, None], column[beyond] - circles * size] * value[beyond]
        return self._beside_common(found, outputs, turn, place)

    def _response_of_few(self, outputs: Outputs, rows: Ints) -> Floats:
        """Return the same of outputs that read several places each, (o, k)."""
        (circles, size), (places, others) = (self.turns.circles, self.turns.size), self._felt
        turn, place = self.turns.turn[rows], self.turns.place[rows]
        found = np.zeros((len(rows), len(outputs)))
        for column, value in zip(*(each.T for each in outputs.entries), strict=True):
            circle, at = np.divmod(np.minimum(column, circles * size - 1), size)
            inside = column < circles * size
            own = places.reshape(len(places), -1)
            for k in np.unique(turn).tolist():
                here = np.flatnonzero(turn == k)
                step = circle * size + (at - place[here, None]) % size
                found[here] += own[k][step] * np.where(inside, value, 0.0)
            beyond = np.flatnonzero(~inside)
            if len(beyond):
                read = others[turn[:, None], column[beyond] - circles * size]
                found[:, beyond] += read * value[beyond]
        return self._beside_common(found, outputs, turn, place)

    def _beside_common(self, found: Floats, outputs: Outputs, turn: Ints, place: Ints) -> Floats:
        """Return what rows (k,) do to ``outputs``, from what they do beside the common ones."""
        carried = self.turns.rows_of(turn, place) @ self.times(outputs.common.T)
        found += carried @ outputs.share.T
        return np.asarray(found.T)

    def hat_block(self, rows: Ints) -> Floats:
        """Return J N^-1 J' between some ``rows`` (k,), (k, k)."""
        turn, place = self.turns.turn[rows], self.turns.place[rows].astype(np.int32)
        step = (place[:, None] - place) % np.int32(self.turns.size)
        if len(np.unique(turn)) == 1:
            return np.asarray(self.between[turn[0], turn[0]][step])
        return np.asarray(self.between[turn[:, None], turn, step])

    def hat_blocks(self, rows: Ints) -> tuple[Floats, Ints]:
        """Return J N^-1 J' between rows of groups (g, e), each kind once (k, e, e)."""
        turn, place = self.turns.turn[rows], self.turns.place[rows]
        apart = (place - place[:, :1]) % self.turns.size
        first, kind = np.unique(turn[:, 0], return_index=True, return_inverse=True)[1:]
        if (turn != turn[first][kind]).any() or (apart != apart[first][kind]).any():
            first = kind = np.arange(len(rows))  # not alike, as those of each position are
        turn, apart = turn[first], apart[first]
        if self.turns.size >= LARGE and turn.size <= len(self.turns.sign):
            read = self.turns.rows_of(turn.ravel(), apart.ravel())
            columns = self.times(read.toarray().T)
            whole = (read @ columns).reshape(*turn.shape, *turn.shape)
            return whole[np.arange(len(turn)), :, np.arange(len(turn))], kind
        step = (apart[:, :, None] - apart[:, None]) % self.turns.size
        return self.between[turn[:, :, None], turn[:, None], step], kind

    @property
    def leverage(self) -> Floats:
        """The diagonal (n,) of J N^-1 J'."""
        return np.asarray(self._of_turns[self.turns.turn])

    @cached_property
    def _of_turns(self) -> Floats:
        """What the inverse is of a row with itself (t,)."""
        turns = self.turns
        wave, at_zero = turns.waves, self._at_zero
        orders = ((wave @ self.inverse) * wave.conj()).sum(axis=2).real
        orders[0] = ((at_zero @ self.zero) * at_zero).sum(axis=1)
        twice = orders.sum(axis=0) * 2.0 - orders[0]
        return np.asarray((twice if turns.size % 2 else twice - orders[-1]) / turns.size)

    def hat_square_sums(self, share: Floats) -> Floats:
        """Return sums of squares (c, c) of J N^-1 J' between rows, ``share`` (c, n) of each."""
        turns = self.turns
        cell, whole = turns.turn * turns.size + turns.place, len(turns.sign) * turns.size
        cells = np.stack([np.bincount(cell, part, whole) for part in share])
        cells = cells.reshape(len(share), -1, turns.size)
        seen = np.flatnonzero(cells.any(axis=(0, 2)))
        orders = np.fft.rfft(cells[:, seen], axis=2)
        between = np.fft.rfft(self._between_turns(seen) ** 2, axis=2)
        found = np.einsum("atq,tuq,buq->abq", orders.conj(), between, orders, optimize=True)
        return np.asarray(np.fft.irfft(found, turns.size, axis=2)[:, :, 0])

    @cached_property
    def between(self) -> Floats:
        """What the inverse is between rows of unit weight, (t, t, N) by the step of their places.

        J N^-1 J' of the row at place j of one turn and that at place i of another: by j - i.
        """
        return self._between_turns(np.arange(len(self.turns.sign)))

    def _between_turns(self, which: Ints) -> Floats:
        """Return the same between some turns (k,), (k, k, N)."""
        size, at_zero = self.turns.size, self._at_zero[which]
        wave, (first, second) = self.turns.waves[:, which], np.triu_indices(len(which))
        orders = (wave @ self.inverse @ wave.conj().swapaxes(1, 2))[:, first, second].T
        orders[:, 0] = (at_zero @ self.zero @ at_zero.T)[first, second]
        found = np.empty((len(which), len(which), size))
        found[first, second] = np.fft.irfft(orders, size)
        found[second, first] = np.roll(found[first, second, ::-1], 1, axis=1)  # the other way
        return found

    @property
    def _at_zero(self) -> Floats:
        """What rows of each turn feel of order 0, (t, C + s)."""
        return np.hstack([self.turns.sign, np.sqrt(self.turns.size) * self.turns.tied])


def _of_unit_diagonal(square: Floats) -> tuple[Floats, Floats, Floats]:
    """Return eigenvalues and vectors of a ``square`` brought to unit diagonal, and the scale."""
    scale = np.sqrt(np.where(square.diagonal() > 0.0, square.diagonal(), 1.0))
    values, vectors = np.linalg.eigh(square / scale / scale[:, None])
    return values, vectors, scale


@dataclass(frozen=True, eq=False)
class EliminatedNormals:
    """The normal equations of a circular design with any weights, circle by circle.

    No row reads two of the circles but the last one: their unknowns are taken out one by one,
    ``own`` (m,) on the diagonal, and what is left is small. ``shared`` (m, r): between these and
    the others, over ``own``; ``root``: the lower Cholesky factor of what is left of the others.
    """

    own: Floats
    shared: csr_array
    root: Floats

    @classmethod
    def of(cls, design: CircularDesign) -> EliminatedNormals | None:
        """Return those of a ``design``; None where it has extra columns, or they are not firm."""
        turns = design.turns
        count = (turns.circles - 1) * turns.size
        plain = OrderwiseKernel.of(turns, np.ones(len(turns.sign)))
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

    def solved(self, design: CircularDesign, read: Floats) -> Floats:
        """Return the unknowns (p,) of least squares from what was ``read`` (n,), whitened."""
        asked, count = design.transpose_times(read), len(self.own)
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
class ConjugateGradients:
    """The normal equations of a circular ``design`` with any weights, by iteration.

    Conjugate gradients, led by the ``orders`` of complete turns of the mean weight.
    """

    design: CircularDesign
    orders: OrderwiseKernel

    @classmethod
    def of(cls, design: CircularDesign) -> ConjugateGradients | None:
        """Return those of a ``design``; None where it has extra columns, or is not firm."""
        turns = design.turns
        if design.extra.shape[1]:
            return None
        orders = OrderwiseKernel.of(turns, turns.shares(design.weight)[0].mean(axis=1))
        return None if orders is None else cls(design, orders)

    @cached_property
    def _share(self) -> Floats:
        return self.design.turns.shares(self.design.weight)[0]

    def _normal(self, x: Floats) -> Floats:
        return self.design.turns.normal_times(self._share, x)

    def solved(self, design: CircularDesign, read: Floats) -> Floats | None:
        """Return the unknowns (p,) of least squares from what was ``read`` (n,), whitened.

        None where the iteration does not converge.
        """
        left = design.transpose_times(read)
        rounded = float(np.linalg.norm(design.lengths) * np.abs(read).max())
        enough = CONVERGED * max(float(np.linalg.norm(left)), rounded)
        found, way, before = np.zeros(len(left)), np.zeros(len(left)), 1.0
        for _ in range(STEPS):
            if float(np.linalg.norm(left)) <= enough:
                return found
            led = self.orders.times(left)
            now = float(left @ led)
            way = led + now / before * way
            turned = self._normal(way)
            length = now / float(way @ turned)
            found, left, before = found + length * way, left - length * turned, now
        return None

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
        for step in range(1, STEPS // 4):
            turned = self._normal(way)
            along = float(way @ turned)
            if along <= OPEN * now:
                return 0.0, float(found[1])  # nothing is determined along this way
            length = now / along
            diagonal.append(1.0 / length + carried)
            left = left - length * turned
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
        return self.orders.times(x)
