"""Figures of a series: its control chart, and the forecast at the angle that moves most."""

from __future__ import annotations

from typing import Any, Final, Literal

import numpy as np

from rotcal_ros.extensions.history.charts import Chart, limit, own_scatter, statistic
from rotcal_ros.extensions.history.series import DeviationSeries
from rotcal_ros.extensions.history.trend import DRAWS, Trend
from rotcal_ros.foundation.arrays import Floats, Ints
from rotcal_ros.foundation.components import COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.methods.figures import style

Basis = Literal["stated", "own", "model"]
_WORDS: Final = {
    "stated": "by the stated uncertainties",
    "own": "by the series' own scatter",
    "model": "by the fitted model",
}
_STEPS: Final = 40


def deviates(trend: Trend, basis: Basis) -> Floats:
    """Return the standard normal deviates (m, p) that a chart is drawn of."""
    if basis == "model":
        return trend.surprise
    return trend.stated if basis == "stated" else own_scatter(trend.stated)


@style.styled
def chart_and_forecast(
    curves: DeviationSeries,
    trend: Trend,
    until_ns: int,
    chart: Chart,
    basis: Basis,
    tolerance: float,
) -> str:
    """Draw the deviation at the angle that moves most with its forecast, above a control chart."""
    unit, label = unit_of(curves.component)
    top, bottom = style.grid(2, 1, height=3.0)
    moved = curves.curves_of(trend.change()[0], np.zeros(1))
    at = int(np.argmax(np.abs(moved)))
    times = curves.series.times_ns
    measured = curves.curves_of(curves.series.values, curves.rest)[:, at] / unit
    basis_at = curves.basis[at] - (0.0 if curves.zero is None else curves.basis[curves.zero])
    band = COVERAGE_FACTOR * np.sqrt(curves.series.std**2 @ basis_at**2) / unit
    top.errorbar(_dates(times), measured, band, fmt="o", color=style.BLUE, ms=4, capsize=2)
    ahead = np.linspace(times[-1], max(until_ns, times[-1] + 1), _STEPS).astype(np.int64)
    drawn = curves.curves_of(trend.forecast(ahead), curves.drawn_rest(DRAWS))[:, :, at] / unit
    low, middle, high = np.quantile(drawn, [0.025, 0.5, 0.975], axis=0)
    top.plot(_dates(ahead), middle, color=style.ORANGE, label="forecast, 95 %")
    top.fill_between(_dates(ahead), low, high, color=style.ORANGE, alpha=0.2, linewidth=0)
    if tolerance:
        for sign in (-1.0, 1.0):
            top.axhline(sign * tolerance / unit, color=style.RED, ls="--", lw=1)
    angle = curves.newest.angles[at] / DEGREE
    top.set_ylabel(f"{curves.component} at {angle:.4g}° / {label}")
    top.legend()
    shown = statistic(chart, deviates(trend, basis))
    edge = limit(chart, deviates(trend, basis).shape[1])
    bottom.plot(_dates(times), shown, "o-", ms=3, lw=0.8)
    for sign in (1.0,) if chart == "t2" else (-1.0, 1.0):
        bottom.axhline(sign * edge, color=style.RED, ls="--", lw=1)
    bottom.set_ylabel(f"{chart}, {_WORDS[basis]}")
    return style.svg(top)


def _dates(times_ns: Ints) -> Any:
    return times_ns.astype("datetime64[ns]")
