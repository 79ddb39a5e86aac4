"""The inverse normal matrix of a design, in whatever form it is least: what all that follows asks.

A :class:`Design` is the derivatives J (n, p) of observations, whitened or not; a :class:`Kernel`
answers for N^-1, N = J'J: the whole of it (:class:`DenseKernel`, the reference), block by block
(:mod:`.bordered`), order by order (:mod:`.circles`), and beside any of them the low rank of rows
that were changed and of effects that became unknowns (:class:`LowRankUpdateKernel`).
docs/engine.md has the equations.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from scipy.linalg import block_diag, lapack
from scipy.sparse import coo_array, csr_array

from rotcal_ros.adjust.groups import CHECKED
from rotcal_ros.adjust.outputs import AT_ONCE, Outputs
from rotcal_ros.adjust.sensitivity import Sensitivity
from rotcal_ros.foundation.arrays import Bools, Floats, Ints

OPEN: Final = 1e-9
"""Singular values below this share of the largest are directions that nothing determines."""
FIRM: Final = 1e-6
"""Reciprocal condition number from which on a design needs no singular values, and least
eigenvalue of normal equations of unit diagonal whose inverse keeps nine digits."""


class Design(ABC):
    """Derivatives (n, p) of observations."""

    prefers_normal_equations: bool = False
    """Whether steps are quicker without its kernel."""
    divided: bool = True
    """Whether large groups of its observations are judged in parts."""
    large: bool = False
    """Whether its whole matrix would be too large."""

    @property
    @abstractmethod
    def shape(self) -> tuple[int, int]:
        """Numbers n of observations and p of unknowns."""

    @property
    @abstractmethod
    def finite(self) -> bool:
        """Whether all derivatives are finite."""

    @abstractmethod
    def dense(self) -> Floats:
        """Return the whole design."""

    @abstractmethod
    def weighted(self, weight: Floats) -> Design:
        """Return the same, its rows times ``weight`` (n,)."""

    @abstractmethod
    def times(self, x: Floats) -> Floats:
        """Return the design times ``x`` (p,) or (p, k)."""

    @abstractmethod
    def transpose_times(self, y: Floats) -> Floats:
        """Return the transposed design times ``y`` (n,) or (n, k)."""

    @abstractmethod
    def rows(self, which: Ints) -> Floats:
        """Return some rows (k, p)."""

    @abstractmethod
    def beside(self, rows: Floats | csr_array) -> Design:
        """Return the design with further ``rows`` (k, p) at its end."""

    @abstractmethod
    def with_extra(self, columns: Floats) -> Design:
        """Return the design with the ``columns`` (n, q) of further unknowns."""

    def rows_times(self, which: Ints, x: Floats) -> Floats:
        """Return some rows times ``x`` (p, k)."""
        return np.asarray(self.rows(which) @ x)

    def normal(self) -> Floats:
        """Return the normal matrix (p, p)."""
        whole = self.dense()
        return np.asarray(whole.T @ whole)

    @property
    def lengths(self) -> Floats:
        """The length (p,) of each column."""
        return np.asarray(np.linalg.norm(self.dense(), axis=0))

    def kernel(self) -> Kernel | None:
        """Return the kernel of its form; None where it has none, or that is not firm."""
        return None

    @property
    def open_directions(self) -> Floats | None:
        """What its rows leave open (p, k) with any weights; None: that is not known beforehand."""
        return None

    def roughly(self, white: Floats) -> Floats | None:
        """Return the unknowns (p,) of least squares where no kernel does; None: nothing does."""
        return None

    def variances(self, outputs: Outputs) -> Floats | None:
        """Return variances (o,) of ``outputs`` where no kernel does; None: nothing does."""
        return None

    def is_nearly_as_precise(self, other: Design, outputs: Outputs, factor: float) -> bool:
        """Whether bounds show that no output is less sure by ``factor`` than by ``other``."""
        return False

    def without_unused_columns(self) -> Design:
        """Return it without further unknowns that no row feels, where its kernel asks for that."""
        return self


@dataclass(frozen=True, eq=False)
class DenseDesign(Design):
    """A design that is one ``matrix`` (n, p)."""

    matrix: Floats

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers n of observations and p of unknowns."""
        return len(self.matrix), self.matrix.shape[1]

    @property
    def finite(self) -> bool:
        """Whether all derivatives are finite."""
        return bool(np.isfinite(self.matrix).all())

    def dense(self) -> Floats:
        """Return the whole design."""
        return self.matrix

    def weighted(self, weight: Floats) -> DenseDesign:
        """Return the same, its rows times ``weight`` (n,)."""
        return DenseDesign(self.matrix * weight[:, None])

    def times(self, x: Floats) -> Floats:
        """Return the design times ``x`` (p,) or (p, k)."""
        return np.asarray(self.matrix @ x)

    def transpose_times(self, y: Floats) -> Floats:
        """Return the transposed design times ``y`` (n,) or (n, k)."""
        return np.asarray(self.matrix.T @ y)

    def rows(self, which: Ints) -> Floats:
        """Return some rows (k, p)."""
        return self.matrix[which]

    def beside(self, rows: Floats | csr_array) -> DenseDesign:
        """Return the design with further ``rows`` (k, p) at its end."""
        return DenseDesign(np.concatenate([self.matrix, dense(rows)]))

    def with_extra(self, columns: Floats) -> DenseDesign:
        """Return the design with the ``columns`` (n, q) of further unknowns."""
        return DenseDesign(np.concatenate([self.matrix, columns], axis=1))


