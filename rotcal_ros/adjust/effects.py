"""What a disturbance of known form does to the outputs, and from which size on a test finds it.

An *effect* is one or more columns A (n, k) of errors of the observations per unit of size: a
drift along each axis, a knock from here on, a wrong scale. At a solution with whitened residuals
r, S = A'RA and u = A'r say all about it: its size is S^+u with the covariance S^+, and T = u'S^+u
is chi-squared with the rank of S, or F where the noise was estimated from the same residuals and
the rest of them is the yardstick (external studentisation; Baarda 1968; Koch 1999, section 4.4).

The members of a *family* exclude each other: a knock at this moment or at that one. Neighbours in
time are alike, so that the largest of many is judged by the expected number of upcrossings (Rice
1944; Davies 1987) and by no more than independent ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol

import numpy as np
from scipy.sparse import csr_array
from scipy.special import erfc

from rotcal_ros.adjust.distributions import chi2_sf, detected, f_sf, noncentrality, normal_isf
from rotcal_ros.adjust.kernels import dense
from rotcal_ros.adjust.roots import root_between
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.protection import Treatment

UNSEEN: Final = 1e-9
"""Information of a size, per that of its errors without the unknowns, that is none."""
NOTHING: Final = 1e-150
"""Probability below which a normal quantile is not asked for: it would be infinite."""
INCREDIBLE: Final = 10.0
"""Times the largest size of an effect: who is no surer than that of a size does not see it."""
HARMLESS: Final = 0.1
"""Error, in standard uncertainties, of what cannot be separated from nothing."""


class Movements(Protocol):
    """What each of k columns does to o outputs, (k, o), worked out when it is asked for."""

    def __getitem__(self, which: slice) -> Floats:
        """Return what some of them do, (m, o)."""

    def worst(self, std: Floats) -> Floats:
        """Return the most (k,) that each does to an output, in their standard uncertainties."""


@dataclass(frozen=True, eq=False)
class Seen:
    """What the solution makes of k columns of errors, each of unit size.

    ``moved`` (k, o): what they do to the outputs. ``information`` (k, k): S, what of them is left
    in the residuals, of a family that of neighbours alone; ``score`` (k,): u; ``whole`` (k,):
    their squared length before the unknowns took up their part.
    """

    moved: Floats | Movements
    information: Floats | csr_array
    score: Floats
    whole: Floats

    def part(self, which: slice) -> Seen:
        """Return what is seen of some of the columns."""
        among = dense(self.information[which, which])
        return Seen(self.moved[which], among, self.score[which], self.whole[which])


class EffectTest(NamedTuple):
    """How an effect explains the residuals.

    ``size`` (k,) with ``covariance`` (k, k): of the columns, zero where nothing is seen.
    Chi-squared falls by ``squares`` for ``rank`` more unknowns; chance makes more of it with
    ``probability``. ``axes`` (k, rank): combinations of the columns that residuals can show.
    ``member``: which of a family it is, else 0. ``variance`` of the noise that it was tested by.
    """

    size: Floats
    covariance: Floats
    squares: float
    rank: int
    probability: float
    axes: Floats
    member: int = 0
    variance: float = 1.0


def effect_test(
    seen: Seen,
    rest: tuple[float, float] | None = None,
    least: float = 1e-300,
    nothing: float = UNSEEN,
    largest: float = np.inf,
) -> EffectTest:
    """Test all columns together, but for what sizes far beyond the ``largest`` alone would show.

    ``rest``: chi-squared and degrees of freedom of the adjustment where the noise was estimated
    from it; None: the noise is known. Its variance is ``least`` or more. ``nothing``: as UNSEEN.
    """
    axes, values, _ = _axes(seen, nothing)
    sure = np.linalg.norm(axes, axis=0) < INCREDIBLE * largest * np.sqrt(values)
    axes, values = axes[:, sure], values[sure]
    inverse = (axes / values) @ axes.T
    size = inverse @ seen.score
    squares, rank = float(seen.score @ size), len(values)
    variance, left = 1.0, np.inf
    if rest is not None:
        left = rest[1] - rank
        variance = max((rest[0] - squares) / max(left, 1.0), least)
    chance = _chance(squares, rank, variance, left)
    return EffectTest(size, inverse, squares, rank, chance, axes, variance=variance)


def family_test(seen: Seen, rest: tuple[float, float] | None = None) -> EffectTest:
    """Test single columns of which at most one is there, and return the best; neighbours alike."""
    k = int(np.argmax(member_squares(seen)))
    alone = effect_test(seen.part(slice(k, k + 1)), rest)
    u = normal_isf(max(0.5 * alone.probability, NOTHING))
    chance = above_of_family(u, correlations(seen.information)) if alone.rank else 1.0
    return alone._replace(probability=min(chance, 1.0), member=k)


def member_squares(seen: Seen) -> Floats:
    """Return what chi-squared falls by for each column (k,) alone; 0 where nothing is seen."""
    information = seen.information.diagonal()
    checked = information > UNSEEN * seen.whole
    return np.where(checked, seen.score**2 / np.where(checked, information, 1.0), 0.0)


def _axes(seen: Seen, nothing: float = UNSEEN) -> tuple[Floats, Floats, Floats]:
    """Return combinations (k, rank) of the columns that leave residuals, and their information.

    And the combinations (k, k - rank) that leave none. All columns count as of length one: S is
    brought to that scale before its eigenvalues are compared.
    """
    scale = np.sqrt(np.maximum(seen.whole, np.finfo(np.float64).tiny))
    values, vectors = np.linalg.eigh(dense(seen.information) / scale / scale[:, None])
    axes, checked = vectors / scale[:, None], values > nothing
    return axes[:, checked], values[checked], axes[:, ~checked]


def _chance(squares: float, rank: int, variance: float, left: float) -> float:
    """Return the probability of ``squares``; ``left``: degrees of freedom of the ``variance``."""
    if not rank or left < 1.0:
        return 1.0
    if np.isinf(left):
        return chi2_sf(squares, rank)
    return f_sf(squares / rank / variance, rank, left)


def correlations(information: Floats | csr_array) -> Floats:
    """Return the correlations (k - 1,) between the scores of neighbours, from S (k, k)."""
    root = np.sqrt(np.maximum(information.diagonal(), np.finfo(np.float64).tiny))
    return np.asarray(information.diagonal(1) / (root[1:] * root[:-1]))


def above_of_family(u: float, alike: Floats) -> float:
    """Return how probably the largest |score| of a family exceeds ``u`` by chance, two-sided.

    ``alike`` (k - 1,): correlations of neighbours. Expected upcrossings, acos(rho) / (2 pi)
    exp(-u^2 / 2) each (Rice's formula for a sequence), and never more than of independent scores.
    """
    rate = float(np.arccos(np.clip(alike, -1.0, 1.0)).sum()) / (2.0 * np.pi)
    above = 0.5 * float(erfc(u / np.sqrt(2.0)))
    crossings = min(rate * float(np.exp(-0.5 * u * u)), len(alike) * above)
    return 2.0 * (above + crossings)


class Unseen(NamedTuple):
    """The largest error that may stay unseen, in standard uncertainties of the outputs.

    ``found``: a larger effect is found with the stated power; else none larger was considered.
    ``hidden``: some of it leaves no residual at all.
    """

    error: float
    found: bool
    hidden: bool = False

    @classmethod
    def worst(cls, found_from: Floats, share: Floats, largest: float) -> Unseen:
        """Return the worst of k effects of one column, none of which is larger than ``largest``.

        ``found_from`` (k,): size from which on a test finds each, infinite: none does;
        ``share`` (k,): error per unit of size, in standard uncertainties.
        """
        error = np.minimum(found_from, largest) * share
        k = int(np.argmax(error))
        silent = bool(np.isinf(found_from[k]))
        return cls(float(error[k]), bool(found_from[k] <= largest), silent)

    @property
    def treatment(self) -> Treatment:
        """What a method does about an effect of which no more than this stays unseen."""
        if self.error <= HARMLESS:
            return "harmless"
        return "tested" if self.found else "not protected"


def unseen(
    seen: Seen,
    std: Floats,
    largest: float,
    *,
    significance: float,
    power: float,
    dof: float = np.inf,
) -> Unseen:
    """Return the worst that columns together do before their test finds them.

    ``std`` (o,) of the outputs, zero: one that does not count; ``largest``: a size that nobody
    would overlook. ``significance``: of this effect's own test. ``dof``: degrees of freedom of the
    adjustment, where the noise was estimated from it.
    """
    share = _share(seen.moved[:], std)
    axes, values, silent = _axes(seen)
    columns = max(len(seen.whole), 1)
    if dof - columns < 1.0:
        return _everything(share, largest)
    needed = noncentrality(significance, power, columns, dof - columns)
    shown = np.sqrt(needed * ((axes.T @ share) ** 2 / values[:, None]).sum(axis=0))
    hidden = largest * np.linalg.norm(np.linalg.qr(silent)[0].T @ share, axis=0)
    bound = largest * np.linalg.norm(share, axis=0)
    error = np.minimum(shown + hidden, bound)
    if not error.size:
        return Unseen(0.0, found=True)
    worst = int(np.argmax(error))
    found = hidden[worst] <= UNSEEN and shown[worst] <= bound[worst]
    return Unseen(float(error[worst]), bool(found), bool(hidden[worst] > UNSEEN))


def unseen_family(
    seen: Seen,
    std: Floats,
    largest: float,
    *,
    significance: float,
    power: float,
    dof: float = np.inf,
) -> Unseen:
    """Return the worst that one column of a family does before the test of all finds it.

    Arguments as of :func:`unseen`.
    """
    moved = seen.moved
    if isinstance(moved, np.ndarray):
        share = np.abs(_share(moved, std)).max(axis=1, initial=0.0)
    else:
        share = moved.worst(std)
    if not len(share):
        return Unseen(0.0, found=True)
    if dof - 1.0 < 1.0:
        return _everything(share[None], largest)
    information = seen.information.diagonal()
    checked = information > UNSEEN * seen.whole
    limit = limit_of_family(significance, correlations(seen.information))
    needed = detected(limit, power, dof - 1.0)
    size = np.where(checked, needed / np.sqrt(np.where(checked, information, 1.0)), np.inf)
    return Unseen.worst(size, share, largest)


def _everything(share: Floats, largest: float) -> Unseen:
    """Return that an effect stays unseen up to its ``largest`` size: no residual is left.

    ``share`` (k, o): what k columns that are there together do to the outputs.
    """
    return Unseen(largest * float(np.linalg.norm(share, axis=0).max(initial=0.0)), found=False)


def limit_of_family(significance: float, alike: Floats) -> float:
    """Return what the largest |score| of a family exceeds by chance with ``significance``."""
    return root_between(lambda u: above_of_family(u, alike) - significance, 0.0, 40.0, 1e-12)


def _share(moved: Floats, std: Floats) -> Floats:
    """Return moves (k, o') of the outputs that count, in their standard uncertainties."""
    counts = std > 0.0
    return np.asarray(moved[:, counts] / std[counts])
