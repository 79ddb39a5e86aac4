"""What a single observation could hide: a section of the report."""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.evaluation.reliability import Reliability, reliability
from rotcal_ros.report.template import render
from rotcal_ros.results import Result
from rotcal_ros.units import MICROMETRE

TITLE: Final = "What a single observation could hide"
WORST: Final = 8


def section(result: Result) -> str:
    """Return the worst observations by their reliability as HTML; empty without residuals."""
    if result.residuals is None or not np.any(result.residuals.used):
        return ""
    found = reliability(result.residuals)
    return render(
        "reliability",
        count=len(found.row),
        unchecked=int(found.unchecked.sum()),
        redundancy=f"{found.redundancy.mean():.2f}",
        power=f"{100.0 * found.power:g}",
        alpha=f"{100.0 * found.alpha:g}",
        rows=_rows(found),
        head=_head(found),
    )


def _head(found: Reliability) -> list[str]:
    metres = ["Error / µm"] if found.std is not None else []
    columns = ["Error / its std", "Effect, at most / std"]
    return ["Table position", "Target", "Redundancy", *metres, *columns]


def _rows(found: Reliability) -> list[list[str]]:
    """Return position, target, redundancy, minimal detectable error and bound of its effect."""
    metres, rows = found.detectable_m(), []
    for k in found.worst(WORST).tolist():
        numbers = [found.detectable[k], found.effect[k]]
        if metres is not None:
            numbers.insert(0, metres[k] / MICROMETRE)
        row = [str(found.table_position[k]), str(found.target[k]), f"{found.redundancy[k]:.3f}"]
        rows.append([*row, *(f"{v:.2f}" if np.isfinite(v) else "any" for v in numbers)])
    return rows
