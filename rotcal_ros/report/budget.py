"""The uncertainty budget: its sources over the angles as a figure, and at the worst as a table."""

from __future__ import annotations

from itertools import cycle
from typing import Any

import numpy as np

from rotcal_ros.components import COVERAGE_FACTOR, unit_of
from rotcal_ros.evaluation.budget import WHOLE, contributions
from rotcal_ros.figures import style
from rotcal_ros.gum_numbers import place_of, uncertainty, value_to
from rotcal_ros.report.facts import NOT_STATED
from rotcal_ros.report.first_page import degrees
from rotcal_ros.report.template import render
from rotcal_ros.results import Result
from rotcal_ros.units import DEGREE

TITLE = "Uncertainty budget"


def section(result: Result, withheld: str) -> str:
    """Return the budget as HTML; where no U is stated, why, above what the model alone gives."""
    return render(
        "budget",
        figure=sources(result),
        tables=_tables(result),
        withheld=withheld,
        refraction=result.circumstances.refraction or NOT_STATED,
        dof=result.dof,
        sigma0=f"{result.sigma0:.2f}",
    )


@style.styled
def sources(result: Result) -> str:
    """Draw the standard uncertainty of every source, and their sum, over the table angle."""
    names = result.components
    panels = style.grid(-(-len(names) // 2), min(2, len(names)), height=2.3)
    for ax, name in zip(panels, names, strict=False):
        unit, label = unit_of(name)
        parts = contributions(result, name)
        angles = result.angles / DEGREE
        if len(parts) > 1:
            for part, colour in zip(parts, cycle(style.COLOURS), strict=False):
                ax.plot(angles, part.std / unit, "o-", color=colour, ms=3, lw=1, label=part.source)
        ax.plot(angles, result.std[name] / unit, "-", color=style.INK, lw=1.6, label="combined")
        ax.set_ylim(bottom=0.0)
        ax.set_ylabel(f"u({name}) / {label}")
        style.angle_axis(ax, angles)
    for ax in panels[len(names) :]:
        ax.set_axis_off()
    return style.svg(panels[0])


def _tables(result: Result) -> list[dict[str, Any]]:
    """Return a table for each component that is split, or one for all where none is."""
    if any(len(contributions(result, name)) > 1 for name in result.components):
        return [_table(result, name) for name in result.components]
    rows = []
    for name in result.components:
        unit, label = unit_of(name)
        worst = int(np.argmax(result.std[name]))
        whole = float(result.std[name][worst]) / unit
        place = f"{degrees(float(result.angles[worst]))}°"
        texts = [uncertainty(whole), uncertainty(COVERAGE_FACTOR * whole)]
        rows.append([name, place, *(f"{text} {label}" for text in texts)])
    caption = f"{WHOLE}: the method does not tell the sources apart"
    head = ["Deviation", "where U is largest", "u", f"U (k = {COVERAGE_FACTOR:g})"]
    return [{"caption": caption, "head": head, "rows": rows}]


def _table(result: Result, name: str) -> dict[str, Any]:
    """Return the sources at the angle with the largest uncertainty as text."""
    unit, label = unit_of(name)
    std = result.std[name] / unit
    worst = int(np.argmax(std))
    whole = float(std[worst])
    # Half of the digits of U = 2 u: a source is shown to the place of the sum.
    place = place_of(whole) if whole else 0
    rows = []
    for part in contributions(result, name):
        size = float(part.std[worst]) / unit
        share = 100.0 * (size / whole) ** 2 if whole else 0.0
        rows.append([part.source, value_to(size, place), f"{share:.0f} %"])
    expanded = COVERAGE_FACTOR * whole
    rows.append(["Combined standard uncertainty", value_to(whole, place), "100 %"])
    rows.append([f"Expanded uncertainty U (k = {COVERAGE_FACTOR:g})", uncertainty(expanded), ""])
    return {
        "caption": f"{name} at {degrees(float(result.angles[worst]))}°, where its U is largest",
        "head": ["Source", f"u / {label}", "Share of u²"],
        "rows": rows,
    }
