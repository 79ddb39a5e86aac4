"""ISO 230-2 in pictures and numbers: the diagrams of the standard and its table of figures."""

from __future__ import annotations

import numpy as np
from markupsafe import escape
from matplotlib.axes import Axes

from rotcal_ros.evaluation.iso230 import ONLY_SCATTER, BidirectionalRuns, Iso230, iso230, runs_of
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.language import SPOKEN, phrase
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.methods.figures import style
from rotcal_ros.report.template import render

UP, DOWN = style.BLUE, style.ORANGE


@style.house_style
def draw_runs(runs: BidirectionalRuns, figures: Iso230) -> str:
    """Draw every run, the means with +- 2 s of both directions with A, and B_i and R_i."""
    every, accuracy, spread = style.grid(3, 1, height=2.9, sharex=True)
    angles = figures.targets / DEGREE
    for values, colour, label in ((runs.forward, UP, "up ↑"), (runs.reverse, DOWN, "down ↓")):
        lines = every.plot(angles, values / ARCSEC, "-", color=colour, alpha=0.6, lw=0.9)
        lines[0].set_label(phrase("{0} runs {1}", values.shape[1], phrase(label)))
    every.set_ylabel("deviation / arcsec")
    _accuracy(accuracy, angles, figures)
    _spread(spread, angles, figures)
    style.angle_axis(spread, angles, "target angle / °")
    return style.svg(every)


def _accuracy(ax: Axes, angles: Floats, figures: Iso230) -> None:
    """Draw the means with +- 2 s; A lies between the dashed lines, M is the range of the mean."""
    ends = []
    for mean, s, colour, label in (
        (figures.mean_forward, figures.s_forward, UP, "mean ↑ ± 2 s"),
        (figures.mean_reverse, figures.s_reverse, DOWN, "mean ↓ ± 2 s"),
    ):
        style.curve_with_band(ax, angles, mean / ARCSEC, 2.0 * s / ARCSEC, label, colour)
        ends += [mean - 2.0 * s, mean + 2.0 * s]
    ax.plot(angles, figures.mean / ARCSEC, ":", color=style.INK, lw=1.2, label="mean of both")
    low, high = np.min(ends) / ARCSEC, np.max(ends) / ARCSEC
    for y in (low, high):
        ax.axhline(y, color=style.GREY, lw=0.9, ls="--")
    ax.annotate(
        f"A = {figures.accuracy / ARCSEC:.3g} arcsec", (angles[-1], high), xytext=(0, 3),
        textcoords="offset points", ha="right", color=style.INK,
    )  # fmt: skip
    ax.set_ylabel("deviation / arcsec")


def _spread(ax: Axes, angles: Floats, figures: Iso230) -> None:
    """Draw reversal and bidirectional repeatability of every target as bars."""
    width = 0.35 * float(np.min(np.diff(angles)))
    for shift, values, colour, label in (
        (-0.5, figures.reversal_i, style.GREEN, "reversal Bᵢ"),
        (0.5, figures.repeatability_i, style.GREY, "repeatability Rᵢ"),
    ):
        ax.bar(angles + shift * width, values / ARCSEC, width, color=colour, label=label)
    ax.axhline(0.0, color=style.GREY, lw=0.8)
    ax.set_ylabel("Bᵢ, Rᵢ / arcsec")


def iso230_section(result: Result) -> str | None:
    """Return the HTML of the report's section; None for a result without repeated runs."""
    try:
        runs = runs_of(result)
    except DataError as error:
        return str(escape(SPOKEN.get().say(phrase("Not evaluated: {0}.", phrase(str(error))))))
    if runs is None:
        return None
    figures = iso230(runs)
    rows = [
        [phrase(name), *("–" if v is None else f"{v / ARCSEC:.3f}" for v in (*values, expanded))]
        for name, values, expanded in figures.summary()
    ]
    drawn = draw_runs(runs, figures)
    notes = () if figures.measurement_stated else (phrase(ONLY_SCATTER),)
    return render(
        "iso230",
        figure=drawn,
        rows=rows,
        notes=notes,
        warnings=list(map(phrase, figures.warnings)),
    )
