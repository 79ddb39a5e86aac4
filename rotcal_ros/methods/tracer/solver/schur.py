"""Normal equations with two block diagonals, solved by eliminating one of them.

    [ A   C ] [x]   [a]      A: p blocks (s, s), stations or targets - the kept side
    [ C'  B ] [y] = [b]      B: q blocks (t, t), the other - the eliminated side

Every length touches one station and one target, so A and B are block diagonal. Eliminating B
leaves p s unknowns (Schur complement); all covariances follow from its inverse.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import ObservabilityError

_UNDETERMINED: Final = (
    "the lengths do not determine stations and targets together: the normal matrix is singular; "
    "measure more targets from more stations"
)


@dataclass(frozen=True, eq=False)
class SchurComplement:
    """The Schur complement of one normal matrix.

    ``matrix`` (p s, p s) = A - C B^-1 C'; ``inverse`` (q, t, t) = B^-1;
    ``transfer`` (p s, q t) = C B^-1; ``scale`` (p s,) brings the diagonal of ``matrix`` to one;
    ``constraints`` (p s, c): orthonormal columns that the scaled x has to be orthogonal to.
    """

    matrix: Floats
    inverse: Floats
    transfer: Floats
    scale: Floats
    constraints: Floats

    def regular(self) -> Floats:
        """Return the scaled matrix plus the squared constraints: positive definite."""
        scaled = self.matrix * self.scale * self.scale[:, None]
        return np.asarray(scaled + self.constraints @ self.constraints.T, dtype=np.float64)

    def solve(self, kept: Floats, other: Floats) -> tuple[Floats, Floats]:
        """Return x (p s,) and y (q t,) for right-hand sides of those shapes.

        Raises ObservabilityError when the matrix is singular in spite of its constraints.
        """
        factor = self._factor
        reduced = self.scale * (kept - self.transfer @ other)
        both = cho_solve(factor, np.column_stack([reduced, self.constraints]), check_finite=False)
        x = self.scale * (both[:, 0] - self._violation(both[:, 1:], both[:, :1])[:, 0])
        q, t, _ = self.inverse.shape
        y = (self.inverse @ other.reshape(q, t, 1)).ravel() - self.transfer.T @ x
        return x, y

    @cached_property
    def _factor(self) -> tuple[Floats, bool]:
        try:
            factor = cho_factor(self.regular(), lower=True, check_finite=False)
        except np.linalg.LinAlgError:
            raise ObservabilityError(_UNDETERMINED) from None
        return np.asarray(factor[0], dtype=np.float64), bool(factor[1])

    def covariance(self) -> Floats:
        """Return the covariance (p s, p s) of the kept side, under the constraints."""
        return self._covariance

    @cached_property
    def _covariance(self) -> Floats:
        inverse: Floats = np.asarray(np.linalg.inv(self.regular()), dtype=np.float64)
        inverse -= self._violation(inverse @ self.constraints, inverse)
        inverse *= self.scale * self.scale[:, None]
        return np.asarray(0.5 * (inverse + inverse.T), dtype=np.float64)

    def _violation(self, response: Floats, columns: Floats) -> Floats:
        """Return what to subtract from ``columns`` to bring them on the constraints.

        ``response`` is the inverse of :meth:`regular` times the constraints (Lagrange).
        """
        multipliers = np.linalg.solve(self.constraints.T @ response, self.constraints.T @ columns)
        return response @ multipliers

    def other_blocks(self, covariance: Floats) -> Floats:
        """Return the covariance blocks (q, t, t) of the eliminated side."""
        q, t, _ = self.inverse.shape
        columns = self.transfer.T.reshape(q, t, -1)
        spread = (self.transfer.T @ covariance).reshape(q, t, -1)
        return np.asarray(self.inverse + spread @ columns.swapaxes(1, 2), dtype=np.float64)

    def other_times(self, covariance: Floats, vectors: Floats) -> Floats:
        """Return the covariance of the eliminated side times ``vectors`` (q t, c)."""
        q, t, _ = self.inverse.shape
        own = (self.inverse @ vectors.reshape(q, t, -1)).reshape(q * t, -1)
        product = own + self.transfer.T @ (covariance @ (self.transfer @ vectors))
        return np.asarray(product, dtype=np.float64)


def eliminate(
    kept: Floats, other: Floats, cross: Floats, constraints: Floats | None = None
) -> SchurComplement:
    """Eliminate the side ``other`` (q, t, t) from ``kept`` (p, s, s), ``cross`` (p s, q t).

    ``constraints`` (p s, c): x has to be orthogonal to these columns, which stand in for what the
    data leave open.
    """
    p, s, _ = kept.shape
    inverse, transfer, matrix = _schur(other, cross)
    matrix.reshape(p, s, p, s)[np.arange(p), :, np.arange(p)] += kept
    return _reduced(matrix, inverse, transfer, constraints)


def eliminate_from(
    kept: Floats, other: Floats, cross: Floats, constraints: Floats | None = None
) -> SchurComplement:
    """Do as :func:`eliminate` for a kept side that is one matrix (y, y), ``cross`` (y, q t)."""
    inverse, transfer, matrix = _schur(other, cross)
    return _reduced(matrix + kept, inverse, transfer, constraints)


def _schur(other: Floats, cross: Floats) -> tuple[Floats, Floats, Floats]:
    """Return B^-1, C B^-1 and -C B^-1 C'; raises ObservabilityError where a block is singular.

    Such is a station from which all targets stand in one line.
    """
    q, t, _ = other.shape
    try:
        inverse = np.asarray(np.linalg.inv(other))
    except np.linalg.LinAlgError:
        raise ObservabilityError(_UNDETERMINED) from None
    transfer = np.empty_like(cross)
    by_block = cross.reshape(-1, q, t).swapaxes(0, 1) @ inverse
    transfer.reshape(-1, q, t)[...] = by_block.swapaxes(0, 1)
    matrix = -transfer @ cross.T
    return inverse, transfer, 0.5 * (matrix + matrix.T)


def _reduced(
    matrix: Floats, inverse: Floats, transfer: Floats, constraints: Floats | None
) -> SchurComplement:
    scale = 1.0 / np.sqrt(np.maximum(matrix.diagonal(), np.finfo(np.float64).tiny))
    if constraints is None:
        columns = np.empty((len(matrix), 0))
    else:
        columns = np.linalg.qr(constraints * scale[:, None])[0]
    return SchurComplement(matrix, inverse, transfer, scale, np.asarray(columns))
