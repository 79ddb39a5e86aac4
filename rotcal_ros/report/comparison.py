"""The page of a comparison: all curves with their bands, E_n by angle, and the verdicts."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes

from rotcal_ros.evaluation.compare import Comparison
from rotcal_ros.foundation.components import COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.curves.measured import MeasuredCurve
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.units import DEGREE
from rotcal_ros.methods.figures import style
from rotcal_ros.report.template import render

Pairs = Mapping[tuple[str, str], Comparison]


@style.house_style
def curves_and_errors(
    curves: Mapping[str, MeasuredCurve], comparisons: Pairs, component: str
) -> str:
    """Draw the curves, aligned to the first one, above the normalised errors of every pair."""
    unit, name = unit_of(component)
    top, bottom = style.grid(2, 1, height=3.2, sharex=True)
    first = next(iter(curves))
    for (label, curve), colour in zip(curves.items(), cycle(style.COLOURS), strict=False):
        offset = 0.0 if label == first else comparisons[first, label].offset
        value = (curve.deviation + offset) / unit
        band = COVERAGE_FACTOR * np.sqrt(np.diag(curve.covariance)) / unit
        style.curve_with_band(top, curve.angles / DEGREE, value, band, label, colour)
    top.set_ylabel(f"{component} / {name}")
    _errors(bottom, comparisons)
    return style.svg(top)


def _errors(ax: Axes, comparisons: Pairs) -> None:
    """Draw E_n by angle; hollow where a curve was interpolated."""
    largest = max(comparison.largest for comparison in comparisons.values())
    ax.axhspan(-1.0, 1.0, color=style.GREEN, alpha=0.10, linewidth=0)
    # The colours of the curves are not used again: a pair is not a curve.
    colours = cycle(style.COLOURS[::-1])
    for ((a, b), comparison), colour in zip(comparisons.items(), colours, strict=False):
        angles, measured = comparison.angles / DEGREE, ~comparison.interpolated
        values = comparison.normalised_error
        ax.plot(angles[measured], values[measured], "o", color=colour, ms=4, label=f"{a} − {b}")
        ax.plot(angles[~measured], values[~measured], "o", color=colour, ms=4, mfc="none")
    ax.set_ylim(-max(1.3, 1.1 * largest), max(1.3, 1.1 * largest))
    ax.set_ylabel("Eₙ = difference / U (k = 2)")
    style.angle_axis(ax, next(iter(comparisons.values())).angles / DEGREE)


def comparison_page(
    curves: Mapping[str, MeasuredCurve], comparisons: Pairs, component: str
) -> str:
    """Return the comparison as one self-contained HTML page."""
    unit, name = unit_of(component)
    pairs = [
        {
            "names": f"{a} − {b}",
            "words": phrase(comparison.describe(unit, name)),
            "notes": [phrase(note) for note in comparison.notes],
            "rows": [
                (*cells, phrase("interpolated") if between else "")
                for cells, between in zip(
                    comparison.rows(unit), comparison.interpolated, strict=True
                )
            ],
        }
        for (a, b), comparison in comparisons.items()
    ]
    return render(
        "comparison",
        title=phrase("Comparison of {0}", component),
        agree=all(comparison.agree for comparison in comparisons.values()),
        figure=curves_and_errors(curves, comparisons, component),
        pairs=pairs,
        unit=name,
    )
