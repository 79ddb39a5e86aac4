"""What a series of deviation curves says of the table: its drift, its jumps, its future.

Each curve is split into modes, the harmonics of a circle or the cosines of an arc. Of a mode its
coefficients are a Gaussian process

    y = level + drift t + random walk + wear + season + temperature + error of measurement

with a level that nothing is known of and that every step (an event, another table in force) makes
unknown again. Wear is a drift that walks itself, as of a bearing that goes bad. Errors of
campaigns with the same artefacts are correlated. The sizes of drift, random walk, wear, season,
and of what the stated uncertainty lacks, are integrated over a grid, so that what the few curves
of a table leave open widens its forecast: generalised least squares whose weights are themselves
uncertain (Rasmussen and Williams 2006, 2.2 and 5.2).

The Cholesky factor of the covariance in order of time has those of all earlier times inside. So
its standardised residuals are those of forecasts one step ahead, and the evidence of all earlier
series costs nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final, TypeAlias

import numpy as np
from scipy.special import logsumexp, ndtr, ndtri

from rotcal_ros.foundation.arrays import Floats, Ints

YEAR_NS: Final = 365.25 * 86_400e9
SIZES: Final = (0.0, 0.4, 2.0, 10.0)
"""Drifts per year, and random walks after a year, in standard uncertainties of a coefficient."""
WEARS: Final = (0.0, 3.0)
"""Changes of the drift after a year, in the same per year."""
SEASONS: Final = (0.0, 3.0)
"""Amplitudes of a season, in the same."""
SCALES: Final = (1.0, 2.0, 6.0)
"""Errors of measurement, in what is stated."""
ABSENT: Final = (0.4, 0.85, 0.95, 0.9)
"""Probability, before anything is measured, that a mode has no drift, walk, wear, season."""
_AS_STATED: Final = 0.9
"""The same that the uncertainties are stated rightly."""
_SCALE_PRIORS: Final = np.log([_AS_STATED, *[(1.0 - _AS_STATED) / 2.0] * 2])
_LIKELY: Final = 1e-3
"""Processes with less weight are left out of forecasts."""
WIDE: Final = 1e4
"""Standard deviation of a level, before anything is measured, in standard uncertainties."""
KELVIN: Final = 10.0
"""The same of the change by 1 K: as much as the largest drift in a year."""
DRAWS: Final = 4000
"""Curves that are drawn for a probability: one of 0.95 is then known to 0.003."""
_SEASON_FROM: Final = 6
"""Fewest campaigns of a series in which a season is searched for; it must span a year, too."""
_LEAST_KELVIN: Final = 1.0


@dataclass(frozen=True, eq=False)
class CampaignSeries:
    """Coefficients of one deviation in m campaigns, in order of time, rad or m.

    ``times_ns`` (m,), ``values`` (m, p) with standard uncertainties ``std`` (m, p). ``orders``
    (p,) numbers the mode of each coefficient. ``steps`` (m,) counts the steps before a campaign.
    ``common`` (m, m) is the share of the variance that two campaigns have in common, 1 on its
    diagonal. ``temperature_c`` (m,) or None.
    """

    times_ns: Ints
    values: Floats
    std: Floats
    orders: Ints
    steps: Ints
    common: Floats
    temperature_c: Floats | None = None

    @property
    def years(self) -> Floats:
        """Times (m,) in years since the first campaign."""
        return self.years_of(self.times_ns)

    def years_of(self, times_ns: Ints) -> Floats:
        """Return other times in years since the first campaign."""
        return np.asarray((times_ns - self.times_ns[0]) / YEAR_NS, dtype=np.float64)

    @property
    def kelvin(self) -> Floats | None:
        """Temperatures (m,) less their mean; None where they show nothing."""
        if self.temperature_c is None or np.ptp(self.temperature_c) < _LEAST_KELVIN:
            return None
        return np.asarray(self.temperature_c - np.mean(self.temperature_c), dtype=np.float64)


_Beside: TypeAlias = Callable[[Floats], tuple[Floats, Floats]]
"""Sizes -> covariances (n, m) of what is asked for with the values, and (n, n) of its own."""


@dataclass(frozen=True, eq=False)
class TrendMode:
    """The k likely Gaussian processes of one mode, in its ``unit``.

    ``sizes`` (k, 4) of drift, random walk, wear and season, ``weights`` (k,), Cholesky ``factors``
    (k, m, m) of the covariances, ``white`` (k, m, c) whitened values of its c coefficients.
    """

    unit: float
    sizes: Floats
    weights: Floats
    factors: Floats
    white: Floats

    def posterior(self, beside: _Beside) -> tuple[Floats, Floats]:
        """Return means (k, n, c) and covariances (k, n, n) of what ``beside`` describes."""
        cross, own = zip(*(beside(sizes) for sizes in self.sizes), strict=True)
        solved = np.linalg.solve(self.factors, np.swapaxes(np.stack(cross), -1, -2))
        turned = np.swapaxes(solved, -1, -2)
        return turned @ self.white, np.stack(own) - turned @ solved

    def mixed(self, means: Floats, variances: Floats) -> tuple[Floats, Floats]:
        """Return mean and standard deviation (c,) of means and variances (k, c), in SI."""
        middle = self.weights @ means
        square = self.weights @ (variances + (means - middle) ** 2)
        return self.unit * middle, self.unit * np.sqrt(np.maximum(square, 0.0))


@dataclass(frozen=True, eq=False)
class Trend:
    """A fitted series: a mixture of Gaussian processes for each of its modes.

    ``surprise`` (m, p) is how far each value is from its forecast by the earlier ones, as standard
    normal deviates; NaN where nothing could be forecast. ``stated`` (m, p): the same for a table
    that does not move, with the stated uncertainties.
    """

    series: CampaignSeries
    modes: tuple[TrendMode, ...]
    surprise: Floats
    stated: Floats

    def forecast(self, times_ns: Ints, draws: int = DRAWS, seed: int = 95) -> Floats:
        """Return drawn coefficients (draws, n, p) at n times, at the mean temperature.

        Each draw is of the same standard normal deviates at all times: curves over time are
        smooth, and equal input gives equal output.
        """
        rng = np.random.default_rng(seed)
        at = self.series.years_of(times_ns)
        drawn = np.empty((draws, len(at), len(self.series.orders)))
        for number, mode in enumerate(self.modes, 1):
            columns = self.series.orders == number
            mean, covariance = mode.posterior(self._beside(at))
            std = np.sqrt(np.maximum(np.diagonal(covariance, axis1=-2, axis2=-1), 0.0))
            picked = rng.choice(len(mode.weights), draws, p=mode.weights)
            deviates = rng.standard_normal((draws, 1, int(columns.sum())))
            drawn[:, :, columns] = mode.unit * (mean[picked] + std[picked, :, None] * deviates)
        return drawn

    def change(self) -> tuple[Floats, Floats, float]:
        """Return the change (p,) since the last step, its standard uncertainty, and the years."""
        first = int(np.searchsorted(self.series.steps, self.series.steps[-1]))
        years = self.series.years
        moved, std = self._moments(self._beside(years[[first, -1]]), np.array([-1.0, 1.0]))
        return moved, std, float(years[-1] - years[first])

    def expected(self, campaign: int) -> tuple[Floats, Floats]:
        """Return what the earlier campaigns forecast (p,) for one, and its standard uncertainty.

        With its error of measurement, by the sizes that all campaigns make likely.
        """
        found = np.empty((2, len(self.series.orders)))
        for number, mode in enumerate(self.modes, 1):
            columns = np.flatnonzero(self.series.orders == number)
            std = mode.factors[:, campaign, campaign, None]
            mean = (
                self.series.values[campaign, columns] / mode.unit - std * mode.white[:, campaign]
            )
            found[:, columns] = mode.mixed(mean, std**2)
        return found[0], found[1]

    def per_kelvin(self) -> tuple[Floats, Floats] | None:
        """Return the temperature coefficients (p,) and their standard uncertainties; None: none.

        Per kelvin, in the unit of the series.
        """
        kelvin = self.series.kelvin
        if kelvin is None:
            return None
        known = KELVIN**2 * kelvin[None, :], np.array([[KELVIN**2]])
        return self._moments(lambda _sizes: known, np.ones(1))

    def _beside(self, at: Floats) -> _Beside:
        """Return the covariances of the table at times (n,) years with the campaigns' values."""
        years, steps = self.series.years, self.series.steps

        def beside(sizes: Floats) -> tuple[Floats, Floats]:
            level = WIDE**2 * (steps == steps[-1])[None, :] * np.ones((len(at), 1))
            return level + _moving(at, years, sizes), WIDE**2 + _moving(at, at, sizes)

        return beside

    def _moments(self, beside: _Beside, share: Floats) -> tuple[Floats, Floats]:
        """Return mean and standard deviation (p,) of ``share`` times what is asked for."""
        found = np.empty((2, len(self.series.orders)))
        for number, mode in enumerate(self.modes, 1):
            mean, covariance = mode.posterior(beside)
            means = np.einsum("n,knc->kc", share, mean)
            variances = np.einsum("n,knl,l->k", share, covariance, share)[:, None]
            found[:, self.series.orders == number] = mode.mixed(means, variances)
        return found[0], found[1]


