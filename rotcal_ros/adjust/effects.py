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
from functools import cached_property
from typing import Final, NamedTuple, Protocol

import numpy as np
from scipy.special import erfc, gammaln, xlogy

from rotcal_ros.adjust.distributions import (
    chi2_isf,
    chi2_sf,
    f_sf,
    noncentrality,
    normal_isf,
    normal_sf,
    t_isf,
)
from rotcal_ros.adjust.roots import root_between
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.protection import Treatment

UNSEEN: Final = 1e-9
"""Information of a size, per that of its errors without the unknowns, that is none."""
AT_ONCE: Final = 64
"""Members of a family of which it is worked out at once what they do."""
NOTHING: Final = 1e-150
"""Probability below which a normal quantile is not asked for: it would be infinite."""
RATHER_RARE: Final = 1e-4
"""Chance at which members of a family that hold more and fewer columns are compared."""
INCREDIBLE: Final = 10.0
"""Times the largest size of an effect: who is no surer than that of a size does not see it."""
COVERED: Final = 1.959964
"""Standard uncertainties on either side that hold 95 % of a normal distribution."""
HARMLESS: Final = 0.1
"""Error, in standard uncertainties, of what cannot be separated from nothing."""


class EffectOnOutputs(Protocol):
    """What each of some columns does to o outputs, worked out when it is asked for."""

    def __getitem__(self, which: slice) -> Floats:
        """Return what some of them do, (m, o)."""

    def worst(self, std: Floats, *roots: Floats) -> list[Floats]:
        """Return as :func:`worst_combined_effect`."""


@dataclass(frozen=True, eq=False)
class ObservableEffect:
    """What the solution makes of k columns of errors, each of unit size.

    ``moved`` (k, o): what they do to the outputs. ``information`` (k, k): S, what of them is left
    in the residuals; ``score`` (k,): u; ``whole`` (k,): their squared length before the unknowns
    took up their part.
    """

    moved: Floats
    information: Floats
    score: Floats
    whole: Floats


@dataclass(frozen=True, eq=False)
class ObservableFamily:
    """The same of k members of w columns each, of which at most one is there, in time.

    ``moved`` (k w, o), member by member; ``information`` (k, w, w) of each and ``beside``
    (k - 1, w, w) between it and the next; ``score``, ``whole`` (k, w).
    """

    moved: Floats | EffectOnOutputs
    information: Floats
    beside: Floats
    score: Floats
    whole: Floats

    def member(self, k: int) -> ObservableEffect:
        """Return what is seen of one member."""
        w = self.score.shape[1]
        moved = self.moved[k * w : (k + 1) * w]
        return ObservableEffect(moved, self.information[k], self.score[k], self.whole[k])

    def column(self, j: int) -> ObservableEffect:
        """Return what is seen of one column of a member alone."""
        k, way = divmod(j, self.score.shape[1])
        at = slice(way, way + 1)
        information, score = self.information[k, at, at], self.score[k, at]
        return ObservableEffect(self.moved[j : j + 1], information, score, self.whole[k, at])

    @cached_property
    def roots(self) -> tuple[Floats, Floats]:
        """Combinations (k, w, w) of unit information, zero where there is none; and of none."""
        scale = np.sqrt(np.maximum(self.whole, np.finfo(np.float64).tiny))
        scaled = self.information / scale[:, :, None] / scale[:, None]
        values, vectors = np.linalg.eigh(scaled)
        axes, checked = vectors / scale[:, :, None], (values > UNSEEN)[:, None]
        root = np.sqrt(np.where(checked, values[:, None], 1.0))
        return np.where(checked, axes / root, 0.0), np.where(checked, 0.0, axes)

    @cached_property
    def rank(self) -> Ints:
        """How many combinations (k,) residuals show of each member."""
        return np.asarray(self.roots[0].any(axis=1).sum(axis=1))

    @cached_property
    def squares(self) -> Floats:
        """What chi-squared falls by for each member (k,) alone; 0 where nothing is seen."""
        return np.asarray(((self.score[:, None] @ self.roots[0]) ** 2).sum(axis=(1, 2)))

    @cached_property
    def squares_of_one(self) -> Floats:
        """The same of each column (k w,) alone."""
        own = self.information.diagonal(axis1=1, axis2=2)
        seen = own > UNSEEN * self.whole
        return np.where(seen, self.score**2 / np.where(seen, own, 1.0), 0.0).ravel()

    @cached_property
    def alike(self) -> Floats:
        """Correlations (k - 1,) between neighbours: of the mean angle by which they turn."""
        root = self.roots[0]
        both = root[:-1].swapaxes(1, 2) @ self.beside @ root[1:]
        turned = np.arccos(np.minimum(np.linalg.svd(both, compute_uv=False), 1.0))
        count = np.maximum(np.minimum(self.rank[:-1], self.rank[1:]), 1)
        there = np.arange(turned.shape[1]) < count[:, None]  # largest correlations first
        return np.asarray(np.cos(np.sqrt((turned**2 * there).sum(axis=1) / count)))


