"""Harmonic content of every deviation curve: bars and a table for the report."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from rotcal_ros.components import COVERAGE_FACTOR, unit_of
from rotcal_ros.curves.measured import measured_curve
from rotcal_ros.errors import DataError
from rotcal_ros.evaluation.harmonics import HarmonicContent, harmonic_content
from rotcal_ros.figures import style
from rotcal_ros.gum_numbers import value_with_uncertainty
from rotcal_ros.report.template import render
from rotcal_ros.results import Result
from rotcal_ros.units import DEGREE


@style.styled
def bars(found: Mapping[str, HarmonicContent]) -> str:
    """Draw the amplitudes over the order; pale where the order does not differ from zero."""
    panels = style.grid(-(-len(found) // 2), min(2, len(found)), height=2.5)
    for ax, (name, content) in zip(panels, found.items(), strict=False):
        unit, label = unit_of(name)
        whiskers = COVERAGE_FACTOR * content.amplitude_std / unit
        heights = content.amplitude / unit
        for sure, alpha in ((content.significant, 0.85), (~content.significant, 0.25)):
            ax.bar(
                content.orders[sure], heights[sure], 0.7, yerr=whiskers[sure], alpha=alpha,
                color=style.BLUE, ecolor=style.INK, capsize=2,
            )  # fmt: skip
        ax.set_ylim(bottom=0.0)
        ax.set_xlabel("order per turn")
        ax.set_ylabel(f"{name} amplitude / {label}")
        style.whole_numbers(ax.xaxis)
    for ax in panels[len(found) :]:
        ax.set_axis_off()
    return style.svg(panels[0])


def section(result: Result) -> str:
    """Return the HTML of the report's section; empty when no curve goes round."""
    found = {}
    for name in result.components:
        # An arc, or a curve that does not close: the report shows that elsewhere.
        with suppress(DataError):
            found[name] = harmonic_content(measured_curve(result, name))
    if not found:
        return ""
    tables = [_table(name, content) for name, content in found.items()]
    return render("harmonics", figure=bars(found), tables=tables)


def _table(name: str, content: HarmonicContent) -> dict[str, Any]:
    """Return order, amplitude and phase of every order as text."""
    unit, label = unit_of(name)
    amplitude, spread = content.amplitude / unit, COVERAGE_FACTOR * content.amplitude_std / unit
    phase = np.mod(content.phase, 2.0 * np.pi) / DEGREE
    turn = COVERAGE_FACTOR * content.phase_std / DEGREE
    rows = [
        (
            str(order),
            value_with_uncertainty(float(amplitude[k]), float(spread[k])).lstrip("+"),
            _phase(float(phase[k]), float(turn[k])) if content.significant[k] else "–",
        )
        for k, order in enumerate(content.orders)
    ]
    rest = f"{content.residual_rms / unit:.4f} {label}"
    return {"name": name, "unit": label, "rows": rows, "rest": rest}


def _phase(degrees: float, expanded: float) -> str:
    return value_with_uncertainty(degrees, expanded).lstrip("+")