def fit_trend(series: CampaignSeries) -> Trend:
    """Fit the model to a series of two campaigns or more; its uncertainties are above zero."""
    sizes, priors = _grid(series)
    count = int(series.orders.max())
    moving = np.stack([_moving(series.years, series.years, each) for each in sizes])
    rows = [_fit_mode(series, moving, number) for number in range(1, count + 1)]
    # (s, g, m): the evidence of the first campaigns, however many of them.
    evidence = [np.cumsum(_densities(f, w), axis=-1) + priors[:, None] for _, f, w in rows]
    together = _SCALE_PRIORS[:, None] + sum(logsumexp(found, axis=1) for found in evidence)
    by_scale = np.exp(together - logsumexp(together, axis=0))
    surprise, stated = (np.full(series.values.shape, np.nan) for _ in range(2))
    known = np.append(False, np.diff(series.steps) == 0)
    modes = []
    for number, (found, (unit, factors, white)) in enumerate(zip(evidence, rows, strict=True), 1):
        weights = np.exp(found - logsumexp(found, axis=1, keepdims=True)) * by_scale[:, None]
        columns = series.orders == number
        below = np.einsum("sgm,sgmc->mc", weights[:, :, :-1], ndtr(white[:, :, 1:]))
        deviates = np.vstack([below[:1], ndtri(np.clip(below, 1e-16, 1.0 - 1e-16))])
        surprise[:, columns] = np.where(known[:, None], deviates, np.nan)
        stated[:, columns] = np.where(known[:, None], white[0, 0], np.nan)
        likely = np.nonzero(weights[:, :, -1] > _LIKELY)
        chosen = weights[:, :, -1][likely]
        modes.append(
            TrendMode(
                unit, sizes[likely[1]], chosen / chosen.sum(), factors[likely], white[likely]
            )
        )
    return Trend(series, tuple(modes), surprise, stated)