def worst_combined_effect(
    moved: Floats | EffectOnOutputs, std: Floats, *roots: Floats
) -> list[Floats]:
    """Return the most (k,) that combinations of the columns of each member do to an output.

    ``roots`` (k, w, r): the combinations, in which each output adds up squares; in the ``std``
    (o,) of the outputs, zero or infinite: one that does not count.
    """
    if not isinstance(moved, np.ndarray):
        return moved.worst(std, *roots)
    found, w = [np.zeros(len(r)) for r in roots], roots[0].shape[1]
    for begin in range(0, len(roots[0]), AT_ONCE):
        some = slice(begin, begin + AT_ONCE)
        share = _share(moved[begin * w : (begin + AT_ONCE) * w], std)
        share = share.reshape(-1, w, share.shape[1]).swapaxes(1, 2)
        for most, r in zip(found, roots, strict=True):
            squares = ((share @ r[some]) ** 2).sum(axis=2)
            most[some] = np.sqrt(squares.max(axis=1, initial=0.0))
    return found


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


def expected_weights(seen: ObservableFamily, size: float, probability: float) -> Floats:
    """Return what each column (k w,) adds to the covariance, times the square of its unit.

    One of them may be off by ``size``, plus or minus, with ``probability`` beforehand: that times
    its likelihood ratio is how probable it is afterwards, and its expected square what it adds.
    """
    information = seen.information.diagonal(axis1=1, axis2=2).ravel()
    pull = np.abs(seen.score.ravel()) * size
    logs = pull + np.log1p(np.exp(-2.0 * pull)) - np.log(2.0) - 0.5 * information * size**2
    ratio = np.exp(np.minimum(logs, 600.0)) * probability / max(len(logs), 1)
    return np.asarray(size**2 * ratio / (1.0 - probability + ratio.sum()))


def effect_test(
    seen: ObservableEffect,
    rest: tuple[float, float] | None = None,
    largest: float = np.inf,
) -> EffectTest:
    """Test all columns together, but for what sizes far beyond the ``largest`` alone would show.

    ``rest``: chi-squared and degrees of freedom of the adjustment where the noise was estimated
    from it; None: the noise is known.
    """
    axes, values, _ = _axes(seen)
    sure = np.linalg.norm(axes, axis=0) < INCREDIBLE * largest * np.sqrt(values)
    axes, values = axes[:, sure], values[sure]
    inverse = (axes / values) @ axes.T
    size = inverse @ seen.score
    squares, rank = float(seen.score @ size), len(values)
    variance, left = 1.0, np.inf
    if rest is not None:
        left = rest[1] - rank
        variance = max((rest[0] - squares) / max(left, 1.0), 1e-300)
    chance = _chance(squares, rank, variance, left)
    return EffectTest(size, inverse, squares, rank, chance, axes, variance=variance)


