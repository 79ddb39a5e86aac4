"""Observations that belong together, as the linear view at a solution sees them.

With whitened observations y = f(x) + e, e ~ N(0, I), design J, normal matrix N and outputs
C x, the residuals are r = R e, R = I - J N^-1 J', and the outputs are off by B e, B = C N^-1 J'.
All that is asked of a group of observations is in r, R and B of its own rows. Elements of a group
are what can be wrong as a whole: a length is one row, the centre of a ball three.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from rotcal_ros.adjust.distributions import chi2_sf, f_sf
from rotcal_ros.adjust.low_rank import LowRank
from rotcal_ros.adjust.sensitivity import Sensitivity
from rotcal_ros.foundation.arrays import Bools, Floats, Ints

CHECKED: Final = 1e-6
"""Share of an observation, or of a combination of some, below which nothing checks it."""


@dataclass(frozen=True, eq=False)
class Group:
    """One group of e elements with c axes each; o outputs.

    ``kind``, ``name``: for people, as "station" and "station 3". ``members`` (e,): the caller's
    numbers of the elements. ``residual`` (e, c): r, observed - computed, whitened. ``cofactor``
    (e, c, e, c): R. ``influence``: returns :attr:`sensitivity`, which of few groups is asked for.
    ``unit`` (e, c): whitened units per unit of a common shift, the inverse standard deviation;
    zero where an element lacks the axis, whose other entries are zero too. ``gathered`` (q, e):
    subsets that lie together, see :mod:`.subsets`. ``lost``: how many elements of the group were
    rejected before, which are no members. ``eigen``: eigenvalues and vectors of R, where a
    layout's are remembered.
    """

    kind: str
    name: str
    members: Ints
    residual: Floats
    cofactor: Floats
    influence: Callable[[], Sensitivity]
    unit: Floats
    gathered: Bools
    lost: int = 0
    eigen: tuple[Floats, Floats] | None = None

    @classmethod
    def of(
        cls,
        kind: str,
        name: str,
        members: Ints,
        residual: Floats,
        unit: Floats,
        leverage: Floats,
        influence: Callable[[], Sensitivity],
        gathered: Bools | None = None,
        lost: int = 0,
    ) -> Group:
        """Return the group of rows whose adjusted values have the covariance ``leverage``.

        (e c, e c), whitened. Rows that are not there are zero, in ``unit`` too. Other arguments
        as of the class; ``gathered`` None: no subset.
        """
        cofactor = np.diag((unit.ravel() > 0.0).astype(np.float64)) - leverage
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
        there = self.unit[self.unit > 0.0]
        if not there.size or there.min() == there.max():
            return float(there[0]) if there.size else 1.0
        return float(np.median(there))

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
        values, vectors = self.axes
        seen = values > CHECKED
        along = vectors[:, seen].T @ self.residual.ravel()
        return float((along**2 / values[seen]).sum()), int(seen.sum())

    @cached_property
    def axes(self) -> tuple[Floats, Floats]:
        """Eigenvalues (e c,) of R, from 0 to 1, and its vectors."""
        n = self.residual.size
        values, vectors = self.eigen or np.linalg.eigh(self.cofactor.reshape(n, n))
        return np.clip(values, 0.0, 1.0), vectors

    @property
    def checks(self) -> tuple[float, int]:
        """Sum of the rows' shares that others check, and the number of rows."""
        return float(self.axes[0].sum()), int((self.unit > 0.0).sum())


@dataclass(frozen=True, eq=False)
class Undivided:
    """A group of ``size`` elements that are judged together and no other way, however many.

    ``residual`` (n,) and ``cofactor`` (n, n) of their rows as of a :class:`Group`.
    """

    kind: str
    name: str
    size: int
    residual: Floats
    cofactor: LowRank
    lost: int = 0

    @cached_property
    def together(self) -> tuple[float, int]:
        """T = r'R^+r and its degrees of freedom."""
        return self.cofactor.squares(self.residual, CHECKED)

    @property
    def checks(self) -> tuple[float, int]:
        """Sum of the rows' shares that others check, and the number of rows."""
        return float(self.cofactor.diagonal().sum()), len(self.residual)


class JudgedWhole(NamedTuple):
    """A group of ``size`` rows that was judged together by other means.

    ``together``: T and its degrees of freedom, ``checks``: sum of the rows' shares that others
    check, and the number of rows, as of a :class:`Group`.
    """

    kind: str
    name: str
    size: int
    together: tuple[float, int]
    checks: tuple[float, int]
    lost: int = 0


