"""Control charts that people know: Shewhart, CUSUM, EWMA, and Hotelling's T2 of a whole curve.

They are drawn of standard normal deviates: how far each campaign is from what its table was
expected to show, by the stated uncertainties, by the series' own scatter, or by the fitted model.
So their limits follow from the average run length alone: the campaigns until a false alarm.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.special import ndtr, ndtri, stdtr

from rotcal_history.series import DeviationSeries
from rotcal_history.settings import Basis, Chart
from rotcal_history.trend import DRAWS, Trend
from rotcal_ros.adjust.distributions import chi2_isf, normal_isf
from rotcal_ros.adjust.roots import root_between
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.methods.figures import style

FALSE_ALARM: Final = 370.4
"""Campaigns until a false alarm, on average: those of Shewhart's three standard deviations."""
REFERENCE: Final = 0.5
"""k of the CUSUM: half the shift that it finds soonest, in standard deviations."""
SMOOTHING: Final = 0.2
"""Weight of the newest value of the EWMA."""
_EXACT: Final = 2e-12
"""Precision of a limit: no smaller interval is searched for."""
_WORDS: Final[dict[Basis, str]] = {
    "stated": "by the stated uncertainties",
    "own": "by the series' own scatter",
    "model": "by the fitted model",
}
_STEPS: Final = 40
"""Times at which a forecast is drawn."""


def self_scaled_deviates(stated: Floats) -> Floats:
    """Return deviates (m, p) that take their scatter from the series itself (Quesenberry 1991).

    ``stated`` (m, p) are those by the stated uncertainties, whose common size does not matter;
    NaN where there is none.
    """
    squares = np.where(np.isnan(stated), 0.0, stated**2).sum(axis=1)
    counts = np.sum(~np.isnan(stated), axis=1)
    freedom = np.append(0, np.cumsum(counts)[:-1])
    scale = np.sqrt(np.append(0.0, np.cumsum(squares)[:-1]) / np.maximum(freedom, 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = stated / scale[:, None]
        found = ndtri(np.clip(stdtr(freedom[:, None], ratio), 1e-16, 1.0 - 1e-16))
    return np.where(freedom[:, None] > 0, found, np.nan)


def chart_statistic(chart: Chart, deviates: Floats) -> Floats:
    """Return what a chart shows (m, p) of deviates (m, p); (m, 1) of T2. NaN counts as nothing.

    Of a CUSUM it is the larger of both sums, with its sign.
    """
    given: Floats = np.nan_to_num(deviates)
    if chart == "shewhart":
        return given
    if chart == "t2":
        return np.asarray(np.sum(given**2, axis=1, keepdims=True), dtype=np.float64)
    found, up, down = np.zeros_like(given), np.zeros(given.shape[1]), np.zeros(given.shape[1])
    for row, value in enumerate(given):
        if chart == "ewma":
            found[row] = SMOOTHING * value + (1.0 - SMOOTHING) * (found[row - 1] if row else 0.0)
        else:
            up = np.maximum(0.0, up + value - REFERENCE)
            down = np.maximum(0.0, down - value - REFERENCE)
            found[row] = np.where(up >= down, up, -down)
    return found


def control_limit(chart: Chart, count: int, run_length: float = FALSE_ALARM) -> float:
    """Return the limit of |statistic| for ``count`` deviates at once.

    A false alarm of any of them comes once in ``run_length`` campaigns.
    """
    alone = run_length * count
    if chart == "shewhart":
        return float(normal_isf(0.5 / alone))
    if chart == "t2":
        return float(chi2_isf(1.0 / run_length, count))
    length, low, high = _cusum_length, 0.1, 50.0
    if chart == "ewma":
        deviation = float(np.sqrt(SMOOTHING / (2.0 - SMOOTHING)))
        length, low, high = _ewma_length, 0.5 * deviation, 7.0 * deviation
    return root_between(lambda edge: length(edge) - alone, low, high, _EXACT)


def chart_alarms(chart: Chart, deviates: Floats, run_length: float = FALSE_ALARM) -> list[int]:
    """Return the campaigns at which a chart of deviates (m, p) is beyond its limit."""
    beyond = np.abs(chart_statistic(chart, deviates)) > control_limit(
        chart, deviates.shape[1], run_length
    )
    return [int(row) for row in np.flatnonzero(np.any(beyond, axis=1))]


def _cusum_length(edge: float) -> float:
    """Return the average run length of a two-sided CUSUM within +-edge (Siegmund 1985)."""
    b = 2.0 * REFERENCE * (edge + 1.166)
    return float(np.exp(b) - b - 1.0) / (2.0 * REFERENCE**2) / 2.0


def _ewma_length(edge: float) -> float:
    """Return the average run length of an EWMA within +-edge (Brook and Evans 1972)."""
    states = 101
    step = 2.0 * edge / states
    middles = -edge + step * (np.arange(states) + 0.5)
    from_here = middles[None, :] - (1.0 - SMOOTHING) * middles[:, None]
    upper = ndtr((from_here + step / 2.0) / SMOOTHING)
    stay = upper - ndtr((from_here - step / 2.0) / SMOOTHING)
    lengths = np.linalg.solve(np.eye(states) - stay, np.ones(states))
    return float(lengths[states // 2])


@style.house_style
def chart_and_forecast(
    curves: DeviationSeries, trend: Trend, until_ns: int, chart: Chart, basis: Basis
) -> str:
    """Draw the deviation at the angle that moves most with its forecast, above a control chart."""
    unit, label = unit_of(curves.component)
    top, bottom = style.grid(2, 1, height=3.0)
    at = int(np.argmax(np.abs(curves.basis @ trend.change()[0])))
    times = curves.series.times_ns
    measured = curves.curves_of(curves.series.values, curves.rest)[:, at] / unit
    band = COVERAGE_FACTOR * np.sqrt(curves.series.std**2 @ curves.basis[at] ** 2) / unit
    ahead = np.linspace(times[-1], max(until_ns, times[-1] + 1), _STEPS).astype(np.int64)
    dates, later = (each.astype("datetime64[ns]") for each in (times, ahead))
    top.errorbar(dates, measured, band, fmt="o", color=style.BLUE, ms=4, capsize=2)
    drawn = curves.curves_of(trend.forecast(ahead), curves.draw_residuals(DRAWS))[:, :, at] / unit
    low, middle, high = np.quantile(drawn, [0.025, 0.5, 0.975], axis=0)
    top.plot(later, middle, color=style.ORANGE, label="forecast, 95 %")
    top.fill_between(later, low, high, color=style.ORANGE, alpha=0.2, linewidth=0)
    if curves.tolerance:
        for sign in (-1.0, 1.0):
            top.axhline(sign * curves.tolerance / unit, color=style.RED, ls="--", lw=1)
    angle = curves.newest.angles[at] / DEGREE
    top.set_ylabel(f"{curves.component} at {angle:.4g}° / {label}")
    top.legend()
    deviates = trend.surprise if basis == "model" else trend.stated
    if basis == "own":
        deviates = self_scaled_deviates(deviates)
    edge = control_limit(chart, deviates.shape[1])
    bottom.plot(dates, chart_statistic(chart, deviates), "o-", ms=3, lw=0.8)
    for sign in (1.0,) if chart == "t2" else (-1.0, 1.0):
        bottom.axhline(sign * edge, color=style.RED, ls="--", lw=1)
    bottom.set_ylabel(f"{chart}, {_WORDS[basis]}")
    return style.svg(top)