def family_test(seen: ObservableFamily, rest: tuple[float, float] | None = None) -> EffectTest:
    """Test members of which at most one is there, and return the best; neighbours are alike."""
    usual = chi2_isf(RATHER_RARE, np.maximum(seen.rank, 1))
    k = int(np.argmax(seen.squares - usual))
    alone = effect_test(seen.member(k), rest)
    return alone._replace(probability=chance_in_family(alone, seen), member=k)


def chance_in_family(alone: EffectTest, seen: ObservableFamily) -> float:
    """Return how probably the largest of a family is by chance as rare as one ``alone``."""
    if not alone.rank:
        return 1.0
    u = normal_isf(max(0.5 * alone.probability, NOTHING))
    return min(family_exceedance(u, seen.alike, seen.rank), 1.0)


def unresolved_sizes(test: EffectTest, seen: ObservableEffect) -> Floats:
    """Return what sizes that leave no residual do, (o + a, s): as large as the others, s ways.

    Of a move of which residuals show some ways alone the others are as probable. So few ways show
    roughly how large: 1.96 hold 95 % as those of Student's t do.
    """
    ways = np.linalg.qr(_axes(seen)[2])[0]
    shown = test.size - ways @ (ways.T @ test.size)
    size = float(np.linalg.norm(shown)) / np.sqrt(max(test.rank, 1))
    few = t_isf(normal_sf(COVERED), max(test.rank, 1)) / COVERED
    return np.asarray(few * size * (ways.T @ seen.moved).T)


def chance_beside_scatter(
    test: EffectTest, squares: Floats, weight: Floats, rest: tuple[float, float] | None
) -> float:
    """Return how probable a ``test`` is whose ``squares`` (m,) depend on what scatters.

    Of ``weight`` (m,): by a size that is hardly known, which leaves much to chance.
    """
    left = np.inf if rest is None else rest[1] - test.rank
    each = [_chance(t, test.rank, test.variance, left) for t in squares.tolist()]
    return float(weight @ each)


def _axes(seen: ObservableEffect) -> tuple[Floats, Floats, Floats]:
    """Return combinations (k, rank) of the columns that leave residuals, and their information.

    And the combinations (k, k - rank) that leave none. All columns count as of length one: S is
    brought to that scale before its eigenvalues are compared.
    """
    scale = np.sqrt(np.maximum(seen.whole, np.finfo(np.float64).tiny))
    values, vectors = np.linalg.eigh(seen.information / scale / scale[:, None])
    axes, checked = vectors / scale[:, None], values > UNSEEN
    return axes[:, checked], values[checked], axes[:, ~checked]


def _chance(squares: float, rank: int, variance: float, left: float) -> float:
    """Return the probability of ``squares``; ``left``: degrees of freedom of the ``variance``."""
    if not rank or left < 1.0:
        return 1.0
    if np.isinf(left):
        return chi2_sf(squares, rank)
    return f_sf(squares / rank / variance, rank, left)


def family_exceedance(u: float, alike: Floats, rank: Ints | None = None) -> float:
    """Return how probably the largest of a family exceeds by chance what is as rare as |u|.

    ``alike`` (k - 1,): correlations of neighbours; ``rank`` (k,): columns of each member, None: 1.
    Expected upcrossings of the root of chi-squared with r degrees of freedom, whose density f
    times acos(rho) / sqrt(2 pi) each (Rice's formula for a sequence; Davies 1987), and never more
    than of independent ones.
    """
    above, turned = 0.5 * float(erfc(u / np.sqrt(2.0))), np.arccos(np.clip(alike, -1.0, 1.0))
    if rank is None or rank.max(initial=1) == 1:
        crossings = float(turned.sum()) / (2.0 * np.pi) * float(np.exp(-0.5 * u * u))
        return 2.0 * (above + min(crossings, len(alike) * above))
    r = np.maximum(rank[1:], 1).astype(np.float64)
    level = np.sqrt(chi2_isf(max(2.0 * above, NOTHING), r))
    density = np.exp(xlogy(r - 1.0, level) - 0.5 * level**2 - gammaln(0.5 * r))
    crossings = float(turned @ (density / 2.0 ** (0.5 * r - 1.0))) / float(np.sqrt(8.0 * np.pi))
    return 2.0 * (above + min(crossings, len(alike) * above))


