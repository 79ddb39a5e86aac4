"""What the verdict of a result covers and what it does not: a section of the report."""

from __future__ import annotations

from rotcal_ros.protection import TOLERABLE
from rotcal_ros.report.template import render
from rotcal_ros.results import Result

TITLE = "What could be wrong, and would it show?"


def section(result: Result) -> str:
    """Return the table of protections as HTML, one row per effect."""
    return render(
        "trust",
        rows=[
            {
                "effect": p.effect,
                "treatment": p.treatment,
                "why": p.why,
                "error": "" if p.error is None else f"{p.error:.1f}",
                "bare": p.effect in result.unprotected,
            }
            for p in result.protections
        ],
        tolerable=f"{TOLERABLE:g}",
    )
