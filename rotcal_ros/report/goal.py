"""A goal, what became of it, and the paper's plan beside it: a section of the report."""

from __future__ import annotations

from rotcal_ros.catalogue.goal import GoalStanding
from rotcal_ros.planning.plan_figures import PlanFigures
from rotcal_ros.report.template import render
from rotcal_ros.units import ARCSEC, MICROMETRE


def section(standing: GoalStanding | None) -> str:
    """Return the section as HTML; empty without a goal."""
    if standing is None:
        return ""
    own, papers = standing.compared.own, standing.compared.papers
    return render(
        "goal",
        goal=f"{standing.goal / ARCSEC:.3f}",
        reached=f"{standing.reached / ARCSEC:.3f}",
        measured=standing.measured,
        candidates=standing.candidates,
        reason=standing.reason,
        noise=f"{standing.compared.length_std / MICROMETRE:.3g}",
        columns=[_column(own), _column(papers)],
        cell=own.cell_seconds is not None,
    )


def _column(figures: PlanFigures) -> dict[str, str]:
    cell = figures.cell_seconds
    return {
        "lengths": str(figures.lengths),
        "uncertainty": f"{figures.uncertainty / ARCSEC:.3f}",
        "seconds": f"{figures.seconds:.0f} s",
        "cell": "" if cell is None else f"{cell:.0f} s",
    }