class LargestUndetected(NamedTuple):
    """The largest error that may stay unseen, in standard uncertainties of the outputs.

    ``found``: a larger effect is found with the stated power; else none larger was considered.
    ``hidden``: some of it leaves no residual at all.
    """

    error: float
    found: bool
    hidden: bool = False

    @classmethod
    def worst(cls, found_from: Floats, share: Floats, largest: float) -> LargestUndetected:
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


def largest_undetected(
    seen: ObservableEffect,
    std: Floats,
    largest: float,
    *,
    significance: float,
    power: float,
    dof: float = np.inf,
) -> LargestUndetected:
    """Return the worst that columns together do before their test finds them.

    ``std`` (o,) of the outputs, zero: one that does not count; ``largest``: a size that nobody
    would overlook. ``significance``: of this effect's own test. ``dof``: degrees of freedom of the
    adjustment, where the noise was estimated from it.
    """
    share = _share(seen.moved, std)
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
        return LargestUndetected(0.0, found=True)
    worst = int(np.argmax(error))
    found = hidden[worst] <= UNSEEN and shown[worst] <= bound[worst]
    return LargestUndetected(float(error[worst]), bool(found), bool(hidden[worst] > UNSEEN))


def largest_undetected_of_family(
    seen: ObservableFamily,
    std: Floats,
    largest: float,
    *,
    significance: float,
    power: float,
    dof: float = np.inf,
    usual: float = 1.0,
) -> LargestUndetected:
    """Return the worst that one member of a family does before the test of all finds it.

    Arguments as of :func:`largest_undetected`. ``usual``: the worst of this share of the members
    alone.
    """
    k, w = seen.score.shape
    if not k:
        return LargestUndetected(0.0, found=True)
    whole = np.broadcast_to(largest * np.eye(w), (k, w, w))
    if dof - w < 1.0:
        return LargestUndetected(
            float(worst_combined_effect(seen.moved, std, whole)[0].max()), found=False
        )
    chance = 2.0 * normal_sf(family_limit(significance, seen.alike, seen.rank))
    needed = {r: noncentrality(chance, power, r, dof - r) for r in set(seen.rank.tolist()) if r}
    root, silent = seen.roots
    found_from = np.sqrt([needed.get(r, 0.0) for r in seen.rank.tolist()])[:, None, None] * root
    ways, size, _ = np.linalg.svd(silent)
    hidden = largest * ways * (size > UNSEEN * size.max(axis=1, keepdims=True))[:, None]
    shown, more, bound = worst_combined_effect(seen.moved, std, found_from, hidden, whole)
    error = np.minimum(shown + more, bound)
    worst = int(np.argsort(-error, kind="stable")[k - max(int(np.ceil(usual * k)), 1)])
    known = seen.rank[worst] == w and shown[worst] <= bound[worst]
    return LargestUndetected(float(error[worst]), bool(known), bool(seen.rank[worst] < w))


def _everything(share: Floats, largest: float) -> LargestUndetected:
    """Return that an effect stays unseen up to its ``largest`` size: no residual is left.

    ``share`` (k, o): what k columns that are there together do to the outputs.
    """
    return LargestUndetected(
        largest * float(np.linalg.norm(share, axis=0).max(initial=0.0)), found=False
    )


def family_limit(significance: float, alike: Floats, rank: Ints | None = None) -> float:
    """Return what the largest |score| of a family exceeds by chance with ``significance``."""
    return root_between(
        lambda u: family_exceedance(u, alike, rank) - significance, 0.0, 40.0, 1e-12
    )


def _share(moved: Floats, std: Floats) -> Floats:
    """Return moves (k, o') of the outputs that count, in their standard uncertainties."""
    counts = std > 0.0
    return np.asarray(moved[:, counts] / std[counts])