class Kernel(ABC):
    """N^-1 of a whitened ``design`` J (n, p), N = J'J.

    ``directions`` (p, k): what nothing determines; these stand still in some way, which outputs
    must not feel.
    """

    design: Design
    directions: Floats

    @property
    def rank(self) -> int:
        """How many unknowns are determined."""
        return self.design.shape[1] - int(self.directions.shape[1])

    @cached_property
    def defined_last(self) -> list[tuple[Floats, ConstrainedKernel]]:
        """The definitions that it was asked with last, and the kernel with these."""
        return []

    @abstractmethod
    def times(self, columns: Floats) -> Floats:
        """Return N^-1 times ``columns`` (p, k)."""

    @abstractmethod
    def hat_block(self, rows: Ints) -> Floats:
        """Return J N^-1 J' between some ``rows`` (k,), (k, k)."""

    def hat_blocks(self, rows: Ints) -> tuple[Floats, Ints]:
        """Return J N^-1 J' between rows of groups (g, e), each kind once (k, e, e).

        And of which kind (g,) each group is: those that are alike are worked out once.
        """
        return np.stack([self.hat_block(each) for each in rows]), np.arange(len(rows))

    def together(self, rows: Ints, white: Floats) -> tuple[float, int]:
        """Return T = r'R^+r of the residuals r = ``white`` (k,) of some ``rows``, and R's rank."""
        values, vectors = np.linalg.eigh(np.eye(len(rows)) - self.hat_block(rows))
        seen = values > CHECKED
        along = vectors[:, seen].T @ white
        return float((along**2 / values[seen]).sum()), int(seen.sum())

    @property
    @abstractmethod
    def leverage(self) -> Floats:
        """The diagonal (n,) of J N^-1 J'."""

    def solve(self, white: Floats) -> Floats:
        """Return the unknowns (p,) or (p, k) of least squares from what is read, whitened."""
        found = self.times(self.design.transpose_times(white.reshape(len(white), -1)))
        return found.reshape(-1, *white.shape[1:])

    def gains(self, rows: Ints) -> Floats:
        """Return N^-1 J' of some ``rows`` (k,): what unit errors of them do, (p, k)."""
        return self.times(self.design.rows(rows).T)

    def adjusted(self, columns: Floats) -> Floats:
        """Return J N^-1 times ``columns`` (p, k), (n, k)."""
        return self.design.times(self.times(columns))

    def projected(self, white: Floats) -> Floats:
        """Return what the unknowns take up of whitened errors (n, k): J N^-1 J' times them."""
        return self.design.times(self.solve(white))

    def projected_in(self, white: Floats, rows: Ints) -> Floats:
        """Return the same of some ``rows`` (r,) alone, (r, k)."""
        return self.design.rows_times(rows, self.solve(white))

    def variances(self, rows: Floats) -> Floats:
        """Return the variances (k,) of what ``rows`` (k, p) make of the unknowns."""
        return np.asarray((rows * self.times(rows.T).T).sum(axis=1))

    def variances_of(self, outputs: Outputs) -> Floats:
        """Return the variances (o,) of ``outputs``."""
        parts = outputs.parts(self.design.shape[1])
        return np.concatenate([self.variances(rows) for _, rows in parts])

    def covariance_of(self, outputs: Outputs) -> Floats:
        """Return the covariance (o, o) of ``outputs``."""
        found = np.zeros((len(outputs), len(outputs)))
        for here, rows in outputs.parts(len(self.directions)):
            found[:, here] = outputs.times(self.times(rows.T))
        return found

    def parts_of(self, outputs: Outputs) -> tuple[csr_array, Floats, Floats] | None:
        """Return N (o, k) of few entries a row, L (o, r) and M (r, r): NN' + LML' is the same.

        None where there are none.
        """
        return None

    def output_products(
        self, outputs: Outputs, first: Ints, second: Ints, weight: Floats
    ) -> Floats:
        """Return sums (o, c) of what a unit of one row does to each output times one of another.

        Of the pairs ``first`` and ``second`` (k,) with the ``weight`` (c, k).
        """
        found = np.zeros((len(outputs), len(weight)))
        for some in np.array_split(np.arange(len(first)), len(first) // AT_ONCE + 1):
            rows, at = np.unique([first[some], second[some]], return_inverse=True)
            influence = self.response(outputs, rows)
            found += (influence[:, at[0]] * influence[:, at[1]]) @ weight[:, some].T
        return found

    def response(self, outputs: Outputs, rows: Ints) -> Floats:
        """Return what unit errors of some ``rows`` (k,) do to ``outputs`` C: C N^-1 J', (o, k)."""
        parts = np.array_split(rows, len(rows) // AT_ONCE + 1)
        return np.hstack([outputs.times(self.gains(part)) for part in parts])

    def sensitivity(self, outputs: Outputs, rows: Ints) -> Sensitivity:
        """Return the same in parts that are few, where they are."""
        return Sensitivity.whole(self.response(outputs, rows))

    @abstractmethod
    def hat_square_sums(self, share: Floats) -> Floats:
        """Return sums of squares (c, c) of J N^-1 J' between rows, ``share`` (c, n) of each."""

    def shared(self, parts: Bools) -> Floats:
        """Return the sums of squares (c, c) of J N^-1 J' between ``parts`` (c, n) of the rows.

        These are all rows in use: as J N^-1 J' is a projection, those of the largest part follow.
        """
        total, found = parts @ self.leverage, np.zeros((len(parts), len(parts)))
        most = int(parts.sum(axis=1).argmax())
        others = np.delete(np.arange(len(parts)), most)
        if len(others):
            every = self.hat_square_sums(parts[others].astype(np.float64))
            found[np.ix_(others, others)] = every
        found[most, others] = found[others, most] = (total - found.sum(axis=1))[others]
        found[most, most] = total[most] - found[most].sum()
        return found


@dataclass(frozen=True, eq=False)
class DenseKernel(Kernel):
    """By the whole of a design: the reference.

    ``basis``: orthonormal columns (n, rank) that span J; ``root`` (p, rank) times its transposed
    is N^-1.
    """

    design: Design
    directions: Floats
    basis: Floats
    root: Floats

    @classmethod
    def of(cls, design: Design, held: Ints, weak: float = OPEN) -> DenseKernel:
        """Return that of any ``design``; unknowns that may be ``held`` (k,) stand still.

        Of columns that were brought to length one: by QR, or by SVD where that is not firm. What
        is open is shown by small singular values, whatever the units of the unknowns. Raises
        LinAlgError for what is not finite.
        """
        white = design.dense()
        scale = np.linalg.norm(white, axis=0)
        scale = np.where(scale > 0.0, scale, 1.0)
        unit = white / scale
        moving: Ints | slice = np.delete(np.arange(len(scale)), held) if len(held) else slice(None)
        if len(unit) >= len(scale) - len(held) and np.isfinite(unit).all():
            basis, upper = np.linalg.qr(unit[:, moving])
            along = basis.T @ unit[:, held]
            left = np.linalg.norm(unit[:, held] - basis @ along, axis=0)
            inverse, singular = lapack.dtrtri(upper)
            norm, of_inverse = (np.abs(a).sum(axis=0).max(initial=0.0) for a in (upper, inverse))
            firm = singular <= 0 and norm * of_inverse * max(FIRM, weak) < 1.0
            if firm and not (left > weak).any():
                root, open_ = np.zeros((len(scale), len(upper))), np.zeros((len(scale), len(held)))
                root[moving] = inverse
                open_[moving] = -lapack.dtrtrs(upper, along)[0] if len(held) else 0.0
                open_[held, np.arange(len(held))] = 1.0
                return cls(design, open_ / scale[:, None], basis, root / scale[:, None])
        u, s, vt = np.linalg.svd(unit, full_matrices=False)
        determined = s > weak * s[0]
        full = vt if len(vt) == len(scale) else np.linalg.svd(unit)[2]
        open_ = full[int(determined.sum()) :].T / scale[:, None]
        root = vt[determined].T / s[determined] / scale[:, None]
        return cls(design, open_, u[:, determined], root)

    @property
    def rank(self) -> int:
        """How many unknowns are determined."""
        return int(self.basis.shape[1])

    def times(self, columns: Floats) -> Floats:
        """Return N^-1 times ``columns`` (p, k)."""
        return np.asarray(self.root @ (self.root.T @ columns))

    def hat_block(self, rows: Ints) -> Floats:
        """Return J N^-1 J' between some ``rows`` (k,), (k, k)."""
        return np.asarray(self.basis[rows] @ self.basis[rows].T)

    def together(self, rows: Ints, white: Floats) -> tuple[float, int]:
        """Return T = r'R^+r of the residuals r = ``white`` (k,) of some ``rows``, and R's rank."""
        return squares_outside(white, self.basis[rows], np.ones(self.rank))

    def hat_blocks(self, rows: Ints) -> tuple[Floats, Ints]:
        """Return J N^-1 J' between rows of groups (g, e), each kind once (k, e, e)."""
        basis = self.basis[rows]
        return basis @ basis.swapaxes(1, 2), np.arange(len(rows))

    @property
    def leverage(self) -> Floats:
        """The diagonal (n,) of J N^-1 J'."""
        return np.asarray((self.basis**2).sum(axis=1))

    def hat_square_sums(self, share: Floats) -> Floats:
        """Return sums of squares (c, c) of J N^-1 J' between rows, ``share`` (c, n) of each."""
        used = [np.flatnonzero(each) for each in share]
        each = [self.basis[rows] for rows in used]
        spread = np.stack([
            (basis.T * part[rows]) @ basis
            for basis, part, rows in zip(each, share, used, strict=True)
        ]).reshape(len(share), -1)  # fmt: skip
        return np.asarray(spread @ spread.T)

    def solve(self, white: Floats) -> Floats:
        """Return the unknowns (p,) or (p, k) of least squares from what is read, whitened."""
        return np.asarray(self.root @ (self.basis.T @ white))

    def gains(self, rows: Ints) -> Floats:
        """Return N^-1 J' of some ``rows`` (k,): what unit errors of them do, (p, k)."""
        return np.asarray(self.root @ self.basis[rows].T)

    def adjusted(self, columns: Floats) -> Floats:
        """Return J N^-1 times ``columns`` (p, k), (n, k)."""
        return np.asarray(self.basis @ (self.root.T @ columns))

    def projected(self, white: Floats) -> Floats:
        """Return what the unknowns take up of whitened errors (n, k): J N^-1 J' times them."""
        return np.asarray(self.basis @ (self.basis.T @ white))

    def variances(self, rows: Floats) -> Floats:
        """Return the variances (k,) of what ``rows`` (k, p) make of the unknowns."""
        return np.asarray(((rows @ self.root) ** 2).sum(axis=1))


@dataclass(frozen=True, eq=False)
class LowRankUpdateKernel(Kernel):
    """A ``base`` of which rows were changed, and to which unknowns came: a low rank beside it.

    Its N^-1 is that of the base, zero for further unknowns, and ``columns`` (p + q, r) times
    ``core`` (r, r) times their transposed (Woodbury). The rows of the ``design`` (n, p + q) are
    ``share`` (n,) times those of the base.
    """

    design: Design
    base: Kernel
    share: Floats
    columns: Floats
    core: Floats

    @classmethod
    def of(
        cls,
        base: Kernel,
        design: Design,
        share: Floats,
        changed: tuple[Floats | csr_array, Floats],
        extra: Floats,
    ) -> LowRankUpdateKernel | None:
        """Return that of a ``design`` with ``extra`` columns (n, q); None where it is not firm.

        ``changed``: rows (k, p), and by how much (k,) their squared weight differs from that in
        the ``base``, -1 for what is left out.
        """
        rows, more = changed
        influence, lengths = (
            np.abs(rows @ base.directions),
            np.linalg.norm(base.directions, axis=0),
        )
        if (influence > OPEN * lengths * np.abs(dense(rows)).max(initial=0.0)).any():
            return None  # they determine what the base leaves open
        columns = base.times(dense(rows).T)
        size = np.sqrt(np.abs(more))
        core = _inverse(np.diag(np.sign(more)) + size[:, None] * (rows @ columns) * size)
        if core is None:
            return None
        alone = cls(design, base, share, columns * size, -core)
        return alone._with_extra(extra)

    def _with_extra(self, extra: Floats) -> LowRankUpdateKernel | None:
        """Return the same with ``extra`` columns (n, q); None where they are not firm."""
        back = self.design.transpose_times(extra)
        gain = self.times(back)
        squares, whole = extra.T @ extra - back.T @ gain, (extra**2).sum(axis=0)
        length = np.sqrt(np.where(whole > 0.0, whole, 1.0))
        inverse = _inverse(squares / length / length[:, None])
        if inverse is None:
            return None
        q = extra.shape[1]
        columns = np.block([[self.columns, -gain / length], [np.zeros((q, len(self.core))),
                                                            np.diag(1.0 / length)]])  # fmt: skip
        core = np.asarray(block_diag(self.core, inverse))
        return LowRankUpdateKernel(
            self.design.with_extra(extra), self.base, self.share, columns, core
        )

    @property
    def directions(self) -> Floats:  # type: ignore[override]
        """What nothing determines (p + q, k): of the base alone."""
        below = len(self.columns) - len(self.base.directions)
        return np.pad(self.base.directions, ((0, below), (0, 0)))

    def times(self, columns: Floats) -> Floats:
        """Return N^-1 times ``columns`` (p + q, k)."""
        p = self.base.directions.shape[0]
        found = self.columns @ (self.core @ (self.columns.T @ columns))
        found[:p] += self.base.times(columns[:p])
        return np.asarray(found)

    def variances_of(self, outputs: Outputs) -> Floats:
        """Return the variances (o,) of ``outputs``."""
        low, own = outputs.times(self.columns), outputs.of_first(len(self.base.directions))
        return np.asarray(self.base.variances_of(own) + ((low @ self.core) * low).sum(axis=1))

    def covariance_of(self, outputs: Outputs) -> Floats:
        """Return the covariance (o, o) of ``outputs``."""
        low, own = outputs.times(self.columns), outputs.of_first(len(self.base.directions))
        return np.asarray(self.base.covariance_of(own) + (low @ self.core) @ low.T)

    def parts_of(self, outputs: Outputs) -> tuple[csr_array, Floats, Floats] | None:
        """Return the parts of the base, and what the columns add."""
        parts = self.base.parts_of(outputs.of_first(len(self.base.directions)))
        if parts is None:
            return None
        near, low, core = parts
        return near, np.hstack([low, outputs.times(self.columns)]), block_diag(core, self.core)

    def output_products(
        self, outputs: Outputs, first: Ints, second: Ints, weight: Floats
    ) -> Floats:
        """Return sums (o, c) of what a unit of one row does to each output times one of another.

        Of the pairs ``first`` and ``second`` (k,) with the ``weight`` (c, k).
        """
        p, low = len(self.base.directions), self._low
        own, by = outputs.of_first(p), outputs.times(self.columns) @ self.core
        share = self.share[first] * self.share[second]
        found = self.base.output_products(own, first, second, weight * share)
        for k, part in enumerate(weight):
            pairs = (part, (first, second)), (part, (second, first))
            shape = (len(low), len(low))
            there, back = (csr_array(coo_array(each, shape=shape)) for each in pairs)
            both = own.times(
                self.base.times(self.design.transpose_times(there @ low + back @ low)[:p])
            )
            found[:, k] += ((both + by @ (low.T @ (there @ low))) * by).sum(axis=1)
        found[outputs.idle] = 0.0
        return found

    def response(self, outputs: Outputs, rows: Ints) -> Floats:
        """Return what unit errors of some ``rows`` (k,) do to ``outputs`` C: C N^-1 J', (o, k)."""
        found = self.base.response(outputs.of_first(len(self.base.directions)), rows)
        found *= self.share[rows]
        if self.columns.shape[1]:
            low = self._low[rows]
            found += (outputs.times(self.columns) @ self.core) @ low.T
        found[outputs.idle] = 0.0
        return found

    def hat_block(self, rows: Ints) -> Floats:
        """Return J N^-1 J' between some ``rows`` (k,), (k, k)."""
        found, share = self.base.hat_block(rows), self.share[rows]
        found *= share[:, None]
        found *= share
        low = self._low[rows]
        found += low @ self.core @ low.T
        return np.asarray(found)

    def hat_blocks(self, rows: Ints) -> tuple[Floats, Ints]:
        """Return J N^-1 J' between rows of groups (g, e), each kind once (k, e, e)."""
        share, (found, kind) = self.share[rows], self.base.hat_blocks(rows)
        first = np.unique(kind, return_index=True)[1]
        if self.columns.shape[1] or (share != share[first][kind]).any():
            found, first, kind = found[kind], np.arange(len(rows)), np.arange(len(rows))
        found = found * share[first, :, None] * share[first, None]
        if self.columns.shape[1]:
            low = self._low[rows]
            found += (low @ self.core) @ low.swapaxes(1, 2)
        return found, kind

    def hat_square_sums(self, share: Floats) -> Floats:
        """Return sums of squares (c, c) of J N^-1 J' between rows, ``share`` (c, n) of each.

        Of a base B and a low rank L C L': those of B, of both, and of the low rank alone.
        """
        found = self.base.hat_square_sums(share * self.share**2)
        low, p = self._low, self.base.directions.shape[0]
        each = [part[:, None] * low for part in share]
        taken = np.zeros((len(share), *self.columns.shape))
        taken[:, :p] = [self.base.times(self.design.transpose_times(own)[:p]) for own in each]
        squares = np.stack([low.T @ own for own in each])
        computed = [self.design.times(own) for own in taken]
        mixed = np.stack([[other.T @ own for other in each] for own in computed])
        found = found + 2.0 * (mixed * self.core).sum(axis=(2, 3))
        spread = self.core @ squares @ self.core
        return np.asarray(found + (spread[:, None] * squares).sum(axis=(2, 3)))

    @cached_property
    def leverage(self) -> Floats:
        """The diagonal (n,) of J N^-1 J'."""
        low = self._low
        return np.asarray(
            self.base.leverage * self.share**2 + ((low @ self.core) * low).sum(axis=1)
        )

    @cached_property
    def _low(self) -> Floats:
        """What the rows feel of the columns, (n, r)."""
        return self.design.times(self.columns)


@dataclass(frozen=True, eq=False)
class ConstrainedKernel(Kernel):
    """A ``base`` that leaves directions H open, which definitions G x = 0 fix.

    Its N^-1 is P times that of the base times P', P = I - H (G H)^+ G. ``rows`` (g, p): G,
    ``fixing`` (p, g): H (G H)^+. What observations say of each other stays.
    """

    base: Kernel
    rows: Floats
    fixing: Floats
    directions: Floats

    @classmethod
    def of(cls, base: Kernel, definitions: Floats) -> ConstrainedKernel:
        """Return that of a ``base``, with ``definitions`` (g, p') of its first unknowns.

        The last one is kept with the base.
        """
        for asked, kept in base.defined_last:
            if asked is definitions:
                return kept
        found = cls._of(base, definitions)
        base.defined_last[:] = [(definitions, found)]
        return found

    @classmethod
    def _of(cls, base: Kernel, definitions: Floats) -> ConstrainedKernel:
        lengths, p = base.design.lengths, len(base.directions)
        rows = np.pad(definitions, ((0, 0), (0, p - definitions.shape[1])))
        fixing, left = fix_open_directions(
            rows, base.directions, np.where(lengths > 0.0, lengths, 1.0)
        )
        return cls(base, rows, fixing, left)

    @property
    def design(self) -> Design:  # type: ignore[override]
        """The whitened design of the base."""
        return self.base.design

    @property
    def rank(self) -> int:
        """How many unknowns are determined, not only defined."""
        return self.base.rank

    def defined(self, x: Floats) -> Floats:
        """Return unknowns ``x`` (p,) or (p, k) that keep the definitions: P x."""
        return np.asarray(x - self.fixing @ (self.rows @ x))

    def times(self, columns: Floats) -> Floats:
        """Return N^-1 times ``columns`` (p, k)."""
        return self.defined(self.base.times(columns - self.rows.T @ (self.fixing.T @ columns)))

    def hat_block(self, rows: Ints) -> Floats:
        """Return J N^-1 J' between some ``rows`` (k,), (k, k)."""
        return self.base.hat_block(rows)

    def together(self, rows: Ints, white: Floats) -> tuple[float, int]:
        """Return T = r'R^+r of the residuals r = ``white`` (k,) of some ``rows``, and R's rank."""
        return self.base.together(rows, white)

    def hat_blocks(self, rows: Ints) -> tuple[Floats, Ints]:
        """Return J N^-1 J' between rows of groups (g, e), each kind once (k, e, e)."""
        return self.base.hat_blocks(rows)

    @property
    def leverage(self) -> Floats:
        """The diagonal (n,) of J N^-1 J'."""
        return self.base.leverage

    def solve(self, white: Floats) -> Floats:
        """Return the unknowns (p,) or (p, k) of least squares from what is read, whitened."""
        return self.defined(self.base.solve(white))

    def gains(self, rows: Ints) -> Floats:
        """Return N^-1 J' of some ``rows`` (k,): what unit errors of them do, (p, k)."""
        return self.defined(self.base.gains(rows))

    def projected(self, white: Floats) -> Floats:
        """Return what the unknowns take up of whitened errors (n, k): J N^-1 J' times them."""
        return self.base.projected(white)

    def projected_in(self, white: Floats, rows: Ints) -> Floats:
        """Return the same of some ``rows`` (r,) alone, (r, k)."""
        return self.base.projected_in(white, rows)

    def variances(self, rows: Floats) -> Floats:
        """Return the variances (k,) of what ``rows`` (k, p) make of the unknowns."""
        return self.base.variances(rows - (rows @ self.fixing) @ self.rows)

    def variances_of(self, outputs: Outputs) -> Floats:
        """Return the variances (o,) of ``outputs``."""
        return self.base.variances_of(outputs.fixed(self.fixing, self.rows))

    def covariance_of(self, outputs: Outputs) -> Floats:
        """Return the covariance (o, o) of ``outputs``."""
        return self.base.covariance_of(outputs.fixed(self.fixing, self.rows))

    def parts_of(self, outputs: Outputs) -> tuple[csr_array, Floats, Floats] | None:
        """Return the parts of the base, of outputs that keep the definitions."""
        return self.base.parts_of(outputs.fixed(self.fixing, self.rows))

    def output_products(
        self, outputs: Outputs, first: Ints, second: Ints, weight: Floats
    ) -> Floats:
        """Return sums (o, c) of what a unit of one row does to each output times one of another.

        Of the pairs ``first`` and ``second`` (k,) with the ``weight`` (c, k).
        """
        fixed = outputs.fixed(self.fixing, self.rows)
        return self.base.output_products(fixed, first, second, weight)

    def response(self, outputs: Outputs, rows: Ints) -> Floats:
        """Return what unit errors of some ``rows`` (k,) do to ``outputs`` C: C N^-1 J', (o, k)."""
        return self.base.response(outputs.fixed(self.fixing, self.rows), rows)

    def sensitivity(self, outputs: Outputs, rows: Ints) -> Sensitivity:
        """Return what unit errors of some ``rows`` (k,) do to ``outputs``, in few parts."""
        found = self.base.sensitivity(outputs, rows)
        moved, fixed = -outputs.times(self.fixing), self.rows @ self.base.gains(rows)
        if found.common is None:
            return Sensitivity.whole(found.along + moved @ fixed)
        along = np.concatenate([found.along, fixed])
        return replace(found, along=along, common=np.hstack([found.common, moved]))

    def hat_square_sums(self, share: Floats) -> Floats:
        """Return sums of squares (c, c) of J N^-1 J' between rows, ``share`` (c, n) of each."""
        return self.base.hat_square_sums(share)


@dataclass(frozen=True, eq=False)
class ReweightedKernel(Kernel):
    """A ``base`` whose rows weigh otherwise, all those alike that have unknowns in common.

    Its N^-1 is F times that of the base times F, with F the ``factor`` (p,) on each unknown: one
    over that on the weights of its rows. What observations say of each other stays.
    """

    design: Design
    base: Kernel
    factor: Floats

    @property
    def directions(self) -> Floats:  # type: ignore[override]
        """What nothing determines (p, k)."""
        return self.factor[:, None] * self.base.directions

    def times(self, columns: Floats) -> Floats:
        """Return N^-1 times ``columns`` (p, k)."""
        return self._scaled(self.base.times(self._scaled(columns)))

    def _scaled(self, columns: Floats) -> Floats:
        return np.asarray((columns.T * self.factor).T)

    def hat_block(self, rows: Ints) -> Floats:
        """Return J N^-1 J' between some ``rows`` (k,), (k, k)."""
        return self.base.hat_block(rows)

    def together(self, rows: Ints, white: Floats) -> tuple[float, int]:
        """Return T = r'R^+r of the residuals r = ``white`` (k,) of some ``rows``, and R's rank."""
        return self.base.together(rows, white)

    def hat_blocks(self, rows: Ints) -> tuple[Floats, Ints]:
        """Return J N^-1 J' between rows of groups (g, e), each kind once (k, e, e)."""
        return self.base.hat_blocks(rows)

    @property
    def leverage(self) -> Floats:
        """The diagonal (n,) of J N^-1 J'."""
        return self.base.leverage

    def solve(self, white: Floats) -> Floats:
        """Return the unknowns (p,) or (p, k) of least squares from what is read, whitened."""
        return self._scaled(self.base.solve(white))

    def gains(self, rows: Ints) -> Floats:
        """Return N^-1 J' of some ``rows`` (k,): what unit errors of them do, (p, k)."""
        return self._scaled(self.base.gains(rows))

    def adjusted(self, columns: Floats) -> Floats:
        """Return J N^-1 times ``columns`` (p, k), (n, k)."""
        return self.base.adjusted(self._scaled(columns))

    def projected(self, white: Floats) -> Floats:
        """Return what the unknowns take up of whitened errors (n, k): J N^-1 J' times them."""
        return self.base.projected(white)

    def projected_in(self, white: Floats, rows: Ints) -> Floats:
        """Return the same of some ``rows`` (r,) alone, (r, k)."""
        return self.base.projected_in(white, rows)

    def variances(self, rows: Floats) -> Floats:
        """Return the variances (k,) of what ``rows`` (k, p) make of the unknowns."""
        return self.base.variances(rows * self.factor)

    def variances_of(self, outputs: Outputs) -> Floats:
        """Return the variances (o,) of ``outputs``."""
        return self.base.variances_of(outputs.weighted(self.factor))

    def covariance_of(self, outputs: Outputs) -> Floats:
        """Return the covariance (o, o) of ``outputs``."""
        return self.base.covariance_of(outputs.weighted(self.factor))

    def parts_of(self, outputs: Outputs) -> tuple[csr_array, Floats, Floats] | None:
        """Return the parts of the base, of outputs times the factors."""
        return self.base.parts_of(outputs.weighted(self.factor))

    def output_products(
        self, outputs: Outputs, first: Ints, second: Ints, weight: Floats
    ) -> Floats:
        """Return sums (o, c) of what a unit of one row does to each output times one of another.

        Of the pairs ``first`` and ``second`` (k,) with the ``weight`` (c, k).
        """
        return self.base.output_products(outputs.weighted(self.factor), first, second, weight)

    def response(self, outputs: Outputs, rows: Ints) -> Floats:
        """Return what unit errors of some ``rows`` (k,) do to ``outputs`` C: C N^-1 J', (o, k)."""
        return self.base.response(outputs.weighted(self.factor), rows)

    def sensitivity(self, outputs: Outputs, rows: Ints) -> Sensitivity:
        """Return the same in parts that are few, where they are."""
        return self.base.sensitivity(outputs.weighted(self.factor), rows)

    def hat_square_sums(self, share: Floats) -> Floats:
        """Return sums of squares (c, c) of J N^-1 J' between rows, ``share`` (c, n) of each."""
        return self.base.hat_square_sums(share)


def squares_outside(white: Floats, columns: Floats, sign: Floats) -> tuple[float, int]:
    """Return T = r'R^+r and the rank of R = 1 - ``columns`` (k, r) ``sign`` (r,) times their own.

    Of r = ``white`` (k,), which R can make. Eigenvalues up to CHECKED are taken for zero.
    """
    basis, triangle = np.linalg.qr(columns)
    taken, axes = np.linalg.eigh((triangle * sign) @ triangle.T)
    along, left = (white @ basis) @ axes, 1.0 - taken
    seen = left > CHECKED
    beside = (along[seen] ** 2 / left[seen]).sum() - along @ along
    return float(white @ white + beside), len(white) - int((~seen).sum())


def fix_open_directions(
    rows: Floats, directions: Floats, lengths: Floats
) -> tuple[Floats, Floats]:
    """Return H (G H)^+ (p, g) of open ``directions`` H (p, k) and definitions ``rows`` G (g, p).

    And those of the directions that no definition fixes. ``lengths`` (p,): of the columns, by
    which unknowns of different units are compared.
    """
    open_ = np.linalg.qr(directions * lengths[:, None])[0] / lengths[:, None]
    size = np.linalg.norm(rows / lengths, axis=1)
    size = np.where(size > 0.0, size, 1.0)
    u, s, vt = np.linalg.svd(rows / size[:, None] @ open_)
    kept = int((s > FIRM).sum())
    fixing = open_ @ (vt[:kept].T / s[:kept]) @ u[:, :kept].T / size
    return np.asarray(fixing), np.asarray(open_ @ vt[kept:].T)


def _inverse(square: Floats) -> Floats | None:
    """Return the inverse of a symmetric matrix of entries of order one; None if it is not firm."""
    values, vectors = np.linalg.eigh(square)
    if len(values) and np.abs(values).min() < FIRM:
        return None
    return np.asarray((vectors / values) @ vectors.T)


def dense(matrix: Floats | csr_array) -> Floats:
    """Return a matrix written out."""
    return matrix if isinstance(matrix, np.ndarray) else np.asarray(matrix.toarray())
