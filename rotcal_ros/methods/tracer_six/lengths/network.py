"""The network of stations, zeros and targets that lengths tie together: its linear algebra.

Every length touches one station and one target, so that the normal equations have two block
diagonals:

    [ A   C ] [x]   [a]      A: p blocks (s, s), stations or targets - the kept side
    [ C'  B ] [y] = [b]      B: q blocks (t, t), the other - the eliminated side

Eliminating B leaves p s unknowns (Schur complement), from whose inverse all covariances follow.
With a prior the side with more unknowns is eliminated, in a free network always the targets; what
a free network leaves open is fixed by constraints, see :mod:`.joint`.

With a zero per station the unknowns of the stations are (X, Y, Z, d), station by station. Zeros
that several stations share join the stations, which then are always kept: the blocks of the strips
are added up into one matrix of the coordinates of all stations, then all zeros. The same holds
where the stations' circle is stated, which ties them together.

Where many stations are tied by nothing but targets, whatever lengths of one station have to do
with those of others goes by way of the targets: :func:`view_of` then never makes the whole
covariance.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from rotcal_ros.adjust.low_rank import LowRank
from rotcal_ros.adjust.sensitivity import Sensitivity
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.errors import ObservabilityError
from rotcal_ros.geometry.rotations import cross_matrix

_UNDETERMINED: Final = (
    "the lengths do not determine stations and targets together: the normal matrix is singular; "
    "measure more targets from more stations"
)
RIGID_MOTIONS: Final = 6
"""Three shifts and three turns."""


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
        # the squared constraints lift exactly the directions that the matrix leaves at zero
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


def rigid(points: Floats) -> Floats:
    """Return what three shifts and three turns about the origin do to ``points``: (3 k, 6)."""
    motions = np.empty((len(points), 3, RIGID_MOTIONS))
    motions[:, :, :3] = np.eye(3)
    motions[:, :, 3:] = -cross_matrix(points)
    return motions.reshape(-1, RIGID_MOTIONS)


def less_rigid(points: Floats, moved: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Take shift and turn of all ``points`` off what they ``moved`` by, (n, 3).

    Return the rest and its standard deviations (n, 3): an S-transformation of its ``covariance``
    (3 n, 3 n).
    """
    motions = rigid(points - points.mean(axis=0))
    rest = np.eye(moved.size) - motions @ np.linalg.pinv(motions)
    variance = np.sum((rest @ covariance) * rest, axis=1)
    std = np.sqrt(np.maximum(variance, 0.0)).reshape(moved.shape)
    return (rest @ moved.ravel()).reshape(moved.shape), np.asarray(std)


class LengthView(ABC):
    """The linear view at a network, by the lengths of e places: their strips and targets (e,)."""

    @abstractmethod
    def leverage(self, strip: Ints, target: Ints) -> Floats:
        """Return the covariance (e, e) of the adjusted lengths, m^2."""

    @abstractmethod
    def sensitivity(self, strip: Ints, target: Ints) -> Sensitivity:
        """Return what the outputs are off by for a unit of each length over its variance."""

    def cofactor(self, strip: Ints, target: Ints, unit: Floats) -> LowRank:
        """Return the residual cofactor of lengths of one target, with 1 / std ``unit`` (e,)."""
        leverage = self.leverage(strip, target) * unit * unit[:, None]
        return LowRank.whole(np.eye(len(unit)) - 0.5 * (leverage + leverage.T))