@dataclass(frozen=True, slots=True)
class GroupTest:
    """What the residuals of one group say together.

    ``squares``: T = r'R^+r, chi-squared with ``rank`` degrees of freedom, ``probability``: how
    probably chance exceeds it. ``redundancy``: share of a row that others check, on average.
    ``lost_share``: share of the group's elements that were rejected.
    """

    squares: float
    rank: int
    probability: float
    redundancy: float
    lost_share: float


def group_test(
    group: Group | Undivided | JudgedWhole, rest: tuple[float, float] | None = None
) -> GroupTest:
    """Test ``group`` as a whole.

    ``rest``: chi-squared and degrees of freedom of the whole adjustment, where the noise was
    estimated from it: what the group leaves of them is its yardstick (external studentisation),
    and T / rank is F. None: the noise is known.
    """
    squares, rank = group.together
    probability = 1.0
    if rank and rest is None:
        probability = chi2_sf(squares, rank)
    elif rank and rest is not None and rest[1] - rank >= 1.0:
        variance = max(rest[0] - squares, 1e-300) / (rest[1] - rank)
        probability = f_sf(squares / rank / variance, rank, rest[1] - rank)
    checked, rows = group.checks
    whole = group.size + group.lost
    return GroupTest(
        squares, rank, probability, checked / max(rows, 1), group.lost / whole if whole else 0.0
    )


@dataclass(frozen=True, eq=False)
class SolutionView:
    """The linear view at a solution, by the covariance of all its unknowns.

    ``covariance`` (p, p): N^-1, of whatever the data and their priors leave of p unknowns;
    ``outputs`` (o, p): C.
    """

    covariance: Floats
    outputs: Floats

    @cached_property
    def carried(self) -> Floats:
        """C N^-1, (o, p)."""
        return np.asarray(self.outputs @ self.covariance)

    @property
    def std(self) -> Floats:
        """Standard deviations (o,) of the outputs."""
        variance = np.einsum("op,op->o", self.carried, self.outputs)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    def group(
        self,
        kind: str,
        name: str,
        members: Ints,
        design: Floats,
        residual: Floats,
        unit: Floats,
        gathered: Bools | None = None,
        lost: int = 0,
    ) -> Group:
        """Return the group of rows with the whitened ``design`` (e, c, p) and ``residual`` (e, c).

        Rows that are not there are zero, in ``unit`` (e, c) too. Other arguments as in
        :class:`Group`.
        """
        rows = design.reshape(residual.size, -1)
        spread = rows @ self.covariance

        def influence() -> Sensitivity:
            return Sensitivity.whole(np.asarray(self.outputs @ spread.T))

        return Group.of(
            kind, name, members, residual, unit, spread @ rows.T, influence, gathered, lost
        )


@dataclass(frozen=True, eq=False)
class Dense:
    """The linear view by the whole design: the reference, and enough for small problems.

    ``design`` (n, p): whitened J, rows of priors included. ``outputs`` (o, p): C. ``residual``
    (n,): whitened, observed - computed. What the design leaves open is taken as fixed
    (Moore-Penrose), so the outputs have to be such that they do not feel it.
    """

    design: Floats
    outputs: Floats
    residual: Floats

    @cached_property
    def view(self) -> SolutionView:
        """The view by the covariance of the unknowns."""
        gain = np.linalg.pinv(self.design)
        return SolutionView(gain @ gain.T, self.outputs)

    @property
    def std(self) -> Floats:
        """Standard deviations (o,) of the outputs."""
        return self.view.std

    def group(
        self,
        kind: str,
        name: str,
        members: Ints,
        rows: Ints,
        unit: Floats | None = None,
        gathered: Bools | None = None,
        lost: int = 0,
    ) -> Group:
        """Return the group of ``rows`` (e, c) or (e,) of the design; -1: none.

        ``unit`` as ``rows``; None: ones. Other arguments as in :class:`Group`.
        """
        at = rows.reshape(len(members), -1)
        there = at >= 0
        units = np.ones(at.shape) if unit is None else unit.reshape(at.shape)
        return self.view.group(
            kind,
            name,
            members,
            self.design[at] * there[:, :, None],
            self.residual[at] * there,
            units * there,
            gathered,
            lost,
        )
