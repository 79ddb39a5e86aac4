"""Errors of a size that nobody knows: error motion, arrivals, zeros that wander.

Rows of a model say that K x = 0 but for s E z, z ~ N(0, 1), beside the noise of the readings. What
these alone show of K x are *contrasts* y = L K x + e, e ~ N(0, 1), as many as they determine, so
that y ~ N(0, 1 + s^2 L E E' L'). With d the eigenvalues of L E E' L' and u the contrasts along
their axes

    ln p(y | s) = -1/2 sum (ln(1 + s^2 d) + u^2 / (1 + s^2 d)),

free of all other unknowns (the restricted likelihood). Few contrasts say little of s, so their
whole posterior is kept. E may be one of several *ways*, as a motion of each angle by itself or of
few orders; each has a probability beforehand.

The prior of the size is ds / s for scatter above x = s / NOTICED, in which 1 doubles the variance
of a mean contrast, times x^5 / (1 + x^5), which keeps "some" apart from none; and "none at all"
with the weight of ABSENT natural logarithms. It was set by an integral over chi-squared: of 5, 9
and 36 alike contrasts, intervals of what feels scatter as these do hold 93 to 97.4 % for every
size (test/adjust/test_scattering.py).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.special import chdtrc, erfc

from rotcal_ros.adjust.distributions import chi2_sf
from rotcal_ros.adjust.error_motion import Correlated
from rotcal_ros.foundation.arrays import Floats, Ints

if TYPE_CHECKING:
    from rotcal_ros.adjust.fit import Fit

ABSENT: Final = 1.5
"""Prior weight of no scatter, in natural logarithms of its size."""
NOTICED: Final = 1.2
"""Size, of those that double the variance of a mean contrast, from which the prior is ds / s."""
STEEPNESS: Final = 5
"""Power by which the prior vanishes below."""
LEVELS: Final = np.geomspace(0.03, 1e4, 128)
"""Sizes, of those that double the variance of a mean contrast, that are weighed."""
SHOWN: Final = 1e-9
"""Share of what is known of a row that readings add, below which they show nothing of it."""
SEEN: Final = 1e-3
"""Share of the clearest trace in the contrasts from which a way, or an error beside it, counts."""
RULED: Final = 1e-3
"""Share of the largest eigenvalue from which an axis counts in the mean."""
MOST: Final = 1500
"""Rows of which the axes are worked out; of more each counts as one by itself."""
LIKELY: Final = 1e-7
"""Weight of a size below which it changes no interval."""
CLIPPED: Final = 0.9
"""Quantile of the size beyond which one counts in an interval only, not in the mean."""
FLOOR: Final = 0.05
"""Least size that rows are weighed by, of those that double the variance of a mean contrast."""
INSIDE: Final = 1.959964
OUTSIDE: Final = 0.05


@dataclass(frozen=True, eq=False)
class PosteriorSizes:
    """What is believed of a scatter: ``size`` (k,) and ``way`` (k,) with their ``weight`` (k,).

    ``contrasts``: how many show it; ``noticed``: the size that doubles the variance of a mean one.
    ``probability``: how probably chance makes them so large with the stated size, where there is.
    """

    size: Floats
    way: Ints
    weight: Floats
    contrasts: int
    noticed: float
    probability: float = 1.0

    @property
    def median_size(self) -> float:
        """The size that rows are best weighed by: the median, which is never nothing."""
        return max(self.quantile(0.5), FLOOR * self.noticed)

    @property
    def squares(self) -> Floats:
        """Squared sizes (k,) times weights; those beyond CLIPPED count in an interval only."""
        return np.asarray(np.minimum(self.size, self.quantile(CLIPPED)) ** 2 * self.weight)

    def quantile(self, share: float) -> float:
        """Return the size that is not exceeded with the probability ``share``."""
        order = np.argsort(self.size)
        return float(self.size[order][np.searchsorted(self.weight[order].cumsum(), share)])


@dataclass(frozen=True, eq=False)
class Scattering(Correlated):
    """How what some ``rows`` (k,) of a model say scatters: by a size that may be unknown.

    ``parts`` holds one tuple: the ways, roots (k, r) of the covariance per unit of size; none:
    each row by itself. ``likely`` (w,): their probabilities beforehand. ``stated``: the size, in
    the unit of the rows; None: it is estimated. ``asked``: whether readings are there to say.
    ``influence``: how many times as much outputs feel it as a mean contrast does: the prior is
    that of sizes which matter to these.
    """

    what: str
    likely: Floats
    stated: float | None
    significance: float = 0.01
    asked: bool = True
    influence: float = 1.0

    def below(self, count: int) -> Scattering:
        """Return the same below ``count`` further rows."""
        return replace(self, rows=self.rows + count)

    def divided(self, std: Floats) -> Scattering:
        """Return the same of rows that were divided by their standard deviations ``std`` (n,)."""
        stated = None if self.stated is None else self.stated / float(std[self.rows[0]])
        return replace(self, stated=stated)

    def planned(self) -> Scattering:
        """Return the same where nothing is read yet: it is as large as rows are weighed."""
        return replace(self, asked=False)

    @property
    def ways(self) -> int:
        """The number of ways."""
        return max(len(self.parts[0]), 1)

    def root(self, way: int, influence: Floats) -> Floats:
        """Return ``influence`` (o, k), what errors of the rows do, times the root of a way."""
        return np.asarray(influence @ self.parts[0][way]) if self.parts[0] else influence

    def sizes(self, fit: Fit) -> PosteriorSizes:
        """Return what a ``fit`` says of the size."""
        std = float(fit.std[self.rows[0]])
        if not self.asked:
            way = np.arange(self.ways)
            return PosteriorSizes(np.full(len(way), std), way, self.likely, 0, std)
        (value, *_), root, known = _contrasts(fit, self.rows, std)
        if root is None or not self.parts[0]:
            return self._said_by(value, [(known, value)], std)
        return self._said_by(value, [_along(root @ way, value) for way in self.parts[0]], std)

    def beside(self, fit: Fit, errors: Floats) -> tuple[float, PosteriorSizes]:
        """Return how probably scatter passes for whitened ``errors`` (n, k) as much as it does.

        And what contrasts that these do not touch say of its size.
        """
        std = float(fit.std[self.rows[0]])
        (value, *moved), root, known = _contrasts(fit, self.rows, std, errors)
        if root is None:
            return 1.0, fit.sizes[self]
        spread = [root @ way for way in self.parts[0]] or [np.diag(np.sqrt(known))]
        _, size, axes = np.linalg.svd(np.array(moved))
        rank = int((size > SEEN * size.max(initial=0.0)).sum())
        own, others = axes[:rank], axes[rank:]
        along = [_along(others @ each, others @ value) for each in spread]
        sizes, chance = self._said_by(others @ value, along, std), 0.0
        for way, each in enumerate(spread):
            mine, (d, u) = sizes.way == way, _along(own @ each, own @ value)
            left = float(((own @ value) ** 2).sum() - u @ u)
            squares = left + (u**2 / (1.0 + sizes.size[mine, None] ** 2 * d)).sum(axis=1)
            chance += float(chdtrc(rank, squares) @ sizes.weight[mine])
        return chance, sizes

    def squares_of(
        self, fit: Fit, white: Floats, score: Floats, information: Floats
    ) -> tuple[Floats, Floats]:
        """Return by what chi-squared falls (m,) for ``white`` errors (n, b), by each size.

        Of those that contrasts beside them make likely, with their weights (m,). ``score`` (b,)
        and ``information`` (b, b) are of rows that scatter each by itself, by the size that they
        are weighed by: their contrasts count by the variances of these instead.
        """
        std, sizes = float(fit.std[self.rows[0]]), self.beside(fit, white)[1]
        found, root, known = _contrasts(fit, self.rows, std, white)
        value, moved = found[0], found[1:]
        now = moved / (1.0 + std**2 * known)
        score, information = score - now @ value, information - now @ moved.T
        every, ways = np.zeros(len(sizes.size)), self.parts[0] if root is not None else ()
        for way in np.unique(sizes.way).tolist():
            d, axes = known, found.T
            if root is not None and ways:
                d, axes = _along(root @ ways[way], found.T)
            of = sizes.way == way
            less = 1.0 / (1.0 + sizes.size[of, None] ** 2 * d) - 1.0
            u = score + moved @ value + (less * axes[:, 0]) @ axes[:, 1:]
            square = information + moved @ moved.T
            square = square + (axes[:, 1:].T * less[:, None]) @ axes[:, 1:]
            inverse = np.linalg.pinv(square, hermitian=True)
            every[of] = (u[:, None] @ inverse @ u[:, :, None])[:, 0, 0]
        return every, sizes.weight

    def _said_by(
        self, value: Floats, each: list[tuple[Floats, Floats]], std: float
    ) -> PosteriorSizes:
        """Return what contrasts (q,) say: ``each`` way's eigenvalues, and these along its axes."""
        noticed = [_noticed(values) for values, _ in each]
        count = max(int((values > RULED * values.max(initial=0.0)).sum()) for values, _ in each)
        if not np.isfinite(min(noticed)):  # nothing shows it: as stated, or none
            way = np.arange(self.ways)
            size = np.full(len(way), self.stated or 0.0)
            return PosteriorSizes(size, way, self.likely, 0, std)
        least = float(min(noticed))
        if self.stated is not None:
            found = self._of_stated(value, each, least)
            if found.probability >= self.significance:
                return replace(found, contrasts=count)
            estimated = self._estimated(value, each, noticed)
            return replace(estimated, contrasts=count, probability=found.probability)
        return replace(self._estimated(value, each, noticed), contrasts=count)

    def _of_stated(
        self, value: Floats, each: list[tuple[Floats, Floats]], noticed: float
    ) -> PosteriorSizes:
        """Return the ways that a stated size leaves possible, and how probable that is."""
        assert self.stated is not None
        size = np.array([self.stated])
        logs = np.array([_log_likelihood(size, d, u)[0] for d, u in each])
        weight = self.likely * np.exp(logs - logs.max())
        weight /= weight.sum()
        rest = [float(value @ value - u @ u) for _, u in each]
        chance = [
            chi2_sf(other + float((u**2 / (1.0 + self.stated**2 * d)).sum()), len(value))
            for (d, u), other in zip(each, rest, strict=True)
        ]
        return PosteriorSizes(
            np.full(self.ways, self.stated), np.arange(self.ways), weight, len(value), noticed,
            float(weight @ chance),
        )  # fmt: skip

    def _estimated(
        self, value: Floats, each: list[tuple[Floats, Floats]], noticed: list[float]
    ) -> PosteriorSizes:
        """Return the posterior of size and way."""
        size, way, logs = (
            [np.zeros(1)],
            [np.zeros(1, dtype=np.int64)],
            [np.log([ABSENT / self.influence])],
        )
        x = LEVELS * self.influence / NOTICED
        prior = np.log(x**STEEPNESS / (1.0 + x**STEEPNESS) * np.gradient(np.log(LEVELS)))
        for k, ((d, u), unit) in enumerate(zip(each, noticed, strict=True)):
            if unit <= min(noticed) / np.sqrt(SEEN):
                size.append(LEVELS * unit)
                way.append(np.full(len(LEVELS), k))
                likely = np.log(self.likely[k]) + prior
                logs.append(_log_likelihood(size[-1], d, u) + likely)
        weight = np.exp(np.concatenate(logs) - max(each.max() for each in logs))
        kept = weight > LIKELY * weight.sum()
        weight = weight[kept] / weight[kept].sum()
        every, which = np.concatenate(size)[kept], np.concatenate(way)[kept]
        return PosteriorSizes(every, which, weight, len(value), float(min(noticed)))

    def spread_of(self, fit: Fit, influence: Floats) -> Floats:
        """Return what independent errors of the rows would have to do (o, k) in their place.

        ``influence`` (o, k): what errors of each row's standard deviation do. By the mean of what
        is believed, but for sizes beyond CLIPPED: :func:`enlargement_factors` makes up for these.
        """
        sizes, unit = fit.sizes[self], influence / fit.std[self.rows[0]]
        if not self.parts[0]:
            return np.asarray(unit * np.sqrt(sizes.squares.sum()))
        mean = np.zeros(2 * [len(self.rows)])
        for way, root in enumerate(self.parts[0]):
            mean += sizes.squares[sizes.way == way].sum() * (root @ root.T)
        values, axes = np.linalg.eigh(mean)
        return np.asarray(unit @ (axes * np.sqrt(np.maximum(values, 0.0))) @ axes.T)

    def variances(self, sizes: PosteriorSizes, influence: Floats, std: float) -> Floats:
        """Return the variances (o, k) of outputs by each of the sizes; ``influence`` as above."""
        each = np.stack(
            [(self.root(way, influence / std) ** 2).sum(axis=1) for way in range(self.ways)]
        )
        return np.asarray(each[sizes.way].T * sizes.size**2)