def _grid(series: CampaignSeries) -> tuple[Floats, Floats]:
    """Return sizes (g, 4), of drift, random walk, wear, season, and logarithms of their priors."""
    long = len(series.values) >= _SEASON_FROM and series.years[-1] >= 1.0
    causes = (SIZES, SIZES, WEARS, SEASONS if long else SEASONS[:1])
    sizes = np.array(list(product(*causes)))  # the first does not move
    shares = product(*(_priors(each, absent) for each, absent in zip(causes, ABSENT, strict=True)))
    priors = np.array([np.prod(each) for each in shares])
    return sizes, np.log(priors)


def _priors(sizes: Sequence[float], absent: float) -> list[float]:
    """Return the probabilities of the sizes of one cause, of which the first is zero."""
    others = len(sizes) - 1
    return [absent, *[(1.0 - absent) / others] * others] if others else [1.0]


def _moving(a: Floats, b: Floats, sizes: Floats) -> Floats:
    """Return the covariance (n, m) of the moving table at times (n,) and (m,) years."""
    drift, walk, wear, season = sizes
    a = a[:, None]
    less = np.minimum(a, b)
    worn = less**2 * (3.0 * np.maximum(a, b) - less) / 6.0  # a random walk, integrated
    moved = drift**2 * a * b + walk**2 * less + wear**2 * worn
    return np.asarray(moved + season**2 * np.cos(2.0 * np.pi * (a - b)), dtype=np.float64)


def _fit_mode(series: CampaignSeries, moving: Floats, mode: int) -> tuple[float, Floats, Floats]:
    """Return the unit, the Cholesky factors and the whitened values of one mode.

    ``moving`` (g, m, m) are the covariances of a table that moves by each of the sizes.
    """
    columns = series.orders == mode
    std = np.sqrt(np.mean(series.std[:, columns] ** 2, axis=1))
    unit = float(np.median(std))
    noise = series.common * np.outer(std, std) / unit**2
    level = WIDE**2 * (series.steps[:, None] == series.steps)
    if (kelvin := series.kelvin) is not None:
        level = level + KELVIN**2 * np.outer(kelvin, kelvin)
    scaled = np.square(SCALES)[:, None, None, None] * noise
    # The values stand below the covariance: their rows of its factor are the whitened values.
    values = series.values[:, columns] / unit
    m, c = values.shape
    whole = np.zeros((len(SCALES), len(moving), m + c, m + c))
    whole[:, :, :m, :m] = scaled + level + moving
    whole[:, :, m:, :m] = values.T
    whole[:, :, range(m, m + c), range(m, m + c)] = 1e30
    factors = np.linalg.cholesky(whole)
    return unit, factors[:, :, :m, :m], np.swapaxes(factors[:, :, m:, :m], -1, -2)


def _densities(factors: Floats, white: Floats) -> Floats:
    """Return the logarithms (s, g, m) of the densities of each campaign after the earlier ones."""
    spread = np.log(np.diagonal(factors, axis1=-2, axis2=-1))
    count = white.shape[-1]
    return np.asarray(-0.5 * np.sum(white**2, axis=-1) - count * spread, dtype=np.float64)
