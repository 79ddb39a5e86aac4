"""By how much the outputs of an adjustment are off per unit of each error, in parts that are few.

A row of a large problem moves the outputs of its own place, and all of them by way of the few
unknowns that are common. Only what is asked of a group is ever multiplied out.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array, hstack

from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.compact import FULL, CompactCovariance, Spread


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """The matrix (o, n) of what o outputs are off by per unit error of n rows.

    ``along`` (r, n), ``common`` (o, r): all outputs feel common @ along; None: ``along`` is the
    matrix itself. ``own`` (t, n): what the outputs ``at`` (t,) feel beside that.
    """

    along: Floats
    common: Floats | None
    at: Ints
    own: Floats

    @classmethod
    def whole(cls, matrix: Floats) -> Sensitivity:
        """Return a whole ``matrix`` (o, n)."""
        return cls(matrix, None, np.zeros(0, dtype=np.int64), np.zeros((0, matrix.shape[1])))

    @property
    def outputs(self) -> int:
        """The number o of outputs."""
        return len(self.along if self.common is None else self.common)

    def dense(self) -> Floats:
        """Return the whole matrix."""
        if self.common is None:
            return self.along
        whole = self.common @ self.along
        whole[self.at] += self.own
        return np.asarray(whole)

    def of(self, errors: Floats) -> Floats:
        """Return what ``errors`` (n, c) of the rows do to the outputs, (o, c)."""
        found = self.along @ errors
        if self.common is None:
            return np.asarray(found)
        found = self.common @ found
        found[self.at] += self.own @ errors
        return np.asarray(found)

    def weighted(self, factor: Floats | float) -> Sensitivity:
        """Return the matrix with each row's error ``factor`` (n,) times as large."""
        return replace(self, along=self.along * factor, own=self.own * factor)


@dataclass(frozen=True, eq=False)
class ErrorMoments:
    """Expected error (n,) of the rows of a group, and its square (n, n)."""

    sensitivity: Sensitivity
    first: Floats
    square: Floats


def sum_moments(moments: Iterable[ErrorMoments], outputs: int) -> tuple[Floats, Spread]:
    """Return the sums over groups of the outputs' expected error (o,) and of its square (o, o).

    All ``moments`` have the same common part, and few outputs beside it where there are many.
    """
    mean, large = np.zeros(outputs), outputs > FULL
    second, own = np.zeros((0, 0) if large else (outputs, outputs)), list[csr_array]()
    common: Floats | None = None
    first, square, mixed = np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0))
    for moment in _by_sensitivity(moments) if large else moments:
        sensitivity = moment.sensitivity
        along = sensitivity.along @ moment.square
        if sensitivity.common is None:
            second = second if second.size else np.zeros((outputs, outputs))
            mean += sensitivity.along @ moment.first
            second += along @ sensitivity.along.T
            continue
        if common is None:
            common, r = sensitivity.common, len(sensitivity.along)
            first, square, mixed = np.zeros(r), np.zeros((r, r)), np.zeros((r, outputs))
        first += sensitivity.along @ moment.first
        square += along @ sensitivity.along.T
        mean[sensitivity.at] += sensitivity.own @ moment.first
        mixed[:, sensitivity.at] += along @ sensitivity.own.T
        if large:
            own.append(_own_root(moment, outputs))
            continue
        beside = sensitivity.own @ moment.square @ sensitivity.own.T
        second[np.ix_(sensitivity.at, sensitivity.at)] += beside
    if common is None:
        return mean, second if second.size else np.zeros((outputs, outputs))
    mean += common @ first
    if large:
        size = len(square)
        core = np.block([[square, np.eye(size)], [np.eye(size), np.zeros((size, size))]])
        near = csr_array(hstack(own, format="csr"))
        return mean, CompactCovariance.of(near, np.hstack([common, mixed.T]), core)
    half = common @ (0.5 * (common @ square).T + mixed)
    second += half
    second += half.T
    return mean, second


def _by_sensitivity(moments: Iterable[ErrorMoments]) -> Iterable[ErrorMoments]:
    """Return the sums of those that have one sensitivity."""
    found = dict[int, ErrorMoments]()
    for each in moments:
        before = found.get(id(each.sensitivity))
        if before is not None:
            each = replace(
                before, first=before.first + each.first, square=before.square + each.square
            )
        found[id(each.sensitivity)] = each
    return found.values()


def _own_root(moment: ErrorMoments, outputs: int) -> csr_array:
    """Return a root (o, c) of the square of what outputs feel beside the common part."""
    at, own, square = moment.sensitivity.at, moment.sensitivity.own, moment.square
    few = own.shape[1] < len(at)
    values, ways = np.linalg.eigh(square if few else own @ square @ own.T)
    root = ways * np.sqrt(np.maximum(values, 0.0))
    root = own @ root if few else root
    places = np.repeat(at, root.shape[1]), np.tile(np.arange(root.shape[1]), len(at))
    return csr_array((root.ravel(), places), shape=(outputs, root.shape[1]))