def _contrasts(
    fit: Fit, rows: Ints, std: float, errors: Floats | None = None
) -> tuple[Floats, Floats | None, Floats]:
    """Return contrasts y (1 + b, q), L (q, k), None: diagonal, and the diagonal d (q,) of LL'.

    Of rows that are weighed by ``std``: that takes part in what is known of K x, and is taken off.
    What was read first, then what whitened ``errors`` (n, b) do.
    """
    value = -fit.residual[rows, None]
    if errors is not None:
        value = np.hstack([value, -std * fit.residuals_of(errors)[rows]])
    if len(rows) > MOST:
        taken, axes = fit.kernel.leverage[rows], None
    else:
        taken, axes = np.linalg.eigh(fit.kernel.hat_block(rows))
        value = axes.T @ value
    shown = (1.0 - taken > SHOWN) & (taken > SHOWN)
    taken, value = taken[shown], value[shown]
    known = (1.0 / taken - 1.0) / std**2
    value = value.T / (taken * std**2 * np.sqrt(known))
    return value, None if axes is None else np.sqrt(known)[:, None] * axes[:, shown].T, known


def _along(root: Floats, value: Floats) -> tuple[Floats, Floats]:
    """Return eigenvalues d of LEE'L' and contrasts u along their axes; ``root``: LE (q, r)."""
    axes, size, _ = np.linalg.svd(root, full_matrices=False)
    return size**2, axes.T @ value


