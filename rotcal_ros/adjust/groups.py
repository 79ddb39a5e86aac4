"""Observations that belong together, as the linear view at a solution sees them.

With whitened observations y = f(x) + e, e ~ N(0, I), design J, normal matrix N and outputs
C x, the residuals are r = R e, R = I - J N^-1 J', and the outputs are off by B e, B = C N^-1 J'.
All that is asked of a group of observations is in r, R and B of its own rows. Elements of a group
are what can be wrong as a whole: a length is one row, the centre of a ball three.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from scipy.special import chdtrc, fdtrc

from rotcal_ros.adjust.sensitivity import Sensitivity
from rotcal_ros.foundation.arrays import Bools, Floats, Ints
from rotcal_ros.foundation.language import Phrase

CHECKED: Final = 1e-6
"""Share of an observation, or of a combination of some, below which nothing checks it."""


@dataclass(frozen=True, eq=False)
class Group:
    """One group of e elements with c axes each; o outputs.

    ``kind``, ``name``: for people, as "station" and "station 3". ``members`` (e,): the caller's
    numbers of the elements. ``residual`` (e, c): r, observed - computed, whitened. ``cofactor``
    (e, c, e, c): R. ``influence``: returns :attr:`sensitivity`, which of few groups is asked for.
    ``unit`` (e, c): whitened units per unit of a common shift, the inverse standard deviation.
    ``gathered`` (q, e):
    subsets that lie together, see :mod:`.subsets`. ``lost``: how many elements of the group were
    rejected before, which are no members. ``spectrum``: :attr:`along_axes`, where it is known.
    """

    kind: str
    name: Phrase
    members: Ints
    residual: Floats
    cofactor: Floats
    influence: Callable[[], Sensitivity]
    unit: Floats
    gathered: Bools
    lost: int = 0
    spectrum: tuple[Floats, Floats] | None = None

    @classmethod
    def of(
        cls,
        kind: str,
        name: Phrase,
        members: Ints,
        residual: Floats,
        unit: Floats,
        leverage: Floats,
        influence: Callable[[], Sensitivity],
        gathered: Bools | None = None,
        lost: int = 0,
    ) -> Group:
        """Return the group of rows whose adjusted values have the covariance ``leverage``.

        (e c, e c), whitened. Other arguments as of the class; ``gathered`` None: no subset.
        """
        cofactor = np.eye(len(leverage)) - leverage
        cofactor = 0.5 * (cofactor + cofactor.T)
        shape = residual.shape
        if gathered is None:
            gathered = np.zeros((0, len(members)), dtype=np.bool_)
        return cls(
            kind, name, members, residual, cofactor.reshape(*shape, *shape), influence, unit,
            gathered, lost,
        )  # fmt: skip

    @property
    def size(self) -> int:
        """The number e of elements."""
        return len(self.members)

    @cached_property
    def sensitivity(self) -> Sensitivity:
        """B (o, e c): by how much an output is off per whitened unit error."""
        return self.influence()

    @property
    def response(self) -> Floats:
        """B as a whole, (o, e, c)."""
        return self.sensitivity.dense().reshape(-1, *self.residual.shape)

    @cached_property
    def relative(self) -> Floats:
        """``unit`` (e, c) over its median: sizes of shifts count in usual standard deviations."""
        return self.unit / self._usual

    @property
    def usual_std(self) -> float:
        """The median standard deviation of a row, in the unit of a shift."""
        return 1.0 / self._usual

    @cached_property
    def _usual(self) -> float:
        first = float(self.unit.flat[0])
        return first if (self.unit == first).all() else float(np.median(self.unit))

    @cached_property
    def score(self) -> Floats:
        """What each element (e, c) adds to A'r of a common shift A, per usual deviation."""
        return np.asarray(self.relative * self.residual)

    @cached_property
    def weight(self) -> Floats:
        """What pairs of elements (e, c, e, c) add to A'RA of a common shift."""
        return np.asarray(self.relative[:, :, None, None] * self.cofactor * self.relative)

    @cached_property
    def leading(self) -> Floats:
        """Sums (e + 1, e + 1) of ``weight`` over the first 0 to e elements with one axis."""
        return np.pad(self.weight[:, 0, :, 0].cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))

    @cached_property
    def together(self) -> tuple[float, int]:
        """T = r'R^+r and its degrees of freedom."""
        values, along = self.along_axes
        seen = values > CHECKED
        return float((along[seen] ** 2 / values[seen]).sum()), int(seen.sum())

    @cached_property
    def along_axes(self) -> tuple[Floats, Floats]:
        """Eigenvalues (e c,) of R, from 0 to 1, and the residuals along its vectors."""
        if self.spectrum is not None:
            return self.spectrum
        values, vectors = self.axes
        return values, vectors.T @ self.residual.ravel()

    @cached_property
    def axes(self) -> tuple[Floats, Floats]:
        """Eigenvalues (e c,) of R, from 0 to 1, and its vectors."""
        n = self.residual.size
        values, vectors = np.linalg.eigh(self.cofactor.reshape(n, n))
        return np.clip(values, 0.0, 1.0), vectors

    @property
    def checks(self) -> tuple[float, int]:
        """Sum of the rows' shares that others check, and the number of rows."""
        return float(self.along_axes[0].sum()), self.unit.size


class JudgedGroup(NamedTuple):
    """A group of ``size`` rows that was judged together by other means.

    ``together``: T and its degrees of freedom, ``checks``: sum of the rows' shares that others
    check, and the number of rows, as of a :class:`Group`.
    """

    kind: str
    name: Phrase
    size: int
    together: tuple[float, int]
    checks: tuple[float, int]
    lost: int = 0


@dataclass(frozen=True, slots=True)
class GroupTest:
    """What the residuals of one group say together.

    ``squares``: T = r'R^+r, chi-squared with ``rank`` degrees of freedom, ``probability``: how
    probably chance exceeds it. ``redundancy``: share of a row that others check, on average.
    """

    squares: float
    rank: int
    probability: float
    redundancy: float


def group_tests(
    groups: Sequence[Group | JudgedGroup], rest: tuple[float, float] | None = None
) -> list[GroupTest]:
    """Test each of the ``groups`` as a whole.

    ``rest``: chi-squared and degrees of freedom of the whole adjustment, where the noise was
    estimated from it: what the group leaves of them is its yardstick (external studentisation),
    and T / rank is F. None: the noise is known.
    """
    squares, rank = np.array([group.together for group in groups]).reshape(-1, 2).T
    checked, rows = np.array([group.checks for group in groups]).reshape(-1, 2).T
    tested, probability = rank > 0, np.ones(len(groups))
    if rest is None:
        probability[tested] = chdtrc(rank[tested], squares[tested])
    else:
        left = rest[1] - rank
        tested &= left >= 1.0
        of, under = rank[tested], left[tested]
        variance = np.maximum(rest[0] - squares[tested], 1e-300) / under
        probability[tested] = fdtrc(of, under, squares[tested] / of / variance)
    each = squares, rank.astype(np.int64), probability, checked / np.maximum(rows, 1)
    return [GroupTest(*test) for test in zip(*(of.tolist() for of in each), strict=True)]