def _noticed(values: Floats) -> float:
    """Return the size that doubles the variance of a mean contrast; infinite: none shows any."""
    most = float(values.max(initial=0.0))
    return float(1.0 / np.sqrt(values[values > RULED * most].mean())) if most else np.inf


def _log_likelihood(size: Floats, values: Floats, along: Floats) -> Floats:
    """Return ln p (k,) of ``size`` (k,), beyond that of none."""
    grown = 1.0 + size[:, None] ** 2 * values
    return np.asarray(-0.5 * (np.log(grown) + along**2 / grown - along**2).sum(axis=1))


def enlargement_factors(fixed: Floats, used: Floats, variances: Floats, weight: Floats) -> Floats:
    """Return factors (o,) on standard deviations, of which 1.96 then hold 95 %.

    ``fixed`` (o,): variances without scatter, ``used`` (o,) those in use; ``variances`` (o, k):
    what scatter adds, with ``weight`` (k,).
    """
    safe = np.where(used > 0.0, used, 1.0)
    spread = np.maximum((fixed[:, None] + variances) / safe[:, None], 1e-12)
    factor = np.ones(len(used))
    for _ in range(30):  # Newton's method, with short steps so that no factor turns negative
        reach = INSIDE * factor[:, None] / np.sqrt(2.0 * spread)
        outside = erfc(reach) @ weight - OUTSIDE
        slope = (np.exp(-(reach**2)) * reach) @ weight * (-2.0 / np.sqrt(np.pi)) / factor
        step = np.clip(outside / np.minimum(slope, -1e-12), -0.3 * factor, 0.3 * factor)
        factor = factor - step
        if np.abs(step).max(initial=0.0) < 1e-6:
            break
    return np.where(used > 0.0, factor, 1.0)


def join_scatters(every: list[tuple[Floats, Floats]], rng: Any) -> tuple[Floats, Floats]:
    """Return the variances (o, k) and weights (k,) of what several scatters add together."""
    if len(every) == 1:
        return every[0]
    count = 1000
    total = sum(
        variances[:, rng.choice(len(weight), count, p=weight)] for variances, weight in every
    )
    return np.asarray(total), np.full(count, 1.0 / count)
